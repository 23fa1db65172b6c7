"""The example flights: reproducible, consistent, known to the truth; noise of sensors, gusts."""

import re
from pathlib import Path

import numpy as np
import pytest
from flight_columns import COEFFICIENTS, WIND
from numpy.random import RandomState
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import listening
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    LocalAir,
    Motion,
    air_data,
    euler_to_matrix,
    euler_to_quaternion,
    gusty_air,
    ned_to_body,
)

NOTATION = Path(__file__).parents[2] / "docs" / "notation.md"


def true(flight, *names):
    return flight[[name + "_true" for name in names]].to_numpy()


def rotation(flight):
    """Body to NED."""
    return euler_to_matrix(*true(flight, "phi", "theta", "psi").T)


@pytest.fixture(params=["lateral", "latlon", "two_altitudes"])
def flight(request, data):
    """Return every flight as its own table."""
    if request.param == "two_altitudes":
        return data.test
    return data.train[data.train["flight"] == request.param]


class TestEquationsOfFlight:
    def test_wind_triangle(self, flight):
        through_air = true(flight, "v_north", "v_east", "v_down") - true(flight, *WIND)
        relative = np.einsum("nji,nj->ni", rotation(flight), through_air)
        air = np.stack(air_data(relative), axis=-1)
        assert_allclose(air, true(flight, "airspeed", "alpha", "beta"), atol=1e-11)

    def test_envelope(self, flight):
        """Limits in SI units: alpha -2 to 14, beta 13, phi 75, theta 25 degrees; loads up to 3 g."""
        limits = {
            "airspeed_true": (28.0, 42.0), "alpha_true": (-0.035, 0.244), "beta_true": (-0.226, 0.226),
            "phi_true": (-1.309, 1.309), "theta_true": (-0.436, 0.436), "az_true": (-29.42, 0.0),
            "altitude": (150.0, 350.0), "throttle": (0.0, 1.0),
            "elevon_left": (-0.4, 0.4), "elevon_right": (-0.4, 0.4),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            assert flight[name].between(low, high).all(), name
        assert flight.throttle.isin([0.0, 1.0]).mean() < 0.02


def regressors(flight, data):
    """The true model's regressors from truth columns; its rates are inertial, as gyros have them."""
    b = data.aircraft.span
    c = data.aircraft.chord
    lengths = {"p": b, "q": c, "r": b, "alpha_dot": c, "beta_dot": b}
    columns = []
    for name in data.regressor_names:
        values = flight[name + "_true" if name + "_true" in flight else name]
        if name in lengths:
            values = values * lengths[name] / (2 * flight.airspeed_true)
        columns.append(values)
    return np.stack(columns, axis=-1)


def test_true_model_gives_the_true_coefficients_in_calm_air():
    calm = load_example_flights(random_state=1, turbulence=0.0, sensor_noise=0.0, duration=2.0)
    for table in (calm.train, calm.test):
        found = calm.aerodynamics(regressors(table, calm))
        assert_allclose(found, true(table, *COEFFICIENTS), rtol=1e-9, atol=1e-13)
        assert np.ptp(true(table[-80:], *WIND), axis=0).max() < 1e-12


def test_gusts_hide_from_gyros_but_not_from_vanes(data):
    """In turbulence the aerodynamics feel rates that no sensor sees: an error of some per cent, none in CX."""
    truth = true(data.test, *COEFFICIENTS)
    error = (data.aerodynamics(regressors(data.test, data)) - truth).std(axis=0) / truth.std(axis=0)
    assert error[0] < 1e-9
    assert ((error[1:] > 1e-3) & (error[1:] < 0.4)).all()


def test_shape_clock_and_names(data):
    assert data.train.shape == (4800, 70)
    assert data.test.shape == (2400, 70)
    assert list(data.train) == list(data.test)
    for _, table in data.train.groupby("flight", observed=True):
        assert_allclose(table.time, np.arange(2400) * 0.025, atol=1e-9)
    assert data.test.notna().all(axis=None)
    vocabulary = re.findall(r"`(\w+)`", NOTATION.read_text(encoding="utf-8"))
    assert {name.removesuffix("_true") for name in data.train} <= {*vocabulary}


class TestLoader:
    def test_other_seed_other_gusts(self):
        """A seed is drawn of a generator, as scikit-learn does."""
        first, same, other = (
            load_example_flights(random_state=RandomState(seed), duration=1.0).test.wind_down_true
            for seed in (3, 3, 4)
        )
        assert_array_equal(first, same)
        assert (first != other).all()
        assert abs(np.corrcoef(first, other)[0, 1]) < 0.9

    @pytest.mark.parametrize(
        ("name", "value"),
        [("turbulence", -1.0), ("sensor_noise", "none"), ("random_state", "seed"), ("duration", 0)],
    )
    def test_wrong_arguments_are_named(self, name, value):
        with pytest.raises(ValueError, match=name):
            load_example_flights(**{name: value})

    def test_turbulence_scales(self, data):
        rough = load_example_flights(turbulence=2.0, duration=2.0).test
        assert rough.wind_down_true.std() > 1.5 * data.test.wind_down_true[:80].std()


def test_perfect_sensors_tell_the_truth():
    test = load_example_flights(sensor_noise=0.0, duration=1.0).test
    names = [name for name in test if f"{name}_true" in test]
    assert len(names) == 18
    assert_array_equal(test[names], true(test, *names))


def test_noise_of_the_sensors_is_white_and_independent(data):
    names = ["airspeed", "alpha", "p", "ax", "phi", "v_north", "north"]
    errors = data.train[names] - true(data.train, *names)
    rad = np.pi / 180
    assert_allclose(
        errors.std(axis=0), [0.3, 0.3 * rad, 0.002, 0.05, 0.3 * rad, 0.1, 0.5], rtol=0.04
    )
    assert_allclose(np.corrcoef(errors.T), np.eye(len(names)), atol=5 / np.sqrt(len(errors)))


class TestGusts:
    """Of the aircraft of these flights, at one state where nothing vanishes."""

    ATTITUDE = euler_to_quaternion(0.5, 0.1, 2.0)
    RATES = (0.3, 0.12, -0.15)
    STATE = np.r_[120.0, -40.0, -210.0, 34.0, -1.5, 3.4, ATTITUDE, RATES]
    CONTROLS = {"elevator": -0.025, "aileron": 0.065, "rudder": 0.08, "propeller_speed": 640.0}
    WIND = (3.0, -2.0, 0.5)

    def test_steady_gust_acts_like_wind(self, data):
        """A body-fixed gust that follows a steady wind turns against the aircraft."""
        motion = Motion(data.truth, data.aircraft, lagged=True)

        def settled(air):
            """Return what acts once alpha_dot and beta_dot are those of the motion."""
            implicit = np.zeros(8)
            for _ in range(12):
                now = motion.at(self.STATE, self.CONTROLS, air, implicit)
                implicit[:2] = now.implicit[:2]
            return now

        gust = ned_to_body(self.ATTITUDE, self.WIND)
        turning = np.array([gust, -np.cross(self.RATES, gust), np.zeros(3)])[:, None]
        met = gusty_air(lambda *_: LocalAir(), turning)
        as_wind = settled(LocalAir(self.WIND))
        as_gust = settled(met(0, self.STATE))
        assert_allclose(as_gust.derivative, as_wind.derivative, atol=1e-12)
        assert_allclose(as_gust.implicit, as_wind.implicit, atol=1e-12)


def test_the_steps_of_the_simulation_are_told():
    """Before each hundredth one, of flights that are not kept from before."""
    told = []
    with listening(lambda stage, *_: told.append((stage.done, stage.total))):
        load_example_flights(duration=7.0, random_state=123)
    total = round((7.0 + 8.0) / 0.025)  # with the time before the log begins
    assert told == [(done, total) for done in range(0, total, 100)]
