"""The example flights: reproducible, consistent, known to the truth; noise of sensors, simulation."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import simpson
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import LinearRegression
from sklearn.preprocessing import StandardScaler

from skdgp._flight.channels import CHANNELS, COEFFICIENTS
from skdgp.datasets import _example_flights, load_example_flights
from skdgp.datasets._brumby import brumby_motion
from skdgp.datasets._example_flights import SENSOR_NOISE, measure
from skdgp.dynamics import (
    aerodynamic_coefficients,
    air_data,
    euler_to_matrix,
    euler_to_quaternion,
    ned_to_body,
)
from skdgp.dynamics._air import GustyAir, LocalAir
from skdgp.dynamics._dryden import Gusts

FLIGHTS = ("lateral", "latlon", "two_altitudes")
GRAVITY = np.array([0.0, 0.0, 9.80665])

# Fly without the cache, which the tests would empty of the full flights
fly = _example_flights._flights.__wrapped__


def true(flight, *names):
    return flight[[name + "_true" for name in names]].to_numpy()


def rotation(flight):
    """Body to NED."""
    return euler_to_matrix(*true(flight, "phi", "theta", "psi").T)


def inverse_turn(flight, vectors):
    return np.einsum("nji,nj->ni", rotation(flight), vectors)


def noise_free(flight):
    """What perfect sensors, and rate-derivative sensors, would have logged."""
    kept = [name for name in flight if name + "_true" not in flight]
    return (
        flight[kept]
        .rename(columns=lambda name: name.removesuffix("_true"))
        .drop(columns=list(COEFFICIENTS))
    )


@pytest.fixture(params=FLIGHTS)
def flight(request, flights):
    return flights[request.param]


class TestEquationsOfFlight:
    def test_wind_triangle(self, flight):
        wind = true(flight, "wind_north", "wind_east", "wind_down")
        relative = inverse_turn(flight, true(flight, "v_north", "v_east", "v_down") - wind)
        np.testing.assert_allclose(
            np.stack(air_data(relative), -1), true(flight, "airspeed", "alpha", "beta"), atol=1e-11
        )

    def test_path_is_the_integral_of_velocity_and_velocity_of_acceleration(self, flight):
        velocity = true(flight, "v_north", "v_east", "v_down")
        position = np.c_[true(flight, "north", "east"), -flight.altitude]
        acceleration = (
            np.einsum("nij,nj->ni", rotation(flight), true(flight, "ax", "ay", "az")) + GRAVITY
        )
        for rate, value, tolerance in ((velocity, position, 1e-4), (acceleration, velocity, 1e-2)):
            gained = simpson(np.stack([rate[:-2], rate[1:-1], rate[2:]]), dx=0.025, axis=0)
            error = value[2:] - value[:-2] - gained
            assert (error.std(axis=0) < tolerance * gained.std(axis=0)).all()

    def test_rates_are_integrals_of_their_derivatives(self, flight):
        """Up to what gusts and commands do between the rows, which no rule of integration knows."""
        names = ("p", "q", "r", "alpha", "beta")
        value, rate = true(flight, *names), true(flight, *(name + "_dot" for name in names))
        gained = simpson(np.stack([rate[:-2], rate[1:-1], rate[2:]]), dx=0.025, axis=0)
        assert ((value[2:] - value[:-2] - gained).std(axis=0) < 0.1 * gained.std(axis=0)).all()

    def test_inverse_dynamics_gives_the_coefficients_back(self, flight, data):
        found = aerodynamic_coefficients(noise_free(flight), data.aircraft, cutoff=None)
        truth = true(flight, *COEFFICIENTS)
        assert (abs(found.to_numpy() - truth).max(axis=0) < 2e-3 * truth.std(axis=0)).all()


def regressors(flight, data):
    """The true model's regressors from truth columns; its rates are inertial, as gyros have them."""
    half_time = 0.5 / flight.airspeed_true.to_numpy()
    b, c = data.aircraft.span, data.aircraft.chord
    scale = dict.fromkeys(("p", "r", "beta_dot"), b) | dict.fromkeys(("q", "alpha_dot"), c)
    columns = []
    for name in data.regressor_names:
        values = flight[name + "_true" if name + "_true" in flight else name].to_numpy()
        columns.append(values * half_time * scale[name] if name in scale else values)
    return np.stack(columns, axis=-1)


def test_true_model_gives_the_true_coefficients_in_calm_air(data):
    for table in fly(1, 0.0, 0.0, 4.0):
        np.testing.assert_allclose(
            data.aerodynamics(regressors(table, data)),
            true(table, *COEFFICIENTS),
            rtol=1e-9,
            atol=1e-13,
        )


