"""What the filter-error method recovers from flights, and what it says when it cannot."""

import warnings
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
import uav_flight
from flight_columns import FORCES, RATES, SPIN, SURFACES
from log_errors import elsewhere, held
from made_flights import rms
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less
from pandas.testing import assert_frame_equal
from sklearn.base import clone

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.design import three_two_one_one
from skdgp.dynamics import Aircraft, Servos, aerodynamic_coefficients, stability_derivatives
from skdgp.estimation import AirSettings, estimate_air_motion, flights_of, servo_output
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import FlightCheck, FlightDataWarning, FlightPathReconstruction

GUSTY = "0.5 m/s, 1 s"


class Flown(NamedTuple):
    """A flight table, the true angle of attack and derivatives, and the aircraft."""

    table: pd.DataFrame
    alpha: pd.Series
    truth: dict[str, float]
    aircraft: Aircraft

    def estimate(self, **options) -> Any:
        return estimate_air_motion(self.table, self.aircraft, **options)

    def compared(self, found) -> Any:
        """Return values, standard deviations, those of the prior, and the truth, of each derivative that is known."""
        known = [name for name in self.truth if name in found.derivatives.index]
        return *found.derivatives.loc[known].to_numpy().T, [self.truth[name] for name in known]

    def recovered(self, found, fraction=0.85) -> Any:
        """Assert that an estimate converged and that a fraction of its bands holds; return as `compared`."""
        assert found.converged
        value, std, prior, truth = self.compared(found)
        assert np.mean(abs(value - truth) < 1.96 * std) >= fraction
        return value, std, prior, truth


