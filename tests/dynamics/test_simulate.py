"""Simulation against independent equations, the pipeline's own regressors, and what must hold of any flight."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS, EULER, FORCES, RATES, SURFACES, VELOCITY, WIND
from made_flights import make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Drift,
    Propeller,
    Servos,
    SimulationWarning,
    Simulator,
    as_aerodynamics,
    simulate,
    standard_density,
    trajectory_bands,
)
from skdgp.preprocessing import (
    ElevonSplitter,
    LagCorrector,
    RateNondimensionalizer,
    RegressorSelector,
)

START = {
    "airspeed": 22.0, "alpha": 0.08, "beta": 0.02, "phi": 0.3, "theta": 0.1, "psi": 1.0, "p": 0.1, "q": 0.05,
    "r": -0.1, "north": 10.0, "east": -20.0, "altitude": 300.0,
}  # fmt: skip
STATES = [*VELOCITY, *EULER, *RATES, "north", "east", "down", "airspeed"]
REST = dict.fromkeys(SURFACES, 0.0)
WIND_OVER_GROUND = [3.0, -2.0, 0.7]


def commands(t, state=None):
    return {
        "elevator": -0.02 + 0.03 * np.sin(2.0 * t), "aileron": 0.03 * np.cos(1.5 * t), "rudder": 0.04 * np.sin(t + 1.0),
        "thrust": 14.0 + 3.0 * np.sin(0.9 * t),
    }  # fmt: skip


def table_of(duration, step=0.001):
    t = np.arange(0, duration + step / 2, step)
    return pd.DataFrame({"time": t, **commands(t)})


SCHEDULE = table_of(10.0, 0.0005)  # with rows at every stage


@pytest.fixture(scope="module")
def fly(aircraft, glider):
    """Return `simulate` of the glider's coefficients, or of another model."""

    def fly(model=None, x0=START, controls=SCHEDULE, *, aircraft=aircraft, **options):
        return simulate(model or glider.model(), aircraft, x0, controls, **options)

    return fly


def inert(glider, **options):
    """Return a model without any force or moment."""
    return glider._replace(level=np.zeros(6)).model(0.0 * glider.slopes, **options)


@pytest.fixture(scope="module")
def flown(fly):
    return fly(dt=0.01, duration=4.0, air=WIND_OVER_GROUND)


class TestEquations:
    def test_follows_newton_and_euler(self, aircraft, flown, glider):
        """Typed from the textbook with rotations by scipy; slopes are those of splines through the states."""
        time = flown["time"].to_numpy()
        attitude = Rotation.from_euler("ZYX", flown[["psi", "theta", "phi"]].to_numpy(copy=True))
        u, v, w = attitude.inv().apply(flown[VELOCITY].to_numpy() - WIND_OVER_GROUND).T
        speed = np.sqrt(u**2 + v**2 + w**2)
        rates = flown[RATES].to_numpy()
        lengths = [2.6, 0.55, 2.6]
        *surfaces, thrust = commands(time).values()
        reduced = rates * lengths / (2 * speed[:, None])
        regressors = np.column_stack([np.arctan(w / u), np.arcsin(v / speed), reduced, *surfaces])
        loads = glider.level + regressors @ glider.slopes.T
        density = standard_density(-flown["down"].to_numpy())
        loads *= (0.5 * density * speed**2 * aircraft.wing_area)[:, None]
        thrust = np.outer(thrust, aircraft.thrust_line.direction)
        acceleration = attitude.apply(loads[:, :3] + thrust) / aircraft.mass + [0, 0, 9.80665]
        moment = loads[:, 3:] * lengths + np.cross(aircraft.thrust_line.position, thrust)
        moment -= np.cross(rates, rates @ aircraft.inertia)

        turning = RotationSpline(time, attitude)(time, 1)
        states = CubicSpline(time, flown[["north", "east", "down", *VELOCITY, *RATES]])(time, 1)
        velocity, change, spin = np.split(states, [3, 6], axis=1)
        inner = slice(8, -8)
        for found, expected in (
            (flown[VELOCITY], velocity),
            (acceleration, change),
            (rates, turning),
            (moment, spin @ aircraft.inertia),
        ):
            assert_allclose(found[inner], expected[inner], atol=1e-5)

    def test_is_of_fourth_order_in_the_step(self, fly):
        exact, half, whole = (
            fly(dt=dt, duration=2.0)[STATES].iloc[-1] for dt in (0.005, 0.02, 0.04)
        )
        errors = [np.abs(end - exact).max() for end in (whole, half)]
        assert 3.6 < np.log2(errors[0] / errors[1]) < 4.5


