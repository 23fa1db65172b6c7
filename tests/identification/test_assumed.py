"""What identify assumes where nothing is said: thrust, sizes, surfaces that are missing."""

import warnings

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from skdgp import DependentGPRegressor
from skdgp._compute.findings import Code, Finding
from skdgp._compute.wording import text_of
from skdgp.dynamics import Aircraft, propulsive_loads, stability_derivatives, trim
from skdgp.export import portable_model, write_c
from skdgp.identification import _prepare, identify, load_model, validate
from skdgp.identification._learn import thrust_sources
from skdgp.identification._prepare import (
    assumptions,
    check_controls,
    lacks_thrust,
    servos_for,
    usable_flights,
)
from skdgp.io import FULL_THROW
from skdgp.preprocessing import FlightDataWarning

QUICK = DependentGPRegressor(structure="trend", random_state=0)
# Of a stable aircraft, of its dampings, and of its controls
SIGNS = {
    "CZ_alpha": -1, "Cm_alpha": -1, "Cm_q": -1, "Cl_p": -1, "Cn_beta": 1, "Cn_r": -1,
    "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1, "CX_throttle": 1,
}  # fmt: skip


class TestServos:
    @pytest.fixture(autouse=True)
    def parameters(self, monkeypatch):
        monkeypatch.setattr(_prepare, "names_servos", lambda path: path != "nameless.ulg")

    def test_logs_of_autopilots_have_full_throws(self):
        assert servos_for(None, "a.ulg", None) == FULL_THROW
        assert servos_for(None, {"one": "a.ulg"}, ["b.bin"]) == FULL_THROW
        assert servos_for("servo.toml", ["a.ulg", "b.bin"], None) == "servo.toml"
        assert servos_for(None, ["a.csv", pd.DataFrame()], "b.parquet") is None

    def test_a_log_that_names_no_servo_has_none(self):
        assert servos_for(None, "nameless.ulg", None) is None

    def test_units_are_not_mixed(self):
        with pytest.raises(ValueError, match="Got logs of autopilots without servos beside tables"):
            servos_for(None, "a.csv", "b.ulg")


class TestThrust:
    KNOWN = Aircraft.estimate(3.0, 1.8, propeller={"diameter": 0.3, "thrust_coefficients": [0.1]})
    UNKNOWN = Aircraft.estimate(3.0, 1.8)

    @pytest.mark.parametrize(
        ("columns", "aircraft", "thrust", "lacks"),
        [
            ("throttle", UNKNOWN, "auto", True),
            ("throttle propeller_speed", UNKNOWN, "auto", True),
            ("throttle propeller_speed", KNOWN, "auto", False),
            ("throttle thrust_x", UNKNOWN, "auto", False),
            ("throttle thrust", UNKNOWN, "auto", False),
            ("airspeed", UNKNOWN, "auto", False),  # no throttle explains it: an error says so
            ("throttle", UNKNOWN, None, False),
        ],
    )
    def test_is_unknown_where_nothing_gives_it(self, columns, aircraft, thrust, lacks):
        assert lacks_thrust(thrust, [pd.DataFrame(columns=columns.split())], aircraft) is lacks

    @pytest.mark.parametrize("column", ["thrust", "thrust_x"])
    def test_a_column_beside_a_throttle_is_read(self, column):
        table = pd.DataFrame({"throttle": [0.5], "airspeed": [20.0], "density": [1.2], column: 3.0})
        assert thrust_sources("auto", [table]) == ["columns"]
        force, _ = propulsive_loads(table, self.UNKNOWN)
        assert_array_equal(force, [[3.0, 0.0, 0.0]])


class TestWords:
    def test_nothing_was_assumed_of_what_was_told(self):
        told = Aircraft.estimate(
            3.0, 1.8, wing_area=0.4, length=1.2, inertia=np.diag([0.1, 0.15, 0.2])
        )
        assert assumptions(told) == ()

    def test_sizes_are_said_with_all_their_errors(self):
        """Iyy follows the length by its square: 25 % of the radius and twice 15 % of the length."""
        aircraft = Aircraft.estimate(3.0, 1.8)
        first = text_of(assumptions(aircraft)[0])
        assert "wing area 0.432 m^2 ± 35 %" in first
        assert "Iyy 0.208 kg m^2 ± 39 %" in first
        assert "mass" not in first


def quietly(*flights, **options):
    """Return what identify finds; its warnings are among its messages."""
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        return identify(*flights, regressor=QUICK, **options)


