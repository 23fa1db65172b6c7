"""Errors of a log: what they make of a linear model that is learned from it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor
from skdgp.dynamics import (
    Aircraft,
    ScaleFactor,
    aerodynamic_coefficients,
    as_aerodynamics,
    stability_derivatives,
)
from skdgp.estimation import AirspeedScale
from skdgp.identification import FlightPipeline
from skdgp.identification._log_errors import CLOCK, CLOCK_STEPS, clock_std, learned_errors
from skdgp.preprocessing import FlightCheck, FlightPathReconstruction, LagCorrector

AIRCRAFT = Aircraft(mass=3.0, inertia=np.diag([0.3, 0.4, 0.6]), wing_area=0.6, span=2.0, chord=0.3)
COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
REGRESSORS = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
STEP = 0.02


@pytest.fixture(scope="module")
def flown():
    """A flight of smooth motion that a linear model explains, and its regressors."""
    rng = default_rng(0)
    names = ["alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder"]
    noise = rng.standard_normal((3000, len(names)))
    motion = gaussian_filter1d(noise, 12.0, axis=0)
    table = pd.DataFrame(0.05 * motion / motion.std(axis=0), columns=names)
    table = table.assign(time=STEP * np.arange(3000), airspeed=20.0, density=1.2)
    X = table[names].copy()
    for rate, length in (("p", 2.0), ("q", 0.3), ("r", 2.0)):
        X[rate] *= length / 40.0
    X.columns = REGRESSORS
    slopes = rng.normal(size=(len(names), 6))
    force = (X.to_numpy() @ slopes)[:, :3] * 0.5 * 1.2 * 20.0**2 * 0.6 / 3.0
    return table.assign(ax=force[:, 0], ay=force[:, 1], az=force[:, 2]), X, slopes


def least_squares_of(X, Y):
    """Return slopes and intercepts as `identify` keeps them."""
    fit = LinearRegression().fit(X.to_numpy(), np.asarray(Y))
    table = pd.DataFrame(fit.coef_.T, X.columns, COEFFICIENTS)
    table.loc["intercept"] = fit.intercept_
    return table.to_dict()


def effect(errors, name):
    """Return what one standard deviation of an error adds to the slopes, (6, regressors)."""
    added = errors[name].added
    columns = [column.removesuffix("_hat") for column in REGRESSORS]
    return np.array([[added[f"{C}_{x}"] for x in columns] for C in COEFFICIENTS])


def test_tilted_sensors_change_forces_by_what_is_added(flown):
    """Sensors whose nose is 0.03 rad low read less of gravity forward; a log that states the tilt adds nothing."""
    table, X, slopes = flown
    known = least_squares_of(X, X.to_numpy() @ slopes)
    name = "pitch of the inertial sensors"
    assert name not in learned_errors(table, AIRCRAFT, X, known, None, 0.0)
    errors = learned_errors(table.assign(sensor_tilt=0.03), AIRCRAFT, X, known, None, 0.0)
    turned = Rotation.from_euler("y", 0.03).apply(table[["ax", "ay", "az"]])
    tilted = table.assign(**dict(zip(["ax", "ay", "az"], turned.T, strict=True)))
    forces = [
        aerodynamic_coefficients(t, AIRCRAFT, thrust=None)[["CX", "CY", "CZ"]]
        for t in (tilted, table)
    ]
    change = LinearRegression().fit(X, forces[0] - forces[1]).coef_
    assert_allclose(effect(errors, name)[:3], change, atol=2e-3)


@pytest.mark.parametrize(
    ("group", "channels"),
    [("surfaces", ["elevator", "aileron", "rudder"]), ("air", ["alpha", "beta"])],
)
def test_late_channels_change_slopes_by_what_is_added(flown, group, channels):
    table, X, slopes = flown
    Y = X.to_numpy() @ slopes
    errors = learned_errors(table, AIRCRAFT, X, least_squares_of(X, Y), None, 0.0)
    late = 1e-4  # s
    later = X.copy()
    for name in channels:
        later[name] = X[name] - late * np.gradient(X[name], STEP, edge_order=2)
    change = LinearRegression().fit(later, Y).coef_ - slopes.T
    std = clock_std(None, group, STEP)
    expected = effect(errors, f"time of {group}") / std * late
    assert_allclose(change, expected, atol=0.03 * np.abs(expected).max())


def test_sensors_elsewhere_change_slopes_by_what_is_added(flown):
    table, X, _ = flown
    Y = aerodynamic_coefficients(table, AIRCRAFT, thrust=None, cutoff=None)
    errors = learned_errors(table, AIRCRAFT, X, least_squares_of(X, Y), None, 0.0)
    position = {"sensor_position_x": 0.0, "sensor_position_y": 0.0, "sensor_position_z": 0.03}
    there = aerodynamic_coefficients(table.assign(**position), AIRCRAFT, thrust=None, cutoff=None)
    change = LinearRegression().fit(X, there - Y).coef_
    got = effect(errors, "sensor position z")
    assert_allclose(got, change, atol=0.02 * np.abs(change).max())


def test_a_lag_that_is_known_leaves_no_more_than_motion_between_samples():
    lags = LagCorrector(lags={"surfaces": 0.05}).fit(
        pd.DataFrame({"time": [0.0], "elevator": [0.0]})
    )
    least = CLOCK_STEPS * STEP
    assert clock_std(lags.lags_, "surfaces", STEP) == least
    assert clock_std(lags.lags_, "air", STEP) == pytest.approx(np.hypot(CLOCK, least))


def test_they_are_part_of_the_standard_deviation_of_derivatives(flown):
    table, X, slopes = flown
    X = X.iloc[::20]
    Y = X.to_numpy() @ slopes + 0.01 * default_rng(1).normal(size=(len(X), 6))
    model = DependentGPRegressor(structure="trend", input_noise=None, random_state=0).fit(X, Y)
    state = np.array([0, 0, -100, 20, 0, 0, 1, 0, 0, 0, 0, 0, 0])
    factor = ScaleFactor(0.1, {"dynamic pressure": 1.0})
    controls = dict.fromkeys(["elevator", "aileron", "rudder"], 0.0)
    tables = []
    for errors in ({}, {"airspeed": factor}):
        uncertain = replace(as_aerodynamics(model), errors=errors)
        tables.append(
            stability_derivatives(uncertain, AIRCRAFT, state, controls, thrust=None, random_state=0)
        )
    without, table = tables
    # a non-dimensional rate contains the airspeed, too
    relative = table["regressor"].isin(["p", "q", "r"]).map({True: 0.05, False: 0.1})
    assert_allclose(table["std_log"], relative * table["value"].abs(), rtol=1e-6)
    assert_allclose(table["std"], np.hypot(without["std"], table["std_log"]))
    assert_allclose(table["upper"] - table["lower"], 2 * 1.95996 * table["std"], rtol=1e-4)
    assert "std_aircraft" not in table


def test_an_error_of_the_airspeed_counts_twice_in_dynamic_pressure(flown):
    table, X, slopes = flown
    fitted = least_squares_of(X, X.to_numpy() @ slopes)
    assert "airspeed" not in learned_errors(table, AIRCRAFT, X, fitted, None, 0.0)
    factor = learned_errors(table, AIRCRAFT, X, fitted, None, 0.01)["airspeed"]
    assert factor.std == 0.02
    assert factor.powers == {"dynamic pressure": 1.0}


def test_the_error_of_the_airspeed_is_removed_from_later_flights(first_minute):
    flight = first_minute().test[:120]
    check = FlightCheck()
    steps = [("flightcheck", check), ("flightpathreconstruction", FlightPathReconstruction())]
    pipeline = FlightPipeline(steps)
    known = pipeline.fit_transform(flight)["airspeed"]
    check.airspeed_scale_ = AirspeedScale(0.05, 0.001)
    too_much = flight.assign(airspeed=1.05 * flight["airspeed"])
    assert_allclose(pipeline.transform(too_much)["airspeed"], known)