class TestRegressors:
    @pytest.mark.parametrize("chord", [0.4, 0.55])
    def test_are_rebuilt_as_the_pipeline_builds_them(self, fly, glider, chord):
        """Also with another span, or another span and chord, than the aircraft has."""
        words = "alpha beta p q r elevon_left elevon_right rudder"
        log = make_flight({words: (0, 0.1, 0), "airspeed": (22, 2, 0)}, 200, width=0)
        model = make_pipeline(
            ElevonSplitter(), RateNondimensionalizer(span=2.0, chord=chord),
            RegressorSelector([*glider.names, "airspeed"]), StandardScaler(), LinearRegression(),
        )  # fmt: skip
        values = model[:3].fit(log).transform(log).to_numpy()
        model.fit(log, glider.level + values[:, :8] @ glider.slopes.T + 0.001 * values[:, 8:])
        surfaces = {"elevon_left": 0.01, "elevon_right": -0.03, "rudder": 0.01, "thrust_x": 14.0}
        with (
            pytest.warns(SimulationWarning, match="left what the model was learned from"),
            pytest.warns(UserWarning, match="is this the aircraft that the model was learned from"),
        ):
            flown = fly(model, controls=surfaces, duration=2.0)
        assert {"elevator", "aileron"} <= set(flown)
        assert_allclose(model.predict(flown), flown[COEFFICIENTS], atol=1e-12)

    def test_that_follow_from_the_loads_are_those_of_the_motion(self, aircraft, fly):
        names = ("alpha", "q_hat", "alpha_dot_hat", "beta_dot", "beta", "elevator")

        def coefficients(X):
            alpha, q, alpha_dot, beta_dot, beta, elevator = X.T
            zero = 0 * alpha
            return np.stack(
                [zero - 0.03, -0.5 * beta - 0.02 * beta_dot, -0.1 - 4 * alpha - 2 * alpha_dot, -0.02 * beta,
                 0.03 - 0.5 * alpha - 8 * q - 4 * alpha_dot - 0.6 * elevator, 0.06 * beta + 0.004 * beta_dot], axis=-1,
            )  # fmt: skip

        gust = pd.DataFrame({"time": np.arange(0, 2.1, 0.01)})
        for k, name in enumerate(WIND):
            gust[name] = 2.0 * np.sin(5 * gust["time"] + k)
        model = Aerodynamics(coefficients, names)
        controls = {"elevator": -0.02, "thrust": 14.0}
        step = 0.005
        flown = fly(model, controls=controls, dt=step, duration=0.5, air=gust)
        for name in ("alpha", "beta"):
            flown[f"{name}_dot"] = np.gradient(flown[name], step, edge_order=2)
        for name in ("alpha_dot", "q"):
            flown[f"{name}_hat"] = flown[name] * aircraft.chord / (2 * flown["airspeed"])
        again = coefficients(flown[list(names)].to_numpy())
        inner = slice(3, -3)
        assert_allclose(again[inner], flown[COEFFICIENTS][inner], atol=2e-4)
        assert np.ptp(flown["alpha_dot"]) > 0.2  # the check is not of nothing

    def test_a_fixed_point_that_is_not_found_marks_the_trajectory(self, fly):
        flipping = Aerodynamics(
            lambda X: np.where(X < 0.0, 1.0, -1.0) * [0, 0, 1.0, 0, 0, 0], ["alpha_dot"]
        )
        with pytest.warns(SimulationWarning, match="diverged"):
            flown = fly(flipping, controls={}, duration=0.5, thrust=None)
        assert (flown["ended"] == "diverged").all()

    @pytest.mark.parametrize(("names", "match"), [
        (["alpha", "elevator_trim", "temperature"], "controls lack 'elevator_trim'.*'temperature'"),
        (["alpha_hat"], "alone a simulation knows the non-dimensional form"),
        (["alpha", "v_north", "az"], r"regressors \['v_north', 'az'\], which are neither controls nor"),
    ])  # fmt: skip
    def test_one_that_cannot_be_rebuilt_is_named(self, names, match, fly):
        model = Aerodynamics(lambda X: np.zeros((len(X), 6)), names)
        with pytest.raises(ValueError, match=match):
            fly(model, controls={"elevator": 0.0}, duration=1.0, thrust=None)