def test_gusts_hide_from_gyros_but_not_from_vanes(data):
    """In turbulence the aerodynamics feel rates that no sensor sees: an error of some per cent, none in CX."""
    truth = true(data.test, *COEFFICIENTS)
    error = (data.aerodynamics(regressors(data.test, data)) - truth).std(axis=0) / truth.std(axis=0)
    assert error[0] < 1e-9
    assert ((error[1:] > 1e-3) & (error[1:] < 0.4)).all()


class TestFlights:
    def test_envelope(self, flight):
        degrees = np.degrees(true(flight, "alpha", "beta", "phi", "theta"))
        assert flight.airspeed_true.between(28, 42).all()
        assert ((degrees[:, 0] > -2) & (degrees[:, 0] < 14)).all()
        assert abs(degrees[:, 1]).max() < 13
        assert abs(degrees[:, 2]).max() < 75
        assert abs(degrees[:, 3]).max() < 25
        load_factor = -flight.az_true / 9.80665
        assert load_factor.between(0.0, 3.0).all()
        assert flight.altitude.between(150, 350).all()
        assert flight.throttle.between(0.0, 1.0).all()
        assert (flight.throttle.isin([0.0, 1.0])).mean() < 0.02
        assert (abs(flight[["elevon_left", "elevon_right"]]) < 0.40).all(axis=None)


def root_mean_square_error(prediction, truth):
    return np.sqrt(np.mean((prediction - truth) ** 2, axis=0)) / truth.std(axis=0)


def test_learnable_and_still_hard(data):
    """Least squares explains the training flights but for a residue that a Gaussian process finds and it cannot."""
    X, X_test = regressors(data.train, data), regressors(data.test, data)
    Y, Y_test = true(data.train, *COEFFICIENTS), true(data.test, *COEFFICIENTS)
    line = LinearRegression().fit(X, Y)
    assert (root_mean_square_error(line.predict(X), Y) ** 2 < 0.1).all()
    residue = Y - line.predict(X)
    chosen = np.linspace(0, len(X) - 1, 400).astype(int)
    scaler = StandardScaler().fit(X)
    curve = GaussianProcessRegressor(RBF(5.0) + WhiteKernel(0.1), optimizer=None, normalize_y=True)
    curve.fit(scaler.transform(X[chosen]), residue[chosen])
    straight = root_mean_square_error(line.predict(X_test), Y_test)
    bent = root_mean_square_error(
        line.predict(X_test) + curve.predict(scaler.transform(X_test)), Y_test
    )
    assert (bent < straight).all()
    assert bent.mean() < 0.75 * straight.mean()


class TestTables:
    def test_shape_clock_and_names(self, data):
        assert data.train.shape == (14400, 69)
        assert data.test.shape == (7200, 69)
        assert list(data.train) == list(data.test)
        for _, table in data.train.groupby("flight", observed=True):
            np.testing.assert_allclose(table.time, np.arange(7200) * 0.025, atol=1e-9)
        assert data.train.index.is_unique
        assert not data.train.isna().any(axis=None)
        assert not data.test.isna().any(axis=None)

    def test_every_column_is_in_the_vocabulary(self, data):
        assert {name.removesuffix("_true") for name in data.train} - set(CHANNELS) == {"gravity"}


class TestLoader:
    def test_same_seed_same_flights(self, data):
        """A shorter run starts with the same gusts and noise, so it is the long one's beginning."""
        train, test = fly(0, 1.0, 1.0, 2.0)
        pd.testing.assert_frame_equal(test, data.test[: len(test)], rtol=1e-9, atol=1e-9)
        pd.testing.assert_frame_equal(
            train[: len(test)],
            data.train[: len(test)],
            rtol=1e-9,
            atol=1e-9,
            check_categorical=False,
        )

    def test_other_seed_other_gusts(self, data):
        _, other = fly(7, 1.0, 1.0, 4.0)
        gust = data.test.wind_down_true[: len(other)]
        assert abs(np.corrcoef(gust, other.wind_down_true)[0, 1]) < 0.9
        assert (gust != other.wind_down_true).all()

    def test_calm_air_has_a_steady_wind_and_turbulence_scales(self, data):
        _, calm = fly(0, 0.0, 1.0, 2.0)
        assert np.ptp(true(calm, "wind_north", "wind_east", "wind_down"), axis=0).max() < 1e-12
        _, rough = fly(0, 2.0, 1.0, 4.0)
        usual = data.test[: len(rough)]
        assert rough.wind_down_true.std() > 1.5 * usual.wind_down_true.std()

    def test_random_state_follows_scikit_learn(self, monkeypatch, data):
        seeds = []

        def record(seed, *_):
            seeds.append(seed)
            return data.train, data.test

        monkeypatch.setattr(_example_flights, "_flights", record)
        load_example_flights(random_state=np.int64(3))
        load_example_flights(random_state=np.random.RandomState(3))
        load_example_flights(random_state=np.random.RandomState(3))
        load_example_flights(random_state=None)
        assert seeds[0] == 3
        assert seeds[1] == seeds[2] != seeds[3]

    @pytest.mark.parametrize(
        "wrong", [{"turbulence": -1.0}, {"sensor_noise": "none"}, {"random_state": "seed"}]
    )
    def test_wrong_arguments_are_named(self, wrong):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            load_example_flights(**wrong)


