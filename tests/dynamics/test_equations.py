"""Equations behind derivatives, simulations and gusts: unsteady terms, drift, Dryden's spectra."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import WIND
from made_flights import LINEAR_GLIDER, TURBULENCE
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import expm, solve_continuous_lyapunov

from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Drift,
    Motion,
    air_velocity,
    dryden_gusts,
    euler_to_quaternion,
    gust_rate_lags,
)
from skdgp.dynamics._air import turbulence_of_winds
from skdgp.dynamics._dryden import dryden_system, rolling_gust
from skdgp.dynamics._linearize import jacobian, unsteady_terms
from skdgp.dynamics._simulate import drift_in_still_air

GLIDER = LINEAR_GLIDER.aircraft
SLOPES = LINEAR_GLIDER.slopes
HELD = {"elevator": -0.02, "aileron": 0.01, "rudder": 0.03}


def linear(more=(), columns=()):
    """Return the linear aircraft, with slopes (6,) by more regressors."""
    slopes = np.column_stack([SLOPES, *columns])
    return Aerodynamics(
        lambda X: LINEAR_GLIDER.level + X @ slopes.T,
        [*LINEAR_GLIDER.names, *more],
        slopes=lambda X: np.tile(slopes, (len(X), 1, 1)),
    )


RATES = np.array([0.2, 0.1, 0.15])


def state_of(rates=RATES):
    velocity, attitude = air_velocity(17.0, 0.08, 0.03), euler_to_quaternion(0.3, 0.1, 1.0)
    return np.concatenate([[0.0, 0.0, -200.0], velocity, attitude, rates])


MOTION = Motion(linear(), GLIDER, thrust=None)


def test_unsteady_terms_act_as_a_small_slope_by_alpha_dot_does():
    column = 1e-5 * np.array([0.0, 0, -1.0, 0, -2.0, 0])
    named = linear(["alpha_dot"], [column])
    terms = np.column_stack([column, 0 * column]), np.zeros((2, 8)), np.ones((2, 1), dtype=bool)
    at = state_of(), HELD, ["elevator"]
    expected = jacobian(Motion(named, GLIDER, thrust=None), *at)
    plain = jacobian(MOTION, *at)
    found = jacobian(MOTION, *at, unsteady=terms)
    for k in range(2):  # of the motion, of the outputs
        change = expected[k] - plain[k]
        assert_allclose(found[k] - plain[k], change, rtol=0, atol=2e-2 * np.abs(change).max())


def test_unsteady_terms_are_merged_with_the_slopes_by_rates_and_controls():
    """Without gravity alpha_dot follows from the loads: the model learned its effect with theirs."""
    motion = Motion(linear(), GLIDER, thrust=None, air=Air(gravity=0.0))
    state, inputs = state_of(), [*HELD]
    terms = unsteady_terms(motion, motion.at(state, HELD), SLOPES)
    plain = jacobian(motion, state, HELD, inputs)
    found = jacobian(motion, state, HELD, inputs, unsteady=terms)
    by_rates_and_controls = slice(9, None)
    for k in range(2):  # of the motion, of the outputs
        same = plain[k][:, by_rates_and_controls]
        assert_allclose(found[k][:, by_rates_and_controls], same, rtol=5e-9, atol=5e-9)
        assert np.abs(found[k] - plain[k]).max() > 1e-3  # by w the loads turn


def test_with_alpha_dot_the_rest_of_it_is_uncertain():
    """By 0.4 times the derivatives by q, and 0.2 times those by r."""
    none = np.zeros((6, 2))
    motion = Motion(linear(["alpha_dot_hat", "beta_dot_hat"], [none]), GLIDER, thrust=None)
    at = motion.at(state_of(), HELD)
    K, S, M = unsteady_terms(motion, at, np.column_stack([SLOPES, none]))
    assert not M.any()
    errors = -K[:, None] * S.T
    assert_allclose(errors[4, 8], [0.4 * SLOPES[4, 3], 0.0])
    assert_allclose(errors[5, 9, 1], 0.2 * SLOPES[5, 4])


def test_winds_of_seconds_tell_the_rates_of_gusts():
    """Of ten winds of ten seconds, and of one."""
    n, step, speed, span = 201, 0.05, 25.0, 2.0
    scales = np.tile(TURBULENCE.length, (10, 1)), np.tile(TURBULENCE.intensity, (10, 1))
    gusts = dryden_gusts(n, step, speed, *scales, span, default_rng(3)).velocity
    winds = []
    for gust in gusts.swapaxes(0, 1):
        wind = pd.DataFrame(gust, columns=WIND)
        winds.append(wind.assign(time=step * np.arange(n), airspeed=speed))
    density = (
        np.square(TURBULENCE.intensity) / TURBULENCE.length
    )  # of the spectra above their corner
    for some, tolerance in ((winds, 0.3), (winds[:1], 0.7)):
        found = turbulence_of_winds(some, span)
        assert_allclose(np.square(found.intensity) / found.length, density, rtol=tolerance)
    assert turbulence_of_winds([winds[0][:20]], span) is None
    # of three seconds all lengths are far below the corner: that of the prior
    assert_allclose(turbulence_of_winds([winds[0][:60]], span).length, 126.0, rtol=0.03)


def learned_in(turbulence, drift):
    """Return a model that was learned in some turbulence at 25 m/s."""
    known = {"drift": drift, "turbulence": turbulence}
    return Aerodynamics(lambda X: np.zeros((len(X), 6)), ["alpha"], **known)


def test_a_drift_is_what_gusts_of_training_do_not_explain():
    """All of it after flights in calm air, half after gusts of 0.1 m/s, and all where these are not known."""
    drift = Drift(np.full(6, 1e-6), np.full(6, 0.4))
    for size, fraction in ((0.0, 1.0), (0.1, 0.5)):
        turbulence = TURBULENCE._replace(intensity=np.array([size, 0.0, 0.0]))
        left = drift_in_still_air(learned_in(turbulence, drift))
        assert_allclose(left.variance, fraction * drift.variance)
    assert drift_in_still_air(Aerodynamics(np.sin, ["alpha"], drift=drift)) is drift


AIRSPEED, WING = 33.0, 2.6
LENGTH, INTENSITY = np.array([240.0, 210.0, 130.0]), np.array([1.1, 0.9, 0.7])


def span_lag(omega, factor):
    return 1.0 / (1.0 + factor * WING / (np.pi * AIRSPEED) * 1j * omega)


def transfer(name, omega):
    """MIL-F-8785C, typed from the standard: one noise to one gust."""
    s, T = 1j * omega, LENGTH / AIRSPEED
    lag = span_lag(omega, 3 if name in "vr" else 4)
    if name == "u":
        return lag * INTENSITY[0] * np.sqrt(2 * T[0]) / (1 + T[0] * s)
    if name == "p":
        size = np.sqrt(0.8 * np.pi / (AIRSPEED * LENGTH[2]))
        return lag * INTENSITY[2] * size * (np.pi * LENGTH[2] / (4 * WING)) ** (1 / 6)
    k = 1 if name in "vr" else 2
    across = INTENSITY[k] * np.sqrt(T[k]) * (1 + np.sqrt(3) * T[k] * s) / (1 + T[k] * s) ** 2
    factor = {"q": -s / AIRSPEED, "r": s / AIRSPEED}.get(name, 1.0)
    return lag * factor * across


# Output and noise of each gust in the linear system
ROWS = {"u": (0, 0), "v": (1, 1), "w": (2, 2), "p": (6, 3), "q": (7, 2), "r": (8, 1)}


def test_rates_of_gusts_lag_behind_their_slopes():
    """p and q by 4 b / (pi V), r by 3 b / (pi V)."""
    expected = np.array([4, 4, 3]) * WING / (np.pi * AIRSPEED)
    assert_allclose(gust_rate_lags(AIRSPEED, WING), expected)


def test_rolling_gust_is_the_one_of_the_linear_system():
    A, B, C = dryden_system(AIRSPEED, LENGTH, INTENSITY, WING)
    roll = C[6]
    covariance = solve_continuous_lyapunov(A, -B @ B.T)
    std, time = rolling_gust(AIRSPEED, WING, INTENSITY[2], LENGTH[2])
    assert_allclose(std, np.sqrt(roll @ covariance @ roll))
    later = roll @ expm(0.3 * A) @ covariance @ roll
    assert_allclose(later, std**2 * np.exp(-0.3 / time))


@pytest.mark.parametrize("name", ROWS)
def test_linear_system_is_the_standards_forming_filter(name):
    A, B, C = dryden_system(AIRSPEED, LENGTH, INTENSITY, WING)
    row, noise = ROWS[name]
    for omega in (0.01, 0.2, 1.3, 9.0, 40.0):
        response = C @ np.linalg.solve(1j * omega * np.eye(9) - A, B)
        assert_allclose(response[row, noise], transfer(name, omega), rtol=1e-10)
        assert np.count_nonzero(abs(response[row]) > 1e-15) == 1


@pytest.fixture(scope="module")
def gusts():
    """Of 200 flights side by side."""
    scales = np.tile(LENGTH, (200, 1)), np.tile(INTENSITY, (200, 1))
    return dryden_gusts(6000, 0.025, AIRSPEED, *scales, WING, default_rng(5))


def test_variance_is_that_of_the_linear_system(gusts):
    """Also of the first sample, in which no warm-up hides: 200 flights have a standard error of 10 %."""
    A, B, C = dryden_system(AIRSPEED, LENGTH, INTENSITY, WING)
    covariance = C @ solve_continuous_lyapunov(A, -B @ B.T) @ C.T
    theory = np.diag(covariance)[[row for row, _ in ROWS.values()]]
    signal = np.concatenate([gusts.velocity, gusts.rates], axis=-1)
    assert_allclose(np.mean(signal**2, axis=(0, 1)), theory, rtol=0.08)
    assert_allclose(np.mean(signal[0] ** 2, axis=0), theory, rtol=0.4)


def test_acceleration_is_the_slope_of_velocity():
    """Each is rough, so the trapezia err with the root of the step cubed."""
    step = 2e-4
    fine = dryden_gusts(8000, step, AIRSPEED, [LENGTH], [INTENSITY], WING, default_rng(1))
    climbed = cumulative_trapezoid(fine.acceleration, dx=step, axis=0, initial=0.0)
    assert_allclose(fine.velocity - fine.velocity[0], climbed, atol=1e-3)