class TestControls:
    def test_a_table_and_tables_for_each_start_are_the_same_flight(self, fly):
        alone = fly(dt=0.02, duration=1.0)
        table = table_of(1.0)
        by_table = fly(controls=table.assign(time=table["time"] + 7.0), dt=0.02)
        assert_allclose(by_table[STATES], alone[STATES], atol=1e-6)
        assert_allclose(by_table["time"], alone["time"] + 7.0)
        tables = [table, table.assign(elevator=0.0)]
        two = fly(x0=pd.DataFrame([START, START]), controls=tables, dt=0.02)
        first, second = (part.reset_index() for _, part in two.groupby("start"))
        assert_allclose(first[STATES], by_table[STATES], atol=1e-12)
        assert np.abs(second["theta"] - first["theta"]).max() > 0.01

    def test_a_model_has_the_servos_of_its_pipeline(self):
        rng = default_rng(0)
        table = pd.DataFrame(rng.normal(size=(60, 2)), columns=["alpha", "elevator"])
        table["time"] = 0.02 * np.arange(60)
        steps = (
            LagCorrector({"surfaces": -0.06, "servos": 0.04}),
            RegressorSelector(["alpha", "elevator"]),
        )
        model = make_pipeline(*steps, LinearRegression()).fit(table, rng.normal(size=(60, 6)))
        assert as_aerodynamics(model).servos == Servos(lag=0.04, delay=0.06)

    def test_throttle_turns_the_propeller(self, aircraft, fly):
        propeller = Propeller(0.5, (0.1, -0.05, -0.08), speed_range=(200.0, 800.0))
        powered = replace(aircraft, propeller=propeller)
        by_throttle = fly(aircraft=powered, controls=REST | {"throttle": 0.5}, duration=1.0)
        by_speed = fly(aircraft=powered, controls=REST | {"propeller_speed": 500.0}, duration=1.0)
        assert_allclose(by_throttle[STATES], by_speed[STATES])

    @pytest.mark.parametrize(("controls", "options", "match"), [
        (table_of(1.0), {"duration": 2.0}, "ends after 1 s, but the simulation lasts 2 s"),
        (table_of(1.0).drop(columns="thrust"), {}, "thrust is unknown"),
        (table_of(1.0).assign(rudder=np.nan), {}, r"NaN or infinite in \['rudder'\]"),
        ({"elevator": 0.0}, {}, "Got no duration"),
        ([table_of(1.0)] * 3, {}, "3 tables as controls for 1 starts"),
        (table_of(1.0), {"air": pd.DataFrame({"time": [0.0, 2.0], "wind_north": 1.0})}, "lacks the columns"),
        (table_of(1.0).assign(time=pd.Timestamp("2026-01-01")), {}, "expected seconds"),
    ])  # fmt: skip
    def test_mistakes_are_told_at_the_door(self, controls, options, match, fly):
        with pytest.raises(ValueError, match=match):
            fly(controls=controls, **options)