def test_a_table_without_thrust():
    """The model has throttle and airspeed among its regressors."""
    t = np.arange(400) * 0.05
    names = [
        "alpha",
        "beta",
        "p",
        "q",
        "r",
        "elevator",
        "aileron",
        "rudder",
        "throttle",
        "ax",
        "ay",
        "az",
    ]
    table = pd.DataFrame(
        {name: 0.1 * np.sin((0.7 + 0.31 * k) * t + k) for k, name in enumerate(names)}
    )
    table = table.assign(time=t, airspeed=20 + np.sin(0.3 * t), density=1.2, az=table["az"] - 9.8)
    found = quietly(table, Aircraft.estimate(3.0, 1.8), samples=100, horizons=[1.0])
    assert {"throttle", "airspeed"} <= set(found.fit.regressors)
    assert found.settings["thrust"] is None
    assert "servos" not in found.settings
    lacks_thrust = Finding(Code.THRUST_IN_COEFFICIENTS)
    assert lacks_thrust in found.assumptions
    assert lacks_thrust in found.findings


@pytest.fixture(scope="module")
def log(shared_data):
    return shared_data / "logs" / "fw_system_id_log_altitude_1_HITL.ulg"


@pytest.fixture(scope="module")
def found(log):
    return quietly(log, Aircraft.estimate(3.2, 1.6))


@pytest.mark.shared
class TestALogAMassAndASpan:
    def test_signs_are_right(self, found):
        """PX4, hardware in the loop: no accelerometer, vane, servo angle or thrust, of an unknown simulator."""
        table = found.mechanics.derivatives
        assert {name: np.sign(table.loc[name, "value"]) for name in SIGNS} == SIGNS
        assert table.loc["Cm_elevator", "per"] == "full throw"
        assert table.loc["Cm_alpha", "per"] == "rad"

    def test_says_what_it_assumed_in_ten_lines(self, found):
        lines = found.summary().partition("assumed, as nothing was told:")[2].strip().splitlines()
        assert len(lines) <= 10
        assert any("full throw" in line for line in lines)

    @pytest.mark.filterwarnings("ignore")
    def test_the_model_reads_other_logs_in_its_unit(self, found, log, tmp_path):
        found.save(tmp_path)
        model = load_model(tmp_path / "model.joblib")
        again = validate(model, log)
        assert again.evaluations[0].table["elevator"].abs().max() > 0.3
        point = trim(model.pipeline, model.aircraft, 24.0, climb=None, thrust=None)
        derivatives = stability_derivatives(
            model.pipeline, model.aircraft, point, n_paths=0, thrust=None
        )
        assert derivatives.loc["Cl_aileron", "per"] == "full throw"
        portable = portable_model(model.pipeline, model.aircraft)
        units = {each.name: each.unit for each in portable.regressors}
        assert (units["aileron"], units["alpha"]) == ("full throw", "rad")
        write_c(tmp_path, portable)
        assert "aileron [full throw]" in (tmp_path / "aero.h").read_text()

    @pytest.mark.filterwarnings("ignore")
    def test_the_report_shows_full_throws_and_what_was_assumed(self, found, tmp_path, monkeypatch):
        monkeypatch.setattr("skdgp._display.page.find_spec", lambda name: None)  # words alone
        page = (found.save(tmp_path) / "report.html").read_text(encoding="utf-8")
        assert "What was assumed</h2>" in page
        assert "Those by surfaces are by their full throw." in page


TABLE = pd.DataFrame({"time": [0.0, 0.1]}).assign(alpha=0.0, q=0.0, aileron=0.0, rudder=0.0)


def test_another_name():
    with pytest.raises(ValueError, match=r"did you mean 'de'\?.*--rename de=elevator"):
        check_controls({"a": TABLE.assign(de=0.0)}, "quasi-steady")


def test_no_elevator():
    with pytest.warns(UserWarning, match="without an elevator"):
        check_controls({"a": TABLE}, "quasi-steady")


@pytest.mark.parametrize("given", ["elevator", "elevon_left"])
def test_what_needs_none(given):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_controls({"a": TABLE.assign(**{given: 0.0})}, "quasi-steady")
        check_controls({"a": TABLE.assign(de=0.0)}, ["alpha", "aileron"])


def test_signs_that_the_flights_contradict_are_reported_and_not_turned(first_minute):
    train = first_minute().train
    flight = train[train["flight"] == "latlon"].reset_index(drop=True)
    left, right = flight.pop("elevon_left"), flight.pop("elevon_right")
    surfaces = {"elevator": (left + right) / 2 / 0.4, "aileron": (right - left) / 2 / 0.4}
    reversed_aileron = flight.assign(**surfaces)
    with pytest.warns(FlightDataWarning, match="Contradiction in the flights: aileron"):
        usable = usable_flights({"one": reversed_aileron}, ["aileron"], ["aileron"])
    assert usable["one"]["aileron"].equals(reversed_aileron["aileron"])
