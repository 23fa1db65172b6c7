"""The filter-error method: its linear filter, its derivatives, and what it recovers from flights."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp._flight.frames import euler_to_matrix
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, stability_derivatives
from skdgp.estimation import AirSettings, estimate_air_motion
from skdgp.estimation._air_linearization import N_STATES, Layout, linearized
from skdgp.estimation._air_model import Inputs
from skdgp.estimation._air_parameters import DERIVATIVES, OWN, SHARED, TERMS, derivatives_of
from skdgp.estimation._air_records import Record, servo_output
from skdgp.estimation._kalman import (
    Linearization,
    Noise,
    filtered,
    innovation_slopes,
    innovations,
    smoothed,
)
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import FlightPathReconstruction

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "small_uav.py"
SURFACES = ["elevator", "aileron", "rudder"]
AIRCRAFT = Aircraft(
    mass=1.9,
    inertia=[[0.09, 0.002, -0.015], [0.002, 0.11, 0.001], [-0.015, 0.001, 0.17]],
    wing_area=0.32,
    span=1.27,
    chord=0.25,
)


@cache
def benchmark():
    """The simulation of the benchmark."""
    sys.path.insert(0, str(BENCHMARK.parent))
    spec = importlib.util.spec_from_file_location("small_uav", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(BENCHMARK.parent))
    return module


def linear_system(rng, n=7, N=3, m=2):
    """A filter that is linear, with predictions of a sample by way of the predicted state alone."""
    Phi = 0.5 * rng.standard_normal((n - 1, N, N))
    H = rng.standard_normal((n - 1, m, N))
    y = rng.standard_normal((n - 1, m))
    zero = np.zeros((n - 1, 0, 0))
    linear = Linearization(
        states=np.zeros((n, N)),
        predicted=np.zeros((n - 1, N)),
        transition=Phi,
        transition_slopes=zero,
        innovation=y,
        innovation_states=H @ Phi,
        innovation_noise=H,
        innovation_slopes=zero,
        residual=y,
        residual_states=H,
        residual_slopes=zero,
        step=rng.uniform(0.1, 0.2, n - 1),
        surface_noise=np.zeros((n - 1, N, N)),
        weight=np.ones((n - 1, m)),
        response=zero,
    )
    noises = Noise(
        rate=rng.uniform(1, 2, (1, N)),
        decay=np.zeros((1, N)),
        surface=np.zeros(1),
        sensor=rng.uniform(1, 2, (1, m)),
        start=rng.uniform(1, 2, (1, N)),
    )
    return linear, noises


def test_linear_filter_and_smoother_equal_the_joint_gaussian_distribution():
    linear, noises = linear_system(np.random.default_rng(0))
    run = filtered(linear, noises)
    (n, N), m = linear.states.shape, linear.innovation.shape[1]
    # x = M (x_0, w_1, ...), y = H x + v; the noise of a step by Simpson's rule
    M = np.zeros((n, N, n * N))
    M[0, :, :N] = np.eye(N)
    Q = [np.diag(noises.start[0])]
    for k in range(1, n):
        Phi = linear.transition[k - 1]
        M[k] = Phi @ M[k - 1]
        M[k, :, k * N : (k + 1) * N] += np.eye(N)
        half, rate = 0.5 * (np.eye(N) + Phi), np.diag(noises.rate[0] * linear.step[k - 1])
        Q.append((rate + 4 * half @ rate @ half.T + Phi @ rate @ Phi.T) / 6)
    M = M.reshape(n * N, n * N)
    X = M @ block_diag(*Q) @ M.T
    H = np.hstack([np.zeros(((n - 1) * m, N)), block_diag(*linear.residual_states)])
    S = H @ X @ H.T + np.diag(np.tile(noises.sensor[0], n - 1))
    y = linear.innovation.ravel()
    for k in range(n - 1):
        past, now = slice(0, k * m), slice(k * m, (k + 1) * m)
        gain = S[now, past] @ np.linalg.inv(S[past, past])
        np.testing.assert_allclose(run.innovations.values[k], y[now] - gain @ y[past], atol=1e-10)
        np.testing.assert_allclose(
            run.innovations.covariance[k], S[now, now] - gain @ S[past, now], atol=1e-10
        )
    states, covariance = smoothed(linear, run)
    gain = X @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(states.ravel(), gain @ y, atol=1e-10)
    P = X - gain @ H @ X
    for k in range(n):
        at = slice(k * N, (k + 1) * N)
        np.testing.assert_allclose(covariance[k], P[at, at], atol=1e-10)


def test_sets_of_noises_are_filtered_as_one_by_one():
    linear, noises = linear_system(np.random.default_rng(1))
    sets = Noise(*(np.concatenate([part, 2 * part]) for part in noises))
    together = innovations(linear, sets)
    for k in range(2):
        alone = filtered(linear, Noise(*(part[k : k + 1] for part in sets))).innovations
        np.testing.assert_allclose(together.values[:, k], alone.values)
        np.testing.assert_allclose(together.covariance[:, k], alone.covariance)


@cache
def flight_of_sines(n=30):
    """A record at states where nothing vanishes, parameters by name, and states of the filter."""
    rng = np.random.default_rng(2)
    t = 0.02 * np.arange(n)[:, None]
    wave = lambda k: np.sin(2 * t + rng.uniform(0, 6, k))  # noqa: E731
    attitude = np.swapaxes(euler_to_matrix(*(0.3 * wave(3) + np.array([0.1, 0.2, 1.0])).T), 1, 2)
    inputs = Inputs(0.1 * wave(3), wave(6) + 2, np.full(n, 1.2))
    measured = np.column_stack([3 * wave(3), 0.5 * wave(3), 17 + wave(1), 0.1 * wave(2)])
    record = Record(
        0,
        np.arange(n),
        t[:, 0],
        0.3 * wave(3) + np.array([17.0, 1.0, 1.5]),
        attitude,
        measured,
        inputs,
    )
    derivatives = derivatives_of(TERMS, SURFACES)
    value = {name: DERIVATIVES.get(name, (0.01, 0))[0] for name in derivatives}
    value |= {
        name: mean + 0.3 * min(std, 5.0) for name, (mean, std) in (dict(SHARED) | OWN).items()
    }
    value |= {"servo_lag": 0.03}
    states = 0.2 * wave(N_STATES)
    return record, Layout.of(list(derivatives), SURFACES), value, states


DECAY = np.append(np.linspace(0.3, 2.0, N_STATES - 3), np.zeros(3))


def moved(name, move):
    record, layout, value, states = flight_of_sines()
    value = value | {name: value[name] + move}
    return linearized(record, layout, AIRCRAFT, value, states, DECAY)


@pytest.mark.parametrize("name", flight_of_sines()[1].names)
def test_slopes_by_parameters_are_those_of_the_predictions(name):
    here, step = moved(name, 0.0), 1e-5
    later, before = moved(name, step), moved(name, -step)
    j = flight_of_sines()[1].names.index(name)
    pairs = (
        ("predicted", here.transition_slopes),
        ("innovation", -here.innovation_slopes),
        ("residual", -here.residual_slopes),
    )
    for field, slopes in pairs:
        numeric = (getattr(later, field) - getattr(before, field)) / (2 * step)
        if field == "residual":  # the state that it starts from moves as well
            numeric += (here.residual_states @ here.transition_slopes)[..., j]
        scale = np.abs(numeric).max() + 1e-3
        # terms within a step are taken as the mean of its ends, which is least true of rates
        atol = 0.2 if name.endswith(("_p", "_q", "_r")) else 0.05
        np.testing.assert_allclose(slopes[..., j] / scale, numeric / scale, atol=atol)


def test_slopes_by_states_are_those_of_the_predictions():
    record, layout, value, states = flight_of_sines()
    here = linearized(record, layout, AIRCRAFT, value, states, DECAY)
    for i in range(N_STATES):
        shift = np.zeros(N_STATES)
        shift[i] = 1e-5
        later, before = (
            linearized(record, layout, AIRCRAFT, value, states + sign * shift, DECAY)
            for sign in (1, -1)
        )
        for field, slopes in (
            ("predicted", here.transition),
            ("innovation", -here.innovation_states),
            ("residual", -here.residual_states @ here.transition),
        ):
            numeric = (getattr(later, field) - getattr(before, field)) / 2e-5
            np.testing.assert_allclose(slopes[..., i], numeric, atol=2e-2 * np.abs(numeric).max())


def test_instruments_are_moved_by_surfaces_and_hardly_by_gusts():
    record, layout, value, calm = flight_of_sines(200)
    record.inputs.surfaces[:] *= 5
    gusty = calm.copy()
    gusty[:, :3] += np.random.default_rng(0).standard_normal((200, 3))
    still = record._replace(inputs=record.inputs._replace(surfaces=np.zeros((200, 3))))
    at = np.array([layout.names.index(name) for name in ("CZ_0", "CZ_alpha")])
    slopes, instruments = [], []
    for flown, states in ((record, calm), (record, gusty), (still, gusty)):
        linear = linearized(flown, layout, AIRCRAFT, value, states, DECAY)
        for columns, out in ((at, slopes), (len(layout.names) + at, instruments)):
            offset, slope = linear.innovation_slopes[:, 2, columns].T
            out.append(
                slope - offset * (offset @ slope) / (offset @ offset)
            )  # without the pressure
    assert np.corrcoef(slopes)[0, 1] < 0.7
    assert np.corrcoef(instruments)[0, 1] > 0.95
    assert np.std(instruments[2]) < 0.01 * np.std(instruments[1])


def test_answers_are_the_part_of_surfaces_that_earlier_innovations_explain():
    record, *_ = flight_of_sines(2000)
    pushes, later = np.random.default_rng(0).standard_normal((2, 1999))
    answer = np.convolve(np.append(0, pushes), 0.9 ** np.arange(50))[:2000]
    record.inputs.surfaces[:, 0] = answer
    record.inputs.surfaces[:, 1] = np.append(later[3:], np.zeros(4))
    answers = record.with_answers(np.column_stack([pushes, later]), AirSettings()).answers
    assert np.std(answer - answers[:, 0]) < 0.15 * np.std(answer)
    assert np.std(answers[:, 1]) < 0.2 * np.std(later)


def test_slopes_of_innovations_are_those_of_a_filter_with_the_same_gains():
    linear, noises = linear_system(np.random.default_rng(3))
    (n, N), m = linear.states.shape, linear.innovation.shape[1]
    slopes = np.random.default_rng(4).standard_normal((n - 1, N, 1))
    linear = linear._replace(
        transition_slopes=slopes,
        innovation_slopes=linear.residual_states @ slopes,
        residual_slopes=np.zeros((n - 1, m, 1)),
    )
    run = filtered(linear, noises)
    push = 1e-6 * linear.residual_states @ slopes
    moved = linear._replace(
        predicted=linear.predicted + 1e-6 * slopes[..., 0],
        innovation=linear.innovation - push[..., 0],
        residual=linear.residual - push[..., 0],
    )
    change = (filtered(moved, noises).innovations.values - run.innovations.values) / 1e-6
    np.testing.assert_allclose(innovation_slopes(linear, run)[..., 0], change, atol=1e-6)


def test_lag_of_a_ramp_is_the_lag():
    ramp = np.arange(200.0)[:, None]
    np.testing.assert_allclose(servo_output(ramp, 0.1, 0.02)[100:], ramp[100:] - 5.0, atol=1e-6)
    np.testing.assert_allclose(servo_output(ramp, 0.0, 0.02), ramp, atol=0.01)


def simulated(case, seconds, *, pulses=True, seed=3, deflections=False, bank=0.0):
    """Return table and plane of a flight of the trainer, with commands of servos 50 ms late, or deflections."""
    module = benchmark()
    rng = np.random.default_rng(seed)
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
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.derivatives["std"])


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


def test_slope_by_a_lag_of_zero_is_that_above_it():
    record, layout, value, states = flight_of_sines()
    at_zero, above = (
        linearized(record, layout, AIRCRAFT, value | {"servo_lag": lag}, states, DECAY)
        for lag in (0.0, 1e-3)
    )
    j = layout.place("servo_lag")[0]
    expected = above.innovation_slopes[..., j]
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(
        at_zero.innovation_slopes[..., j], expected, atol=0.1 * np.abs(expected).max()
    )


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
    np.testing.assert_allclose(held.derivatives["value"], found.derivatives["value"])
    np.testing.assert_allclose(held.air["alpha"], out["alpha"])
    lag = found.constants.loc["servo_lag", "value"]
    np.testing.assert_allclose(out[SURFACES], servo_output(table[SURFACES].to_numpy(), lag, 0.02))
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
    np.testing.assert_allclose(value, expected)
    of_Cm = found.covariance.loc[["Cm_alpha", "Cm_q"], ["Cm_alpha", "Cm_q"]]
    np.testing.assert_allclose(errors[1, :2] @ errors[1, :2].T, of_Cm, rtol=1e-6)


def test_model_of_the_pipeline_has_these_derivatives_and_no_narrower_bands():
    found, _, plane = found_in_gusts()
    state = np.zeros(13)
    state[[3, 5, 6]] = 17.0, 17.0 * np.tan(found.air["alpha"].item()), 1.0
    rest = dict.fromkeys(pipeline()["regressorselector"].regressors_[5:], 0.0)
    at = pipeline(), as_aircraft(plane), state, rest
    flown = stability_derivatives(*at, n_paths=500, thrust=None)
    names = [name for name in found.derivatives.index if name in flown.index and name[:2] != "CX"]
    value, std, _ = found.derivatives.loc[names].to_numpy().T
    np.testing.assert_array_less(abs(flown.loc[names, "value"] - value), 0.5 * std)
    np.testing.assert_array_less(0.95 * std, flown.loc[names, "std"])  # of 500 paths, 3 %


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
    np.testing.assert_allclose(found.air["ax"].mean(), table["ax"].mean(), atol=0.05)
    value, _ = found.slopes(["CX", "CZ"], ["alpha"])
    np.testing.assert_array_equal(np.isnan(value[:, 0]), [True, False])


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
    assert "Singular" not in step.doubt_
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
    assert step.doubt_.startswith("Got no record")


def test_estimate_that_does_not_converge_is_in_doubt():
    table, plane = simulated("calm", seconds=4.0)
    settings = AirSettings(max_passes=1)
    step = FlightPathReconstruction(aircraft=as_aircraft(plane), settings=settings)
    with pytest.warns(UserWarning, match="Gusts are not known: the estimate did not converge"):
        step.fit(table.drop(columns="alpha_true"))
    assert step.doubt_
    assert not any(step.converged_.values())
    truth = benchmark().truth_of(plane, table["alpha_true"].mean())
    found = step.air_motion_.derivatives
    known = [name for name in truth if name in found.index]
    value, std, prior = found.loc[known].to_numpy().T
    assert np.all(std >= 0.999 * prior)
    assert np.all(abs(value - [truth[name] for name in known]) < 1.96 * std)