class TestStarts:
    def test_the_air_is_that_of_the_altitude(self, fly):
        flown = fly(x0=START | {"down": -50.0, "altitude": 1500.0}, duration=0.1)
        assert_allclose(flown["density"].iloc[0], standard_density(1500.0))
        with pytest.warns(UserWarning, match="altitude of -455 m, below any land"):
            fly(x0={"airspeed": 22.0, "alpha": 0.08, "down": 455.0}, duration=0.1)

    def test_a_row_of_a_flight_a_state_and_names_are_the_same_start(self, flown, fly):
        row = flown.iloc[100]
        controls = dict.fromkeys(SURFACES, 0.01) | {"thrust": 12.0}
        by_row, by_names = (
            fly(x0=start, controls=controls, duration=0.5, air=WIND_OVER_GROUND)
            for start in (row, dict(row[[*START]]))
        )
        assert_allclose(by_row[STATES], by_names[STATES], atol=1e-9)

    def test_a_start_of_a_windy_flight_without_its_wind_is_noticed(self, fly):
        start = {"airspeed": 22.0, "v_north": 25.5, "v_east": 0.0, "v_down": 0.0}
        with pytest.warns(UserWarning, match="give the wind of that flight"):
            fly(x0=start, duration=0.1)
        fly(x0=start, duration=0.1, air=[0.3, 0.0, 0.0])  # less than 15 % off

    def test_controls_of_another_time_than_the_start_are_noticed(self, fly):
        table = pd.DataFrame({"time": [0.0, 1.0], **REST, "thrust": 12.0})
        with pytest.warns(UserWarning, match=r"begin \[-5.0\] s from the times of their starts"):
            fly(x0=START | {"time": 5.0}, controls=table, duration=0.1)

    @pytest.mark.parametrize(("start", "match"), [
        ({"phi": 0.1}, "lack 'airspeed'"),
        ({"airspeed": 20.0, "u": 19.0, "v": 1.0, "w": 3.0}, "lack 'alpha', 'beta'"),
        ({"airspeed": 20.0, "aplha": 0.1}, "did you mean 'alpha'"),
        ({"airspeed": 20.0, "phi": 30.0}, "expected radians"),
        (np.zeros(13), r"expected names and values, a table of them, or trims"),
        ([], "Got x0="),
    ])  # fmt: skip
    def test_impossible_ones_are_told(self, start, match, fly):
        with pytest.raises(ValueError, match=match):
            fly(x0=start, duration=0.1)


class TestMarks:
    def test_a_flight_that_loses_its_airspeed_ends_and_the_others_go_on(self, fly, glider):
        vertical = dict.fromkeys(START, 0.0) | {"theta": 1.5, "airspeed": 8.0, "altitude": 300.0}
        falling = inert(glider)
        starts = pd.DataFrame([vertical, START])
        options = {"controls": REST, "duration": 2.0, "thrust": None}
        told = "1 of 2 trajectories ended early.*airspeed under 1 m/s"
        with pytest.warns(SimulationWarning, match=told):
            both = fly(falling, starts, **options)
        lost, kept = (part.reset_index(drop=True) for _, part in both.groupby("start"))
        assert_allclose(kept[STATES], fly(falling, **options)[STATES], atol=1e-12)
        end = (lost["ended"] != "").idxmax()
        assert_allclose(lost["time"][end], 8.0 * np.sin(1.5) / 9.80665, atol=0.15)
        assert lost.loc[end:, STATES].isna().all(axis=None)
        assert lost.loc[: end - 1, STATES].notna().all(axis=None)

    def test_one_that_diverges_is_marked_and_no_nan_is_silent(self, fly, glider):
        unstable = glider.slopes.copy()
        unstable[4, 0], unstable[4, 3] = 40.0, 8.0
        with pytest.warns(SimulationWarning, match="diverged"):
            flown = fly(glider.model(unstable), duration=5.0)
        assert (flown[STATES].isna().any(axis=1) == (flown["ended"] != "")).all()
        assert set(flown["ended"]) == {"", "diverged"}

    def test_one_that_leaves_the_atmosphere_is_marked(self, fly):
        high = pd.DataFrame([START | {"altitude": 31_999.0, "theta": 0.5}, START])
        with pytest.warns(SimulationWarning, match="outside of the atmosphere"):
            flown = fly(x0=high, controls=REST, duration=2.0, thrust=None)
        assert flown.groupby("start")["ended"].last().tolist() == ["altitude", ""]

    def test_tells_when_and_where_it_leaves_what_was_flown(self, aircraft, fly, glider):
        limits = np.outer([-0.5, 0.5], np.ones(8))
        limits[:, 1] = [-0.02, 0.05]
        with pytest.warns(SimulationWarning, match="in beta .*learned from -0.02 to 0.05"):
            flown = fly(glider.model(limits=limits), duration=2.0)
        low, high = -0.02 - 0.02 * 0.07, 0.05 + 0.02 * 0.07
        outside = ~flown["beta"].between(low, high)
        assert_array_equal(flown["beyond"] == "beta", outside)
        assert 0 < outside.mean() < 1
        simulator = Simulator(glider.model(limits=limits), aircraft, dt=0.02)
        simulator.reset(START)
        for _ in range(50):
            is_inside = low <= simulator.step(commands(0.0))["beta"] <= high
            assert simulator.beyond == ("" if is_inside else "beta")


