"""What identify assumes where nothing is said: thrust, sizes, surfaces that are missing."""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from log_errors import placed
from made_flights import make_flight
from numpy.testing import assert_allclose
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft, propulsive_loads, stability_derivatives, trim
from skdgp.export import export_model, portable_model
from skdgp.identification import identify, load_model, validate

LINE = DependentGPRegressor(structure="trend", random_state=0)
QUICK = clone(LINE).set_params(max_iter=2, input_noise=None)
UNKNOWN = Aircraft.estimate(3.0, 1.8)
KNOWN = Aircraft.estimate(3.0, 1.8, propeller={"diameter": 0.3, "thrust_coefficients": [0.1]})
# Of a stable aircraft, of its dampings, and of its controls
SIGNS = {
    "CZ_alpha": -1, "Cm_alpha": -1, "Cm_q": -1, "Cl_p": -1, "Cn_beta": 1, "Cn_r": -1,
    "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1,
}  # fmt: skip
LEVELS = {
    "alpha beta p q r elevator aileron rudder throttle ax ay": (0, 0.07, 0),
    "az": (-9.8, 0.07, 0),
    "airspeed": (20, 0.7, 0),
}


def table(n=240):
    """Return a flight without thrust and attitude."""
    return make_flight(LEVELS, n, 0.05).assign(density=1.2)


class TestThrust:
    @pytest.mark.parametrize(
        ("columns", "aircraft", "thrust", "lacks"),
        [
            ([], UNKNOWN, "auto", True),
            (["propeller_speed"], UNKNOWN, "auto", True),
            (["propeller_speed"], KNOWN, "auto", False),
            (["thrust_x"], UNKNOWN, "auto", False),
            (["thrust"], UNKNOWN, "auto", False),
            ([], UNKNOWN, None, False),
        ],
    )
    def test_is_unknown_where_nothing_gives_it(self, columns, aircraft, thrust, lacks, said_of):
        flight = table(200).assign(**dict.fromkeys(columns, 1.0))
        said = said_of(flight, aircraft, thrust=thrust)
        assert ("Neither columns (thrust, or thrust_x, thrust_y, thrust_z)" in said) is lacks

    def test_without_a_throttle_an_error_says_so(self):
        """No throttle explains it."""
        with pytest.raises(ValueError, match="thrust"):
            quietly(table(200).drop(columns="throttle"), UNKNOWN)

    @pytest.mark.parametrize("column", ["thrust", "thrust_x"])
    def test_a_column_beside_a_throttle_is_read(self, column):
        flight = pd.DataFrame({"throttle": [0.5], "airspeed": 20.0, "density": 1.2, column: 3.0})
        force, _ = propulsive_loads(flight, UNKNOWN)
        assert_allclose(force, [[3.0, 0.0, 0.0]])


@pytest.mark.parametrize(("stated", "differs"), [(0.3, True), (0.805, False), (0.0, False)])
def test_two_positions_of_the_inertial_sensors(stated, differs, said_of):
    """Zero is the centre of gravity, to which the forces of a simulation refer."""
    known = replace(UNKNOWN, sensor_position=(0.8, 0.0, 0.0))
    said = said_of(placed(table(200), (stated, 0.0, 0.0)), known)
    assert ("states inertial sensors 0.5 m from where the" in said) is differs


def codes(findings):
    return {finding.code.name for finding in findings}


def quietly(*flights, regressor=QUICK, **options):
    """Return what identify finds; its warnings are among its messages."""
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        return identify(*flights, regressor=regressor, **options)


def briefly(*flights, **options):
    """Return what identify finds by few rows."""
    return quietly(*flights, samples=60, horizon=1.0, **options)


@pytest.mark.usefixtures("no_mechanics")
def test_a_position_that_all_flights_state_is_the_models():
    """A flight that states none is then read with it, and one that states another is told."""
    place = (0.3, 0.0, 0.1)
    stated = placed(table(), place)
    unstated, other = (table().assign(q=factor * stated["q"]) for factor in (1.1, 1.2))
    other = placed(other, place)
    result = quietly({"first": stated, "second": other}, aircraft=UNKNOWN, samples=60)
    assert_allclose(result.aircraft.sensor_position, place)
    three = {"first": stated, "second": unstated, "third": other}
    only_one = quietly(three, aircraft=UNKNOWN, samples=60)
    assert only_one.aircraft.sensor_position is None
    assert "SENSOR_POSITIONS_DIFFER" in codes(only_one.findings)


@pytest.mark.usefixtures("no_mechanics")
def test_a_table_without_thrust():
    """The model has the throttle, which moves it, among its regressors; sizes are said with all their errors.

    Iyy follows the length by its square: 25 % of the radius and twice 15 % of the length.
    """
    flight = table()
    flight["ax"] += 20 * flight["throttle"] / UNKNOWN.mass
    found = quietly(flight, UNKNOWN, samples=100, horizon=1.0)
    assert "throttle" in found.fit.regressors
    assert found.options["thrust"] is None
    assert "servos" not in found.options
    assert "THRUST_IN_COEFFICIENTS" in codes(found.findings)
    sizes = found.findings[0].numbers["sizes"]
    assert_allclose(sizes["wing area [m^2]"], (0.432, 0.35 * 0.432), rtol=0.01)
    assert_allclose(sizes["Iyy [kg m^2]"], (0.208, 0.39 * 0.208), rtol=0.01)
    assert "mass" not in found.assumed[0]
    assert {*found.verdict.warnings}.isdisjoint(found.assumed)


