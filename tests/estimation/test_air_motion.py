"""What the filter-error method recovers from flights, and what it says when it cannot."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less
from pandas.testing import assert_frame_equal

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp._compute.findings import Code
from skdgp._compute.wording import text_of
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, stability_derivatives
from skdgp.estimation import AirSettings, delayed_surfaces, estimate_air_motion, flights_of
from skdgp.estimation._air_parameters import TERMS
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import FlightPathReconstruction

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "small_uav.py"
SURFACES = ["elevator", "aileron", "rudder"]


@cache
def benchmark():
    """The simulation of the benchmark."""
    sys.path.insert(0, str(BENCHMARK.parent))
    spec = importlib.util.spec_from_file_location("small_uav", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(BENCHMARK.parent))
    return module


def simulated(case, seconds, *, pulses=True, seed=3, deflections=False, bank=0.0):
    """Return table and plane of a flight of the trainer, with commands of servos 50 ms late, or deflections."""
    module = benchmark()
    rng = default_rng(seed)
    plane = module.AIRCRAFT["trainer"]
    fleet = module.Fleet([plane], [module.AIRS[case]], [rng], seconds, [0.05])
    fleet.legs = [(bank + 0 * banks, 1.0 + 0 * speeds) for banks, speeds in fleet.legs]
    fleet.pulses[:] = 0.0
    time = module.STEP * np.arange(len(fleet.pulses))
    starts = np.arange(0.5, seconds - 2, 2.0) if pulses else np.zeros(0)
    for k, start in enumerate(starts + rng.uniform(0.0, 0.02, len(starts))):  # between samples
        sign = np.select(
            [time < start, time < start + 0.6, time < start + 1.0, time < start + 1.2, time < start + 1.4],
            [0, 1, -1, 1, -1],
        )  # fmt: skip
        fleet.pulses[:, 0, k % 3] += 0.12 * sign * (-1) ** (k // 3)
    rows = fleet.fly()[:, 0]
    table = module.logged(rows, rng, real=False)
    table[SURFACES] = rows[:, 23:26] if deflections else rows[:, 26:29]
    return table, plane


def as_aircraft(plane):
    sizes = ("mass", "wing_area", "span", "chord", "inertia")
    return Aircraft(**{name: plane[name] for name in sizes})


@cache
def found_in_gusts():
    table, plane = simulated("0.5 m/s, 1 s", seconds=18.0)
    return reconstruction().air_motion_, table, plane


@cache
def pipeline():
    table, plane = simulated("0.5 m/s, 1 s", seconds=18.0)
    targets = aerodynamic_coefficients(table, as_aircraft(plane))
    regressor = DependentGPRegressor(structure="trend", random_state=0)
    model = make_identification_pipeline(as_aircraft(plane), regressor=regressor, lags=None)
    return model.fit(table.drop(columns="alpha_true"), thin_targets(targets, 300))


def reconstruction():
    return pipeline()["flightpathreconstruction"]


def test_derivatives_lie_inside_their_bands():
    found, table, plane = found_in_gusts()
    assert found.converged
    truth = benchmark().truth_of(plane, table["alpha_true"].mean())
    known = [name for name in truth if name in found.derivatives.index]
    value, std, prior = found.derivatives.loc[known].to_numpy().T
    z = (value - [truth[name] for name in known]) / std
    assert len(known) >= 19
    assert np.mean(abs(z) < 1.96) >= 0.85
    assert np.median(1.96 * std / np.abs(value)) < 0.4
    assert np.all(std < 1.05 * prior)
    assert_allclose(np.sqrt(np.diag(found.covariance)), found.derivatives["std"])


def test_lag_wind_and_gusts_are_found():
    found, *_ = found_in_gusts()
    value, std = found.constants["value"], found.constants["std"]
    assert abs(value["servo_lag"] - 0.05) < 0.005 + 2 * std["servo_lag"]
    for name, wind in (("wind_north 0", 3.0), ("wind_east 0", -2.0)):
        assert abs(value[name] - wind) < 3 * std[name]
        assert std[name] < 1.5
    assert 0.3 < found.gusts[0] < 0.8
    assert "servos" in found.summary


def test_turns_tell_wind_and_scale_of_the_pitot():
    """And derivatives are right although the airspeed is not: a scale of 4 % makes forces wrong by 8 %."""
    table, plane = simulated("0.5 m/s, 1 s", seconds=30.0, bank=0.5)
    table["airspeed"] *= 1.04
    found = estimate_air_motion(table.drop(columns="alpha_true"), as_aircraft(plane))
    value, std = found.constants["value"], found.constants["std"]
    known = {"airspeed_scale": 0.04, "wind_north 0": 3.0, "wind_east 0": -2.0}
    for name, truth in known.items():
        assert abs(value[name] - truth) < 3 * std[name]
    assert std["airspeed_scale"] < 0.015  # half of what is known of any pitot
    assert found.converged
    assert found.misfit < 1.2


def test_improbable_constants_of_sensors_widen_all_bands():
    """A thrust of half the true size is five standard deviations from what a bench tells."""
    right, table, plane = found_in_gusts()
    wrong = table.drop(columns="alpha_true").assign(thrust_x=lambda t: t["thrust_x"] / 2)
    found = estimate_air_motion(wrong, as_aircraft(plane))
    assert right.misfit == 1.0
    assert found.misfit > 1.5
    assert "improbable" in found.summary
    wider = found.derivatives["std"] / right.derivatives["std"]
    assert wider.median() > 0.8 * found.misfit


def test_logged_deflections_are_not_late():
    """A lag of zero is at the edge of what a lag can be: the search stays there, and ends."""
    table, plane = simulated("0.5 m/s, 1 s", seconds=18.0, deflections=True)
    found = estimate_air_motion(table.drop(columns="alpha_true"), as_aircraft(plane))
    assert found.converged
    assert 0.0 <= found.constants.loc["servo_lag", "value"] < 0.005


def test_angle_of_attack_follows_the_gusts():
    found, table, plane = found_in_gusts()
    air = estimate_air_motion(table, as_aircraft(plane), known=found).air
    error = air["alpha"] - table["alpha_true"]
    assert error.std() < np.deg2rad(0.5) < 0.5 * table["alpha_true"].std()
    assert np.mean(abs(error) < 1.96 * air["alpha_std"]) > 0.8


def test_another_flight_is_reconstructed_with_the_aircraft_that_is_known():
    found, _, plane = found_in_gusts()
    table, _ = simulated("0.5 m/s, 1 s", seconds=6.0, seed=8)
    out = reconstruction().transform(table)
    blind = FlightPathReconstruction().fit_transform(table)
    errors = [(one["alpha"] - table["alpha_true"]).std() for one in (out, blind)]
    assert errors[0] < np.deg2rad(0.6)
    assert errors[0] < 0.75 * errors[1]
    held = estimate_air_motion(table, as_aircraft(plane), known=found)
    assert_allclose(held.derivatives["value"], found.derivatives["value"])
    assert_allclose(held.air["alpha"], out["alpha"])
    lag = found.constants.loc["servo_lag", "value"]
    late = delayed_surfaces(flights_of(table)[0].sensors, table[SURFACES].to_numpy(), lag)
    assert_allclose(out[SURFACES], late)
    assert list(reconstruction().get_feature_names_out()) == [
        name for name in out if name != "alpha_true"
    ]


def test_slopes_of_a_model_are_the_derivatives_with_their_covariance():
    found, *_ = found_in_gusts()
    value, errors = found.slopes(["CX", "Cm"], ["alpha", "q_hat", "beta"])
    alpha = found.air["alpha"].item()
    d = found.derivatives["value"]
    expected = [
        [d["CX_alpha"] + 2 * alpha * d["CX_alpha2"], np.nan, np.nan],
        [d["Cm_alpha"], d["Cm_q"], np.nan],
    ]
    assert_allclose(value, expected)
    of_Cm = found.covariance.loc[["Cm_alpha", "Cm_q"], ["Cm_alpha", "Cm_q"]]
    assert_allclose(errors[1, :2] @ errors[1, :2].T, of_Cm, rtol=1e-6)


def test_model_of_the_pipeline_has_these_derivatives_and_no_narrower_bands():
    found, _, plane = found_in_gusts()
    state = np.zeros(13)
    state[[3, 5, 6]] = 17.0, 17.0 * np.tan(found.air["alpha"].item()), 1.0
    rest = dict.fromkeys(pipeline()["regressorselector"].regressors_[5:], 0.0)
    at = pipeline(), as_aircraft(plane), state, rest
    flown = stability_derivatives(*at, n_paths=500, thrust=None)
    names = [name for name in found.derivatives.index if name in flown.index and name[:2] != "CX"]
    value, std, _ = found.derivatives.loc[names].to_numpy().T
    assert_array_less(abs(flown.loc[names, "value"] - value), 0.5 * std)
    assert_array_less(0.95 * std, flown.loc[names, "std"])  # of 500 paths, 3 %


def test_calm_flight_without_inputs_has_wide_bands():
    """Where the wind is known from one heading alone, errors of the path seem to be sideslip without moments."""
    table, plane = simulated("calm", seconds=8.0, pulses=False, seed=5)
    found = estimate_air_motion(table.drop(columns="alpha_true"), as_aircraft(plane)).derivatives
    truth = benchmark().truth_of(plane, 0.0)
    known = [name for name in truth if name in found.index]
    value, std, prior = found.loc[known].to_numpy().T
    assert np.all(abs(value - [truth[name] for name in known]) < 3 * std)
    assert np.median(std / prior) > 0.3
    by_sideslip = [name.endswith("_beta") for name in known]
    assert np.all(std[by_sideslip] > 0.9 * prior[by_sideslip])
    assert np.all(std < 1.02 * prior)


def test_table_that_is_too_short_is_refused():
    table, plane = simulated("calm", seconds=1.5, pulses=False)
    with pytest.raises(ValueError, match="Got no record of 100 samples"):
        estimate_air_motion(table.drop(columns="alpha_true"), as_aircraft(plane))


def test_surface_with_a_missing_sample_is_in_the_model():
    table, plane = simulated("calm", seconds=4.0)
    table.loc[20, "elevator"] = np.nan
    flight = table.drop(columns="alpha_true")
    found = estimate_air_motion(flight, as_aircraft(plane), settings=AirSettings(max_passes=1))
    assert "elevator" in found.surfaces


def test_aircraft_known_without_thrust_is_reconstructed_by_its_measured_axial_force():
    """With drag known of the aircraft, but no thrust of the flight, or the other way round."""
    known, table, plane = found_in_gusts()
    table, aircraft = table[:600].drop(columns="alpha_true"), as_aircraft(plane)
    without = estimate_air_motion(table, aircraft, thrust=None, known=known)
    assert abs(without.constants.loc["thrust_scale", "value"]) < 1e-4
    again = estimate_air_motion(table, aircraft, known=without)
    assert_frame_equal(again.air, without.air)


def test_unknown_thrust_is_a_measured_force_and_leaves_drag_unknown():
    table, plane = simulated("0.5 m/s, 1 s", seconds=18.0)
    alpha = table.pop("alpha_true")
    found = estimate_air_motion(table.drop(columns="thrust_x"), as_aircraft(plane))
    assert found.converged
    assert not [name for name in found.derivatives.index if name.startswith("CX")]
    truth = benchmark().truth_of(plane, alpha.mean())
    known = [name for name in truth if name in found.derivatives.index]
    value, std, _ = found.derivatives.loc[known].to_numpy().T
    assert np.mean(abs(value - [truth[name] for name in known]) < 1.96 * std) >= 0.85
    assert_allclose(found.air["ax"].mean(), table["ax"].mean(), atol=0.05)
    value, _ = found.slopes(["CX", "CZ"], ["alpha"])
    assert_array_equal(np.isnan(value[:, 0]), [True, False])


def test_without_terms_of_drag_the_axial_force_is_no_measurement_of_aerodynamics():
    table, plane = simulated("calm", seconds=4.0)
    flight, aircraft = table.drop(columns="alpha_true"), as_aircraft(plane)
    terms = {name: term for name, term in TERMS.items() if name != "CX"}
    settings = AirSettings(max_passes=1)
    found = estimate_air_motion(flight, aircraft, terms=terms, settings=settings)
    without = estimate_air_motion(flight, aircraft, thrust=None, settings=settings)
    assert_frame_equal(found.derivatives, without.derivatives)
    assert_frame_equal(found.air, without.air)


def test_diverged_estimate_is_told_in_plain_words_and_bands_are_wide():
    table, plane = simulated("0.5 m/s, 1 s", seconds=18.0)
    table, aircraft = table.drop(columns="alpha_true"), as_aircraft(plane)

    no_number = AirSettings(first_damping=np.nan)  # so that no step has a solution
    targets = thin_targets(aerodynamic_coefficients(table, aircraft), 300)
    regressor = DependentGPRegressor(structure="trend", random_state=0)
    step = FlightPathReconstruction(optional=True, aircraft=aircraft, settings=no_number)
    model = make_identification_pipeline(
        aircraft, reconstruction=step, regressor=regressor, lags=None
    )
    with pytest.warns(UserWarning, match="Gusts are not known: The estimate diverged"):
        model.fit(table, targets)
    step = model["flightpathreconstruction"]
    assert step.air_motion_ is None
    assert "Singular" not in text_of(step.doubt_)
    assert np.isfinite(step.transform(table)["alpha"]).all()
    state = np.zeros(13)
    state[[3, 5, 6]] = 17.0, 0.5, 1.0
    rest = dict.fromkeys(model["regressorselector"].regressors_[5:], 0.0)
    flown = stability_derivatives(model, aircraft, state, rest, n_paths=500, thrust=None)
    for name, std in (("CZ_alpha", 1.5), ("Cm_q", 10.0), ("Cm_elevator", 1.0)):
        assert flown.loc[name, "std"] > 0.95 * std


def test_flight_that_is_too_short_to_estimate_gusts_is_in_doubt():
    table, plane = simulated("calm", seconds=1.5, pulses=False)
    step = FlightPathReconstruction(aircraft=as_aircraft(plane))
    with pytest.warns(UserWarning, match="Gusts are not known: Got no record of 100 samples"):
        step.fit(table.drop(columns="alpha_true"))
    assert step.doubt_.numbers["cause"].code is Code.AIR_NOT_ESTIMATED


def test_estimate_that_does_not_converge_is_in_doubt():
    table, plane = simulated("calm", seconds=4.0)
    settings = AirSettings(max_passes=1)
    step = FlightPathReconstruction(aircraft=as_aircraft(plane), settings=settings)
    with pytest.warns(UserWarning, match="Gusts are not known: the estimate did not converge"):
        step.fit(table.drop(columns="alpha_true"))
    assert step.doubt_.numbers["cause"].code is Code.AIR_NOT_CONVERGED
    assert not any(step.converged_.values())
    truth = benchmark().truth_of(plane, table["alpha_true"].mean())
    found = step.air_motion_.derivatives
    known = [name for name in truth if name in found.index]
    value, std, prior = found.loc[known].to_numpy().T
    assert np.all(std >= 0.999 * prior)
    assert np.all(abs(value - [truth[name] for name in known]) < 1.96 * std)