class TestEnsembles:
    def test_each_path_flies_a_function_of_its_own_for_the_whole_flight(self, fly, glider):
        paths = fly(duration=1.0, n_paths=3, random_state=5, air=Air(gusts=None))
        slopes = glider.slopes * default_rng(5).normal(1.0, 0.1, (3, 6, 8))
        for k, (_, path) in enumerate(paths.groupby("path")):
            alone = fly(glider.model(slopes[k]), duration=1.0)
            assert_allclose(path[STATES], alone[STATES], atol=1e-10)

    def test_each_path_flies_in_a_wind_that_changes(self, fly):
        wind = {"time": [0.0, 1.0], "wind_north": [3.0, 5.0], "wind_east": -2.0, "wind_down": 0.5}
        paths = fly(duration=1.0, n_paths=3, air=Air(wind=pd.DataFrame(wind), gusts=None))
        for _, path in paths.groupby("path"):
            assert_allclose(path["wind_north"], 3.0 + 2.0 * path["time"], atol=1e-9)

    def test_the_spread_by_a_drift_is_that_of_an_integrated_ornstein_uhlenbeck_process(
        self, aircraft, fly, glider
    ):
        """With CX alone and no gravity, u_dot = rho V^2 S CX / 2m, and the integral of CX has a known variance."""
        T, tau, V, rho = 0.5, 1e-3, 20.0, 1.2
        drift = Drift(np.array([tau**2, 0, 0, 0, 0, 0]), np.full(6, T))
        options = {"dt": 0.02, "duration": 3.0, "thrust": None, "n_paths": 1000}
        air = Air(density=rho, gravity=0.0, gusts=None)
        paths = fly(inert(glider, drift=drift), {"airspeed": V}, REST, air=air, **options)
        paths = paths.pivot(index="time", columns="path", values="u")
        t = paths.index.to_numpy()
        power = rho * V**2 * aircraft.wing_area / (2 * aircraft.mass)
        expected = power * np.sqrt(2 * (tau * T) ** 2 * (t / T - 1 + np.exp(-t / T)))
        assert_allclose(paths.std(axis=1).iloc[10:], expected[10:], rtol=0.1)
        assert_allclose(paths.mean(axis=1), V, atol=4 * expected[-1] / np.sqrt(1000))

    def test_bands_hold_95_percent_of_the_paths_that_still_fly(self):
        airspeed = default_rng(0).normal(30.0, 1.0, (100, 2))
        airspeed[:20, 1] = np.nan
        ended = np.where(np.isnan(airspeed), "diverged", "").ravel()
        path, time = np.divmod(np.arange(200), 2)
        values = {"start": 0, "path": path, "time": time, "airspeed": airspeed.ravel()}
        bands = trajectory_bands(pd.DataFrame({**values, "ended": ended}))
        assert bands["flying"].tolist() == [1.0, 0.8]
        expected = np.nanquantile(airspeed, [0.5, 0.025, 0.975], axis=0).T
        assert_allclose(bands[["airspeed", "airspeed_low", "airspeed_high"]], expected)

    def test_bands_of_headings_to_either_side_of_south_are_narrow(self):
        paths = pd.DataFrame({"start": 0, "path": [0, 1], "time": 0.0, "psi": [3.1, -3.1]})
        bands = trajectory_bands(paths.assign(ended=""), level=1.0)
        assert_allclose(bands[["psi_low", "psi_high"]], [[3.1, 2 * np.pi - 3.1]])