def pulses(time, starts):
    """Return 3-2-1-1s (n, 3) of elevator, aileron, rudder, one after the other, both ways."""
    inputs = np.zeros((len(time), 3))
    for k, start in enumerate(starts):
        inputs[:, k % 3] += three_two_one_one(0.2, 0.12 * (-1) ** (k // 3))(time - start)
    return inputs


def flown(
    case, seconds, *, inputs=True, seed=3, deflections=False, bank=0.0, arm=None, **properties
):
    """Return a flight of the trainer, with commands of servos 50 ms late, or deflections.

    The aircraft states that its inertial sensors are at ``arm`` [m], None: at the centre of gravity,
    and unknown. Its ``properties`` are Cl and Cm by thrust (``thrust_arm``) and the ``slipstream`` on
    the tail, with which airspeeds change every 15 s.
    """
    rng = default_rng(seed)
    plane = uav_flight.AIRCRAFT["trainer"] | properties
    starts = np.arange(0.5, seconds - 2, 2.0) if inputs else np.zeros(0)
    starts = starts + rng.uniform(0.0, 0.02, len(starts))  # between samples
    commands = pulses(np.arange(0.0, seconds, uav_flight.STEP), starts)
    speeds = uav_flight.SPEEDS if plane["slipstream"] else (1.0, 1.0)
    air = uav_flight.AIRS[case]
    true = uav_flight.fly(plane, air, rng, seconds, 0.05, commands, banks=[bank], speeds=speeds)
    table = uav_flight.logged(true, rng, "ideal")
    if arm is not None:
        table = elsewhere(table, arm, true[SPIN].to_numpy())
    table[SURFACES] = true[SURFACES if deflections else uav_flight.COMMANDS]
    alpha = table.pop("alpha_true")
    aircraft = replace(uav_flight.aircraft_of(plane), sensor_position=arm)
    pressure = 0.5 * table["density"] * table["airspeed"] ** 2
    loading = (table["thrust_x"] / (pressure * plane["wing_area"])).mean()
    return Flown(table, alpha, uav_flight.truth_of(plane, alpha.mean(), loading), aircraft)


@cache
def in_gusts():
    return flown(GUSTY, 10.0)


def pipeline_of(flight, n_targets, **steps):
    """Return a model that learned from a flight."""
    targets = thin_targets(aerodynamic_coefficients(flight.table, flight.aircraft), n_targets)
    regressor = DependentGPRegressor(structure="trend", random_state=0)
    model = make_identification_pipeline(flight.aircraft, regressor=regressor, lags=None, **steps)
    return model.fit(flight.table, targets)


@cache
def pipeline():
    step = FlightPathReconstruction(aircraft=in_gusts().aircraft)
    return pipeline_of(in_gusts(), 300, reconstruction=step)


@cache
def regressors_in_gusts():
    return np.asarray(pipeline()[:-1].transform(in_gusts().table))


def reconstruction():
    return pipeline()["flightpathreconstruction"]


def found_in_gusts():
    return reconstruction().air_motion_


def flown_derivatives(model, flight, alpha):
    """Return the derivatives of a model in level flight at 17 m/s."""
    state = np.zeros(13)
    state[[3, 5, 6]] = 17.0, 17.0 * np.tan(alpha), 1.0
    rest = dict.fromkeys(model["regressorselector"].regressors_[5:], 0.0)
    return stability_derivatives(model, flight.aircraft, state, rest, n_paths=500, thrust=None)


def test_derivatives_lie_inside_their_bands():
    found = found_in_gusts()
    value, std, prior, truth = in_gusts().recovered(found)
    assert len(truth) >= 19
    assert np.median(1.96 * std / np.abs(value)) < 0.4
    assert_array_less(std, 1.05 * prior)
    assert_allclose(np.sqrt(np.diag(found.covariance)), found.derivatives["std"])


@pytest.mark.slow
def test_a_stated_position_of_sensors_half_a_metre_ahead_narrows_the_bands():
    """To less than half of those without it (0.26 and 0.40 of them with two seeds)."""
    flight = flown(GUSTY, 12.0, arm=(0.5, 0.05, -0.1))
    found = flight.estimate()
    _, std, *_ = flight.recovered(found)
    unknown = flight._replace(aircraft=replace(flight.aircraft, sensor_position=None))
    _, without_position, _, _ = unknown.compared(unknown.estimate())
    assert np.median(std / without_position) < 0.5
    arms = found.constants.loc[["arm_x", "arm_y", "arm_z"]]
    assert_array_less(abs(arms["value"]), 3 * arms["prior_std"])
    assert np.std(found.air["alpha"] - flight.alpha) < np.deg2rad(0.25)


@pytest.mark.slow
def test_a_wrong_position_of_the_sensors_is_told_and_widens_all_bands():
    """Stated 20 cm above where they are."""
    flight = flown(GUSTY, 12.0, arm=(0.0, 0.0, 0.0))
    wrong = replace(flight.aircraft, sensor_position=(0.0, 0.0, -0.2))
    with pytest.warns(UserWarning, match="inertial sensors are 0.[12]"):
        motion = FlightPathReconstruction(aircraft=wrong).fit(flight.table).air_motion_
    assert motion.misfit > 2
    assert flight.estimate().position_error() is None


def test_lag_wind_and_gusts_are_found():
    found = found_in_gusts()
    value, std = found.constants["value"], found.constants["std"]
    assert_allclose(value["servo_lag"], 0.05, rtol=0, atol=0.005 + 2 * std["servo_lag"])
    for name, wind in {"wind_north 0": 3.0, "wind_east 0": -2.0}.items():
        assert_allclose(value[name], wind, rtol=0, atol=3 * std[name])
        assert std[name] < 1.5
    assert 0.3 < found.gusts[0] < 0.8
    assert "servos" in found.summary


def test_surfaces_of_slow_clocks_are_known_by_their_samples_alone():
    """Whether rows repeat the samples, or hold a spline through them."""
    flight = flown(GUSTY, 6.0)
    table = held(flight.table, SURFACES, 5)
    with pytest.warns(FlightDataWarning, match="slower clocks"):
        between = FlightCheck().fit_transform(table)
    assert np.any(between[SURFACES] != table[SURFACES])
    settings = AirSettings(max_passes=2)
    repeated = estimate_air_motion(table, flight.aircraft, settings=settings)
    splines = estimate_air_motion(between, flight.aircraft, settings=settings)
    assert_frame_equal(repeated.derivatives, splines.derivatives)


def test_rows_without_a_sample_tell_nothing_of_the_noise():
    """The airspeed has a noise of 0.3 m/s, and one sample in five rows."""
    flight = flown(GUSTY, 8.0)
    flight.table.loc[np.arange(len(flight.table)) % 5 != 0, "airspeed"] = np.nan
    found = flight.estimate(settings=AirSettings(max_passes=8))
    assert_allclose(found.noise["airspeed"], 0.3, rtol=0.3)


@pytest.mark.slow
def test_derivatives_of_a_flight_that_vibrates():
    """All inertial sensors feel the propeller, by 15 and 6 times their noise, at frequencies that follow its speed."""
    flight = flown(GUSTY, 25.0)
    throttle = flight.table["throttle"].to_numpy()
    flight.table[FORCES + RATES] += uav_flight.vibration(default_rng(2), throttle, 0.02)
    found = flight.estimate()
    assert found.vibrates
    assert "vibrate" in found.summary
    value, std, prior_std, truth = flight.recovered(found, 0.9)
    assert np.median(abs(value / truth - 1)) < 0.2
    assert np.median(std / prior_std) < 0.3
    assert not in_gusts().estimate(settings=AirSettings(max_passes=1)).vibrates


@pytest.mark.slow
def test_moments_of_the_thrust_are_couplings():
    """A thrust line above the centre of gravity, and the torque of the propeller, in changing speeds."""
    flight = flown(GUSTY, 20.0, thrust_arm=(-0.02, 0.1))
    found = flight.estimate()
    for name, moment in (("Cl_thrust", -0.02), ("Cm_thrust", 0.1)):
        value, std, _ = found.derivatives.loc[name]
        assert_allclose(value, moment, rtol=0, atol=2 * std)
    flight.recovered(found)


@pytest.mark.slow
def test_a_slipstream_makes_the_tail_stronger_with_thrust():
    flight = flown(GUSTY, 60.0, slipstream=2.0)
    found = flight.estimate()
    factor, std = found.constants.loc["slipstream", ["value", "std"]]
    assert_allclose(factor, 2.0, rtol=0, atol=2.5 * std)
    assert std < 0.5
    flight.recovered(found, 0.8)


@pytest.mark.slow
def test_turns_tell_wind_and_scale_of_the_pitot():
    """And derivatives are right although the airspeed is not: a scale of 4 % makes forces wrong by 8 %."""
    flight = flown(GUSTY, 30.0, bank=0.5)
    flight.table["airspeed"] *= 1.04
    found = flight.estimate()
    value, std = found.constants["value"], found.constants["std"]
    known = {"airspeed_scale": 0.04, "wind_north 0": 3.0, "wind_east 0": -2.0}
    for name, truth in known.items():
        assert_allclose(value[name], truth, rtol=0, atol=3 * std[name])
    assert std["airspeed_scale"] < 0.015  # half of what is known of any pitot
    assert found.converged
    assert found.misfit < 1.2


@pytest.mark.slow
def test_improbable_constants_of_sensors_widen_all_bands():
    """A thrust of half the true size is five standard deviations from what a bench tells."""
    right, flight = found_in_gusts(), in_gusts()
    half = flight.table["thrust_x"] / 2
    found = flight._replace(table=flight.table.assign(thrust_x=half)).estimate()
    assert right.misfit == 1.0
    assert found.misfit > 1.5
    assert "thrust_scale is 0." in found.summary
    wider = found.derivatives["std"] / right.derivatives["std"]
    assert wider.median() > 0.8 * found.misfit


def test_bands_hold_a_derivative_whose_surface_is_logged_wrongly_for_a_while():
    flight = flown("calm", 16.0)
    table = flight.table.copy()
    table.loc[table["time"] > 8.0, "aileron"] *= 0.5
    found = flight._replace(table=table).estimate().derivatives.loc["Cl_aileron"]
    assert_allclose(found["value"], flight.truth["Cl_aileron"], rtol=0, atol=1.96 * found["std"])


@pytest.mark.slow
def test_motion_that_follows_a_surface_is_no_answer_to_gusts():
    """Of a wing whose autopilot holds its attitude in rough air; slopes by alpha were half of the truth."""
    rng = default_rng([1, *map(ord, "flying wingmoderatereal")])
    plane = uav_flight.AIRCRAFT["flying wing"]
    lag = rng.uniform(0.02, 0.08)
    true = uav_flight.fly(plane, uav_flight.AIRS["1 m/s, 2 s"], rng, 60.0, lag)
    table = uav_flight.logged(true, rng, "real").drop(columns="alpha_true")
    found = estimate_air_motion(table, uav_flight.aircraft_of(plane)).derivatives
    slopes = found.loc[["CZ_alpha", "Cm_alpha"]]
    assert_array_less(abs(slopes["value"] - [-3.5, -0.5]), 2.5 * slopes["std"])
    assert_array_less(slopes["std"], [0.8, 0.15])


def test_logged_deflections_are_not_late():
    """A lag of zero is at the edge of what a lag can be: the search stays there, and ends."""
    found = flown(GUSTY, 6.0, deflections=True).estimate()
    assert found.converged
    assert abs(found.constants.loc["servo_lag", "value"]) < 0.005


def test_a_delay_of_the_servos_that_is_hardly_known_widens_the_bands():
    flight, known = in_gusts(), found_in_gusts().derivatives
    table = flight.table.assign(servo_delay_std=0.05)
    found = estimate_air_motion(table, flight.aircraft).derivatives
    assert_allclose(found["value"], known["value"], rtol=1e-9)
    assert (found["std"] > known["std"] * (1 - 1e-9)).all()
    assert found.loc["Cm_q", "std"] > 2 * known.loc["Cm_q", "std"]


def test_angle_of_attack_follows_the_gusts():
    flight = in_gusts()
    air = flight.estimate(known=found_in_gusts()).air
    error = air["alpha"] - flight.alpha
    assert error.std() < np.deg2rad(0.5) < 0.5 * flight.alpha.std()
    assert np.mean(abs(error) < 1.96 * air["alpha_std"]) > 0.8


def test_another_flight_is_reconstructed_with_the_aircraft_that_is_known():
    found, flight = found_in_gusts(), flown(GUSTY, 6.0, seed=8)
    out = reconstruction().transform(flight.table)
    blind = FlightPathReconstruction().fit_transform(flight.table)
    error = (out["alpha"] - flight.alpha).std()
    assert error < np.deg2rad(0.6)
    assert error < 0.75 * (blind["alpha"] - flight.alpha).std()
    held = flight.estimate(known=found)
    assert_allclose(held.derivatives["value"], found.derivatives["value"])
    assert_allclose(held.air["alpha"], out["alpha"])
    lag = found.constants.loc["servo_lag", "value"]
    sensors = flights_of(flight.table)[0].sensors
    late = servo_output(flight.table[SURFACES].to_numpy(), lag, np.diff(sensors.time)[0])
    assert_allclose(out[SURFACES], late)
    assert list(reconstruction().get_feature_names_out()) == list(out)


def test_flights_of_the_fit_are_transformed_as_others_are():
    flight = flown("calm", 4.0)
    step = FlightPathReconstruction(aircraft=flight.aircraft, settings=AirSettings(max_passes=3))
    with warnings.catch_warnings(action="ignore"):
        at_once = clone(step).fit_transform(flight.table)
        assert_frame_equal(at_once, step.fit(flight.table).transform(flight.table))


def test_flights_that_are_shortened_to_learn_from_have_angles_throughout():
    flight = flown("calm", 4.0)
    few = AirSettings(max_passes=1, most_samples=150)
    step = FlightPathReconstruction(aircraft=flight.aircraft, settings=few)
    with pytest.warns(UserWarning, match="did not converge"):
        out = step.fit_transform(flight.table)
    assert np.isfinite(out["alpha"]).all()


def test_a_search_that_begins_with_a_part_of_the_flight_ends_where_others_end():
    flight = in_gusts()
    begun_with_a_part = flight.estimate(settings=AirSettings(most_samples=len(flight.table)))
    value, std, *_ = flight.recovered(begun_with_a_part)
    usual, *_ = flight.compared(found_in_gusts())
    assert np.mean(((value - usual) / std) ** 2) < 0.5**2
    assert np.isfinite(begun_with_a_part.air["alpha"]).all()


def test_slopes_of_a_model_are_the_derivatives_with_their_covariance():
    found = found_in_gusts()
    value, errors = found.slopes(["CX", "Cm"], ["alpha", "q_hat", "throttle"])
    d = found.derivatives["value"]
    CX_alpha = d["CX_alpha"] + 2 * found.air["alpha"].item() * d["CX_alpha2"]
    assert_allclose(value, [[CX_alpha, d["CX_q"], np.nan], [d["Cm_alpha"], d["Cm_q"], np.nan]])
    of_Cm = found.covariance.loc[["Cm_alpha", "Cm_q"], ["Cm_alpha", "Cm_q"]]
    assert_allclose(errors[1, :2] @ errors[1, :2].T, of_Cm, rtol=1e-6)


def test_model_of_the_pipeline_has_these_derivatives_and_no_narrower_bands():
    found = found_in_gusts()
    flown = flown_derivatives(pipeline(), in_gusts(), found.air["alpha"].item())
    names = [name for name in found.derivatives.index if name in flown.index and name[:2] != "CX"]
    value, std, _ = found.derivatives.loc[names].to_numpy().T
    assert_array_less(abs(flown.loc[names, "value"] - value), 0.5 * std)
    assert_array_less(0.92 * std, flown.loc[names, "std"])  # of 500 paths, 3 %


def test_predictions_of_logged_rows_have_no_larger_errors_than_least_squares():
    """The function has the slopes of the aircraft, which are too steep for regressors with errors."""
    model, X = pipeline(), regressors_in_gusts()
    table = in_gusts().table
    Y = aerodynamic_coefficients(table, in_gusts().aircraft)
    design = np.column_stack([np.ones(len(X)), X])
    least_squares = design @ np.linalg.lstsq(design, Y, rcond=None)[0]
    mean = model.predict(table)
    of_rows, of_function, least = (
        rms(Y - predicted) for predicted in (mean, model[-1].predict(X), least_squares)
    )
    assert_array_less(of_rows, 1.03 * least)
    assert np.max(of_function / least) > 1.05


@pytest.mark.slow
def test_calm_flight_without_inputs_has_wide_bands():
    """Where the wind is known from one heading alone, errors of the path seem to be sideslip without moments."""
    flight = flown("calm", 8.0, inputs=False, seed=5)
    found = flight.estimate()
    value, std, prior, truth = flight.compared(found)
    assert_array_less(abs(value - truth), 3 * std)
    assert np.median(std / prior) > 0.3
    by_sideslip = found.derivatives.filter(regex="_beta$", axis="index")
    assert_array_less(0.9 * by_sideslip.iloc[:, 2], by_sideslip["std"])
    # beyond the prior by how far a search that did not converge still moves
    assert_array_less(std, (1.02 if found.converged else 2.0) * prior)


def test_surface_with_a_missing_sample_is_in_the_model():
    flight = flown("calm", 4.0)
    flight.table.loc[20, "elevator"] = np.nan
    assert "elevator" in flight.estimate(settings=AirSettings(max_passes=1)).surfaces


def test_aircraft_known_without_thrust_is_reconstructed_by_its_measured_axial_force():
    """With drag known of the aircraft, but no thrust of the flight, or the other way round."""
    flight = in_gusts()._replace(table=in_gusts().table[:600])
    without = flight.estimate(thrust=None, known=found_in_gusts())
    assert abs(without.constants.loc["thrust_scale", "value"]) < 1e-4
    assert_frame_equal(flight.estimate(known=without).air, without.air)


@pytest.mark.slow
def test_unknown_thrust_is_a_measured_force_and_leaves_drag_unknown():
    flight = flown(GUSTY, 18.0)
    found = flight._replace(table=flight.table.drop(columns="thrust_x")).estimate()
    assert not [name for name in found.derivatives.index if name.startswith("CX")]
    flight.recovered(found)
    assert_allclose(found.air["ax"].mean(), flight.table["ax"].mean(), atol=0.05)
    value, _ = found.slopes(["CX", "CZ"], ["alpha"])
    assert_array_equal(np.isnan(value[:, 0]), [True, False])


def test_diverged_estimate_is_told_in_plain_words_and_bands_are_wide():
    """No step has a solution."""
    flight = in_gusts()._replace(table=in_gusts().table[:500])
    no_number = AirSettings(first_damping=np.nan)
    step = FlightPathReconstruction(aircraft=flight.aircraft, settings=no_number)
    with pytest.warns(
        UserWarning, match="Gusts without vanes are not known: The estimate diverged"
    ) as said:
        model = pipeline_of(flight, 100, reconstruction=step)
    assert not any("Singular" in str(warning.message) for warning in said)
    step = model["flightpathreconstruction"]
    assert step.air_motion_ is None
    assert step.servos_ == Servos()
    assert np.isfinite(step.transform(flight.table)["alpha"]).all()
    flown = flown_derivatives(model, flight, 0.03)
    for name, std in (("CZ_alpha", 1.5), ("Cm_q", 10.0), ("Cm_elevator", 1.0)):
        assert flown.loc[name, "std"] > 0.95 * std


def test_a_record_without_airspeed_does_not_spoil_the_mean_thrust():
    flight, aircraft = in_gusts().table.iloc[:600], in_gusts().aircraft
    settings = AirSettings(max_passes=1)
    alone = estimate_air_motion(flight, aircraft, settings=settings).mean_thrust
    assert 0.01 < alone < 0.2
    blind = flight.assign(time=flight["time"] + 100.0, airspeed=np.nan)
    both = pd.concat([flight, blind], ignore_index=True)
    found = estimate_air_motion(both, aircraft, settings=settings).mean_thrust
    assert_allclose(found, alone, rtol=1e-3)


def test_flight_that_is_too_short_to_estimate_gusts_is_refused_or_in_doubt():
    flight = flown("calm", 1.5, inputs=False)
    with pytest.raises(ValueError, match="Got no record of 100 samples"):
        flight.estimate()
    step = FlightPathReconstruction(aircraft=flight.aircraft)
    with pytest.warns(
        UserWarning, match="Gusts without vanes are not known: Got no record of 100 samples"
    ):
        step.fit(flight.table)
    (doubt,) = step.doubts_
    assert doubt.numbers["cause"].code.name == "AIR_NOT_ESTIMATED"


def test_estimate_that_does_not_converge_is_in_doubt():
    flight = flown("calm", 4.0)
    step = FlightPathReconstruction(aircraft=flight.aircraft, settings=AirSettings(max_passes=1))
    with pytest.warns(UserWarning, match="the estimate of the motion of the air did not converge"):
        step.fit(flight.table)
    (doubt,) = step.doubts_
    assert doubt.numbers["cause"].code.name == "AIR_NOT_CONVERGED"
    assert "The channels agree by physics. Give longer flights" in doubt.text
    value, std, prior, truth = flight.compared(step.air_motion_)
    assert_array_less(0.999 * prior, std)
    assert_array_less(abs(value - truth), 1.96 * std)