N = 40_000


@pytest.fixture(scope="module")
def truth():
    wave = np.sin(np.arange(N) / 50.0)
    return pd.DataFrame({name + "_true": k + wave for k, name in enumerate(SENSOR_NOISE)})


@pytest.fixture(scope="module")
def errors(truth):
    return measure(truth, 1.0, np.random.default_rng(4)) - truth.rename(
        columns=lambda name: name[:-5]
    )


def test_noise_has_the_stated_levels(errors):
    np.testing.assert_allclose(errors.std(), [SENSOR_NOISE[name] for name in errors], rtol=0.02)
    assert (abs(errors.mean()) < 5 * errors.std() / np.sqrt(N)).all()


def test_noise_is_white_and_independent(errors):
    scaled = (errors / errors.std()).to_numpy()
    for lag in (1, 2, 17):
        assert abs((scaled[lag:] * scaled[:-lag]).mean(axis=0)).max() < 5 / np.sqrt(N)
    between = np.corrcoef(scaled.T) - np.eye(scaled.shape[1])
    assert abs(between).max() < 5 / np.sqrt(N)


def test_perfect_sensors_tell_the_truth(truth):
    measured = measure(truth, 0.0, np.random.default_rng(0))
    np.testing.assert_array_equal(measured.to_numpy(), truth.to_numpy())


STATE = np.r_[
    120.0, -40.0, -210.0, 34.0, -1.5, 3.4, euler_to_quaternion(0.5, 0.1, 2.0), 0.3, 0.12, -0.15
]
CONTROLS = {"elevator": -0.025, "aileron": 0.065, "rudder": 0.08, "propeller_speed": 640.0}
WIND = np.array([3.0, -2.0, 0.5])
GUST = Gusts(np.array([0.7, -0.9, 0.5]), np.array([1.0, 2.0, -1.5]), np.array([0.05, 0.04, -0.06]))
STILL = Gusts(*np.zeros((3, 3)))
MOTION = brumby_motion()


def at(state, wind=WIND, gust=GUST, slopes=(0.0, 0.0)):
    """One pass of the fixed point, from a guess of alpha_dot and beta_dot."""
    implicit = np.zeros((*state.shape[:-1], 8))
    implicit[..., :2] = slopes
    air = GustyAir(lambda stage, state: LocalAir(wind), Gusts(*(part[None] for part in gust)))
    return MOTION.at(state, CONTROLS, air(0, state), implicit)


def settled(state, wind=WIND, gust=GUST):
    slopes = (0.0, 0.0)
    for _ in range(12):
        now = at(state, wind, gust, slopes)
        slopes = now.implicit[..., :2]
    return now


def test_steady_gust_acts_like_wind():
    as_wind = settled(STATE, gust=STILL)
    steady = GUST._replace(
        velocity=ned_to_body(STATE[6:10], WIND), rates=np.zeros(3),
        # A body-fixed gust that follows a steady wind turns against the aircraft.
        acceleration=-np.cross(STATE[10:13], ned_to_body(STATE[6:10], WIND)),
    )  # fmt: skip
    as_gust = settled(STATE, wind=np.zeros(3), gust=steady)
    np.testing.assert_allclose(as_gust.derivative, as_wind.derivative, atol=1e-12)
    np.testing.assert_allclose(as_gust.implicit, as_wind.implicit, atol=1e-12)


def test_air_that_turns_with_the_aircraft_takes_its_damping_away():
    turning = GUST._replace(velocity=np.zeros(3), acceleration=np.zeros(3), rates=STATE[10:13])
    unturned = np.r_[STATE[:10], 0.0, 0.0, 0.0]
    with_air = at(STATE, gust=turning, slopes=(0.02, -0.03)).coefficients
    without = at(unturned, gust=STILL, slopes=(0.02, -0.03)).coefficients
    np.testing.assert_allclose(with_air, without, atol=1e-15)
