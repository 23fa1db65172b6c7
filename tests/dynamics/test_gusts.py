import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, quad

from skdgp.dynamics import dryden_wind
from skdgp.dynamics._air import FEET, dryden_gusts, dryden_system, low_altitude_turbulence

AIRSPEED, SPAN = 33.0, 2.6
LENGTH, INTENSITY = np.array([240.0, 210.0, 130.0]), np.array([1.1, 0.9, 0.7])


def span_lag(omega, factor):
    return 1.0 / (1.0 + factor * SPAN / (np.pi * AIRSPEED) * 1j * omega)


def transfer(name, omega):
    """MIL-F-8785C, typed from the standard: one noise to one gust."""
    s, T = 1j * omega, LENGTH / AIRSPEED
    along = INTENSITY[0] * np.sqrt(2 * T[0]) / (1 + T[0] * s)

    def across(k):
        return INTENSITY[k] * np.sqrt(T[k]) * (1 + np.sqrt(3) * T[k] * s) / (1 + T[k] * s) ** 2

    roll = (
        INTENSITY[2]
        * np.sqrt(0.8 * np.pi / (AIRSPEED * LENGTH[2]))
        * (np.pi * LENGTH[2] / (4 * SPAN)) ** (1 / 6)
    )
    return {
        "u": along * span_lag(omega, 4),
        "v": across(1) * span_lag(omega, 3),
        "w": across(2) * span_lag(omega, 4),
        "p": roll * span_lag(omega, 4),
        "q": -s / AIRSPEED * span_lag(omega, 4) * across(2),
        "r": s / AIRSPEED * span_lag(omega, 3) * across(1),
    }[name]


# Output and noise of each gust in the linear system
ROWS = {"u": (0, 0), "v": (1, 1), "w": (2, 2), "p": (6, 3), "q": (7, 2), "r": (8, 1)}


@pytest.mark.parametrize("name", ROWS)
def test_linear_system_is_the_standards_forming_filter(name):
    A, B, C = dryden_system(AIRSPEED, LENGTH, INTENSITY, SPAN)
    row, noise = ROWS[name]
    for omega in (0.01, 0.2, 1.3, 9.0, 40.0):
        response = C @ np.linalg.solve(1j * omega * np.eye(9) - A, B)
        np.testing.assert_allclose(response[row, noise], transfer(name, omega), rtol=1e-10)
        assert np.count_nonzero(abs(response[row]) > 1e-15) == 1


@pytest.fixture(scope="module")
def gusts():
    n = 200
    return dryden_gusts(
        6000,
        0.025,
        AIRSPEED,
        np.tile(LENGTH, (n, 1)),
        np.tile(INTENSITY, (n, 1)),
        SPAN,
        np.random.default_rng(5),
    )


@pytest.mark.parametrize("name", ROWS)
def test_variance_is_the_integral_of_the_spectrum(gusts, name):
    theory = quad(
        lambda x: abs(transfer(name, np.exp(x))) ** 2 * np.exp(x) / np.pi, -12, 12, limit=200
    )[0]
    kind, axis = (
        (gusts.velocity, "uvw".index(name)) if name in "uvw" else (gusts.rates, "pqr".index(name))
    )
    signal = kind[..., axis]
    assert np.mean(signal**2) == pytest.approx(theory, rel=0.08)
    # Stationary from the first sample on: no warm-up hides in the data. 200 flights: 10 % per
    # standard error.
    assert np.mean(signal[0] ** 2) == pytest.approx(theory, rel=0.4)


def test_rates_are_gradients_of_the_gusts_that_are_felt(gusts):
    np.testing.assert_allclose(
        gusts.rates[..., 1], -gusts.acceleration[..., 2] / AIRSPEED, atol=1e-12
    )
    np.testing.assert_allclose(
        gusts.rates[..., 2], gusts.acceleration[..., 1] / AIRSPEED, atol=1e-12
    )


def test_acceleration_is_the_slope_of_velocity():
    """Each is rough, so the trapezia err with the root of the step cubed."""
    step = 2e-4
    fine = dryden_gusts(8000, step, AIRSPEED, [LENGTH], [INTENSITY], SPAN, np.random.default_rng(1))
    climbed = cumulative_trapezoid(fine.acceleration, dx=step, axis=0, initial=0.0)
    np.testing.assert_allclose(fine.velocity - fine.velocity[0], climbed, atol=1e-3)


def test_step_does_not_change_the_law():
    """Discretised exactly: every fourth sample of fine gusts has the covariance over a lag of coarse ones."""
    covariances = []
    for step, stride in ((0.1, 1), (0.025, 4)):
        long = dryden_gusts(
            800 * stride, step, AIRSPEED, np.tile(LENGTH, (300, 1)), np.tile(INTENSITY, (300, 1)), SPAN,
            np.random.default_rng(8),
        ).velocity[::stride]  # fmt: skip
        covariances.append(np.mean(long[1:] * long[:-1], axis=(0, 1)))
    np.testing.assert_allclose(*covariances, rtol=0.1)


def test_low_altitude_model_joins_the_standards_corner_at_1000_feet():
    length, intensity = low_altitude_turbulence(1000 * FEET, 10.0)
    np.testing.assert_allclose(length, 1000 * FEET)
    np.testing.assert_allclose(intensity, 1.0)


def test_a_wind_to_fly_in_has_its_mean_its_intensities_and_its_heading():
    mean, heading = np.array([4.0, -2.0, 0.5]), 0.7
    winds = [
        dryden_wind(
            200.0,
            30.0,
            40.0,
            wind_at_6m=8.0,
            mean_wind=mean,
            heading=heading,
            span=0.01,
            dt=0.05,
            random_state=k,
        )
        for k in range(12)
    ]
    gusts = np.concatenate([wind.iloc[:, 1:].to_numpy() for wind in winds]) - mean
    turn = np.array(
        [[np.cos(heading), np.sin(heading), 0], [-np.sin(heading), np.cos(heading), 0], [0, 0, 1]]
    )
    along = gusts @ turn.T
    _, intensity = low_altitude_turbulence(40.0, 8.0)
    np.testing.assert_allclose(along.std(axis=0), intensity, rtol=0.15)
    assert abs(np.corrcoef(along.T)[0, 1]) < 0.15
    again = dryden_wind(
        200.0,
        30.0,
        40.0,
        wind_at_6m=8.0,
        mean_wind=mean,
        heading=heading,
        span=0.01,
        dt=0.05,
        random_state=3,
    )
    np.testing.assert_allclose(again, winds[3], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(("height", "options", "match"), [
    (0.0, {}, "Got height=0"),
    (400.0, {}, "at most 304.8 m"),
    (100.0, {"wind_at_6m": -1.0}, "wind_at_6m=-1"),
    (100.0, {"mean_wind": [1.0, 2.0]}, "3 finite numbers"),
])  # fmt: skip
def test_winds_that_are_none(height, options, match):
    with pytest.raises(ValueError, match=match):
        dryden_wind(10.0, 30.0, height, **options)