@pytest.mark.usefixtures("no_mechanics")
def test_an_engine_that_no_regressor_explains():
    flight = table()
    flight["propeller_speed"] = 500 + 100 * flight.pop("throttle")
    found = briefly(flight, UNKNOWN, regressors=["alpha", "q_hat"])
    (engine,) = [each for each in found.findings if each.code.name == "ENGINE_UNEXPLAINED"]
    assert engine.numbers["names"] == ["propeller_speed"]
    assert "THRUST_IN_COEFFICIENTS" in codes(found.findings)
    assert found.options["thrust"] is None


@pytest.mark.usefixtures("no_mechanics")
def test_an_engine_that_ran_only_in_rows_that_are_left_out_is_no_engine():
    flight = table().assign(throttle=0.0)
    flight.loc[:60, "throttle"] = 0.5
    flight.loc[:60, "airspeed"] = np.nan
    found = briefly(flight, UNKNOWN)
    assert "THRUST_IN_COEFFICIENTS" not in codes(found.findings)
    assert "throttle" not in found.fit.regressors


@pytest.mark.usefixtures("no_mechanics")
def test_nothing_was_assumed_of_what_was_told():
    told = Aircraft.estimate(3.0, 1.8, wing_area=0.4, length=1.2, inertia=np.diag([0.1, 0.15, 0.2]))
    flight = table().assign(thrust_x=1.0)
    other = flight[120:].assign(alpha=-flight["alpha"])
    assert briefly(flight[:120], told, test=other).assumed == []


@pytest.fixture(scope="module")
def log(shared_data):
    return shared_data / "logs" / "fw_system_id_log_altitude_1_HITL.ulg"


@pytest.fixture(scope="module")
def found(log):
    return quietly(log, Aircraft.estimate(3.2, 1.6), regressor=LINE)


@pytest.mark.shared
@pytest.mark.slow
class TestALogAMassAndASpan:
    def test_signs_are_right(self, found):
        """PX4, hardware in the loop: no accelerometer, vane, servo angle or thrust, unknown simulator.

        Yaw is hardly excited; the bands of what did not converge are no wider than without the flight.
        """
        table = found.mechanics.derivatives
        of_signs = table.loc[list(SIGNS)].drop(index="Cn_r")
        assert (of_signs["value"] * [SIGNS[name] for name in of_signs.index] > 0).all()
        is_known = of_signs["value"].abs() > of_signs["std"]
        assert {"Cl_aileron", "Cm_q", "Cm_elevator"} <= set(is_known.index[is_known])
        for name, std in {"CZ_alpha": 2.0, "Cm_alpha": 2.0, "Cn_r": 0.25}.items():
            assert table.loc[name, "std"] < std
        assert table.loc["Cm_elevator", "per"] == "full throw"
        assert table.loc["Cm_alpha", "per"] == "rad"

    @pytest.mark.filterwarnings("ignore")
    def test_the_model_reads_other_logs_in_its_unit(self, found, log, tmp_path):
        found.save(tmp_path)
        model = load_model(tmp_path / "model.joblib")
        assert validate(model, log).evaluations[0].table["elevator"].abs().max() > 0.3
        point = trim(model.pipeline, model.aircraft, 24.0, climb=None, thrust=None)
        derivatives = stability_derivatives(
            model.pipeline, model.aircraft, point, n_paths=0, thrust=None
        )
        assert derivatives.loc["Cl_aileron", "per"] == "full throw"
        portable = portable_model(model.pipeline, model.aircraft)
        units = {each.name: each.unit for each in portable.regressors}
        assert (units["aileron"], units["alpha"]) == ("full throw", "rad")
        export_model(tmp_path, portable, "c")
        assert "aileron [full throw]" in (tmp_path / "aero.h").read_text()


@pytest.mark.filterwarnings("ignore:(No test flight was named|Neither columns)")
def test_a_surface_of_another_name(said_of):
    flight = table(200).rename(columns={"elevator": "de"})
    with pytest.raises(ValueError, match=r"lacks the columns 'elevator' \(nearest: 'de'\)"):
        identify(flight, UNKNOWN)
    assert "elevator" not in said_of(flight, UNKNOWN, regressors=["alpha", "aileron"])


@pytest.mark.usefixtures("no_mechanics")
def test_surfaces_without_a_column_are_taken_to_be_absent():
    found = briefly(table(200).drop(columns="rudder", errors="ignore"), UNKNOWN)
    (absent,) = [each for each in found.findings if each.code.name == "SURFACES_ABSENT"]
    assert absent.numbers["names"] == ["rudder"]
    assert absent.text in found.assumed


@pytest.mark.usefixtures("no_mechanics")
def test_no_elevator():
    flight = table(200).drop(columns="elevator")
    both = flight.assign(elevon_left=0.1 * flight["alpha"], elevon_right=0.1)
    for of_aircraft, n_told in ((flight, 1), (both, 0)):
        told = [finding.code.name for finding in briefly(of_aircraft, UNKNOWN).findings]
        assert told.count("NO_ELEVATOR") == n_told


@pytest.mark.usefixtures("no_mechanics")
def test_signs_that_the_flights_contradict_are_reported_and_not_turned(first_minute, latlon):
    flight = latlon[1200:].reset_index(drop=True)
    left = flight.pop("elevon_left")
    right = flight.pop("elevon_right")
    opposite = flight.drop(columns="psi").assign(aileron=(right - left) / 2)
    found = briefly({"one": opposite}, first_minute().aircraft, test=opposite[:200])
    contradictions = [each for each in found.findings if each.code.name == "CONTRADICTION"]
    # and of its 10 s that are tested
    assert [each.flight for each in contradictions] == ["one", "latlon"]
    assert all(each.numbers["channels"] == ["aileron"] for each in contradictions)
    assert found.train["one"]["aileron"].equals(opposite["aileron"])
