"""What errors of a log, and the noise of regressors, make of a model that is learned from it."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS, FORCES, SURFACES
from log_errors import placed, with_channels
from made_flights import GLIDER, make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor
from skdgp.dynamics import (
    Servos,
    aerodynamic_coefficients,
    as_aerodynamics,
)
from skdgp.estimation import servo_output
from skdgp.identification import make_identification_pipeline
from skdgp.identification._log_errors import (
    CLOCK,
    CLOCK_STEPS,
    clock_std,
    learned_errors,
    regression_calibration,
)
from skdgp.identification._pipeline import named_regressors
from skdgp.inference import linear_weights
from skdgp.preprocessing import LagCorrector

HATS = ["p_hat", "q_hat", "r_hat"]
REGRESSORS = ["alpha", "beta", *HATS, *SURFACES]
STEP = 0.02


@pytest.fixture(scope="module")
def flown():
    """A flight of smooth motion that a linear model explains, and its regressors."""
    names = "alpha beta p q r elevator aileron rudder"
    table = make_flight({names: (0, 0.05, 0)}, 3000, STEP, width=12)
    table = table.assign(airspeed=20.0, density=1.2)
    X = table[names.split()].set_axis(REGRESSORS, axis=1)
    X[HATS] *= GLIDER.moment_lengths / 40.0
    slopes = default_rng(0).normal(size=(8, 6))
    table[FORCES] = X @ slopes[:, :3] * 0.5 * 1.2 * 20.0**2 * GLIDER.wing_area / GLIDER.mass
    return table, X, slopes


def least_squares_of(X, Y):
    """Return slopes and intercepts as `identify` keeps them."""
    fit = LinearRegression().fit(X, Y)
    table = pd.DataFrame(fit.coef_.T, X.columns, COEFFICIENTS)
    table.loc["intercept"] = fit.intercept_
    return table


def slopes_of(errors, k):
    """Return what one standard deviation of the k-th error adds to the slopes, (6, regressors)."""
    return errors.weights[k, 1:].T


def test_tilted_sensors_change_forces_by_what_is_added(flown):
    """Sensors whose nose is 0.03 rad low read less of gravity forward; a log that states the tilt adds nothing."""
    table, X, slopes = flown
    known = least_squares_of(X, X @ slopes)
    without = learned_errors(table, GLIDER, X, known, None, Servos(), 0.0)
    errors = learned_errors(table.assign(sensor_tilt=0.03), GLIDER, X, known, None, Servos(), 0.0)
    assert len(errors.weights) == len(without.weights) + 2  # roll and pitch
    turned = Rotation.from_euler("y", 0.03).apply(table[FORCES])
    tilted = with_channels(table, FORCES, turned)
    measured, level = (
        aerodynamic_coefficients(each, GLIDER, thrust=None) for each in (tilted, table)
    )
    change = LinearRegression().fit(X, measured - level).coef_
    assert_allclose(slopes_of(errors, 4), change, atol=2e-3)


@pytest.mark.parametrize(
    ("group", "channels", "k"),
    [("surfaces", SURFACES, 3), ("air", ["alpha", "beta"], 4)],
)
def test_late_channels_change_slopes_by_what_is_added(flown, group, channels, k):
    table, X, slopes = flown
    Y = X @ slopes
    errors = learned_errors(table, GLIDER, X, least_squares_of(X, Y), None, Servos(), 0.0)
    late = 1e-4  # s
    later = X.copy()
    for name in channels:
        later[name] = X[name] - late * np.gradient(X[name], STEP, edge_order=2)
    change = LinearRegression().fit(later, Y).coef_ - slopes.T
    expected = slopes_of(errors, k) / clock_std(None, group, STEP) * late
    assert_allclose(change, expected, atol=0.03 * np.abs(expected).max())


def test_a_servo_that_is_slower_and_less_late_changes_slopes_by_what_is_added(flown):
    table, commands, slopes = flown
    servos = Servos(lag=0.05, lag_std=0.02, delay_std=0.01)

    def behind(lag, delay):
        """Return the regressors with deflections behind their commands."""
        time = table["time"].to_numpy()
        early = CubicSpline(time, commands[SURFACES])(time - delay)
        return with_channels(commands, SURFACES, servo_output(early, lag, STEP))

    X = behind(servos.lag, 0.0)
    known = least_squares_of(X, X @ slopes)
    without = learned_errors(table, GLIDER, X, known, None, Servos(), 0.0)
    errors = learned_errors(table, GLIDER, X, known, None, servos, 0.0)
    assert len(errors.weights) == len(without.weights) + 1
    small = 0.1
    slower = behind(servos.lag + small * servos.lag_std, -small * servos.delay_std)
    change = LinearRegression().fit(X, (slower - X) @ slopes).predict(X) / small
    assert np.std(errors.linear(X.to_numpy())[5] - change) < 0.05 * np.std(change)


def test_sensors_elsewhere_change_slopes_by_what_is_added(flown):
    table, X, _ = flown
    Y = aerodynamic_coefficients(table, GLIDER, thrust=None, cutoff=None)
    errors = learned_errors(table, GLIDER, X, least_squares_of(X, Y), None, Servos(), 0.0)
    above = placed(table, (0.0, 0.0, 0.03))
    there = aerodynamic_coefficients(above, GLIDER, thrust=None, cutoff=None)
    change = LinearRegression().fit(X, there - Y).coef_
    assert_allclose(slopes_of(errors, 2), change, atol=0.02 * np.abs(change).max())


def test_a_lag_that_is_known_leaves_no_more_than_motion_between_samples():
    lags = LagCorrector(lags={"surfaces": 0.05}).fit(
        pd.DataFrame({"time": [0.0], "elevator": [0.0]})
    )
    least = CLOCK_STEPS * STEP
    assert clock_std(lags.lags_, "surfaces", STEP) == least
    assert_allclose(clock_std(lags.lags_, "air", STEP), np.hypot(CLOCK, least))


def test_what_is_left_of_a_delay_behind_a_lag_of_servos_is_an_error():
    """Commands 40 ms early, of which a lag of servos of 45 ms was removed."""
    lags = pd.DataFrame(
        {"lag": [-0.03, 0.01], "std": [0.001, 0.004], "applied": [0.0, 0.045]},
        ["surfaces", "servos"],
    )
    expected = np.linalg.norm([0.005, 0.001, CLOCK_STEPS * STEP])
    assert_allclose(clock_std(lags, "surfaces", STEP), expected)


def test_an_airspeed_that_is_too_large_scales_coefficients_and_slopes(flown):
    """Coefficients are over the dynamic pressure, and non-dimensional rates over the airspeed."""
    table, X, slopes = flown
    level = np.linspace(0.1, 0.6, 6)
    Y = level + X @ slopes
    fitted = least_squares_of(X, Y)
    error = 1e-4
    later = X / np.where(X.columns.isin(HATS), 1 + error, 1.0)
    change = least_squares_of(later, Y / (1 + error) ** 2) - fitted
    added = learned_errors(table, GLIDER, X, fitted, None, Servos(), error).weights[-1]
    assert_allclose(added[1:], change.loc[REGRESSORS], rtol=1e-3)
    assert_allclose(added[0], -2 * error * Y.mean(axis=0), atol=error * 0.01)


def test_a_model_has_them_in_its_band(flown):
    """In units before the scaler, of which the model learns."""
    table, X, slopes = flown
    Y = (X @ slopes + 0.01).set_axis(COEFFICIENTS, axis=1)
    model = make_identification_pipeline(
        GLIDER,
        regressors=REGRESSORS,
        cutoff=None,
        lags=None,
        reconstruction="passthrough",
        regressor=DependentGPRegressor(structure="trend", input_noise=None, random_state=0),
    )
    model.set_params(flightcheck="passthrough", flightsmoother="passthrough").fit(table, Y)
    named = named_regressors(model, model[:-1].transform(table))
    expected = learned_errors(table, GLIDER, named, model.least_squares_, None, Servos(), 0.0)
    found = as_aerodynamics(model).learned.function_errors
    at = named.to_numpy()[:9]
    assert (found.variance(at) >= expected.variance(at) * (1 - 1e-6)).all()
    assert found.variance(at).max() < 3 * expected.variance(at).max()


def test_linear_residuals_are_added_in_proportion_to_the_noise():
    """Up to the noise of the training flights; unknown residuals tell nothing."""
    rng = default_rng(0)
    X = rng.normal(size=(50, 3))
    intercept, slopes = rng.normal(size=2), rng.normal(size=(3, 2))
    residuals = intercept + X @ slopes
    residuals[5:20, 1] = np.nan
    weights = linear_weights(X, residuals)
    points = rng.normal(size=(4, 3))
    fraction = [[0.0], [0.5], [1.0], [1.0]]
    expected = fraction * (intercept + points @ slopes)
    found = regression_calibration(weights, points, [0.0, 0.5, 1.0, 7.0])
    assert_allclose(found, expected, atol=1e-12)