class TestSimulator:
    @pytest.mark.parametrize("servos", [Servos(), Servos(0.1), Servos(0.04, 0.033, 2.0)], ids=str)
    @pytest.mark.parametrize("gain", [0.0, 0.2])
    def test_steps_are_those_of_a_held_law(self, aircraft, servos, gain, fly, glider):
        """Accelerometers show the last stage of a step, in a table its end with the next controls."""

        def law(t, state):
            return commands(0.0) | {"aileron": -gain * (state["phi"] + 0.25 * state["p"])}

        model, wind = glider.model(servos=servos), [1.0, 2.0, 0.0]
        at_once = fly(model, controls=law, dt=0.02, duration=1.0, air=wind)
        simulator = Simulator(model, aircraft, air=wind)
        seen = simulator.reset(START, controls=law(0.0, START))
        for row in at_once.to_dict("records"):
            for name in ("time", *STATES):
                assert_allclose(seen[name], row[name], rtol=0, atol=1e-10)
            for name in FORCES if not gain else ():
                assert_allclose(seen[name], row[name], rtol=0, atol=0.01)
            seen = simulator.step(law(seen["time"], seen))

    def test_a_step_three_times_as_long_is_three_steps(self, aircraft, glider):
        states = []
        for durations in ([0.06], [0.02] * 3):
            simulator = Simulator(glider.model(), aircraft, dt=0.02)
            simulator.reset(START)
            for duration in durations:
                simulator.step(commands(0.0), duration)
            states.append(simulator.state)
        assert_allclose(*states, atol=1e-12)

    def test_accelerometers_of_a_start_without_controls_are_unknown(self, aircraft, glider):
        seen = Simulator(glider.model(), aircraft).reset(START)
        assert np.isnan([seen[name] for name in FORCES]).all()
        assert np.isfinite(seen["airspeed"])

    @pytest.mark.parametrize("n_tables", [1, 2])
    def test_a_wind_over_time_is_refused(self, n_tables, aircraft, glider):
        with pytest.raises(ValueError, match=r"^Got wind=(?s:.*)expected 3 finite numbers"):
            Simulator(glider.model(), aircraft, air=[table_of(1.0)] * n_tables)

    def test_says_when_it_is_over(self, aircraft, glider):
        simulator = Simulator(inert(glider), aircraft, thrust=None)
        with pytest.raises(ValueError, match="call reset"):
            simulator.step({})
        with pytest.raises(ValueError, match="2 starts, but expected one"):
            simulator.reset(pd.DataFrame([START, START]))
        simulator.reset(START)
        simulator.step(REST | {"elevator": np.nan})
        assert simulator.ended == "diverged"
        simulator.reset({"airspeed": 3.0, "theta": 1.5, "altitude": 50.0})
        while not simulator.ended:
            seen = simulator.step(REST)
        assert simulator.ended == "airspeed"
        del seen["time"]
        assert np.isnan([*seen.values()]).all()
        with pytest.raises(ValueError, match="has ended"):
            simulator.step(REST)
