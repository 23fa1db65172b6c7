"""What is done with a model that exists: predict, validate, derivatives, each from words to files."""

import json
import re
import shlex
import signal
import socket
import struct
import threading
from copy import copy, deepcopy
from itertools import pairwise
from pathlib import Path

import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import DependentGPRegressor
from skdgp.dynamics import Turbulence, trim
from skdgp.identification import load_model, save_model, validate


@pytest.fixture(scope="module")
def path(identified):
    return identified.output / "model.joblib"


@pytest.fixture(scope="module")
def model(path):
    return load_model(path)


@pytest.fixture
def run(command, path, tmp_path, capsys):
    """Run a command on the model, or another one; return what it printed, as JSON."""

    def run(name, *words, output="out", model=path):
        assert command([name, model, *words, "-o", tmp_path / output, "--json"]) == 0
        return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)

    return run


@pytest.fixture
def refused(command, path, tmp_path, the_error):
    """Run a command that fails: exit code 1, one line, nothing written."""

    def refused(message, name, *words, model=path, output="new/out"):
        assert command([name, model, *words, "-o", tmp_path / output]) == 1
        assert re.search(f"^error: .*({message})", the_error())
        assert not (tmp_path / "new").exists()

    return refused


def files(folder):
    return {path.name for path in folder.iterdir()}


class TestPredict:
    @pytest.mark.parametrize("include_noise", [False, True])
    def test_writes_what_the_model_says(self, run, model, tmp_path, include_noise):
        noise = ["--include-noise"] * include_noise
        said = run("predict", "test.csv", "lateral.csv", *noise, output="out.csv")
        assert said["flights"] == {"two_altitudes": 300, "lateral": 400}
        assert files(tmp_path) == {"out.csv"}
        table = pd.read_csv(tmp_path / "out.csv")
        assert table["flight"].value_counts().to_dict() == said["flights"]
        table = table[:300]
        flight = pd.read_csv("test.csv")
        options = {"return_std": True, "include_noise": include_noise}
        mean, std = model.pipeline.predict(flight, **options)
        assert list(table) == [
            "flight",
            "time",
            *COEFFICIENTS,
            *(f"{name}_std" for name in COEFFICIENTS),
        ]
        assert_array_equal(table["time"], flight["time"])
        assert_allclose(table.iloc[:, 2:8], mean, rtol=1e-9)
        assert_allclose(table.iloc[:, 8:], std, rtol=1e-9)

    def test_never_replaces_what_was_there(self, refused, tmp_path):
        table = tmp_path / "flight.csv"
        table.write_bytes(Path("test.csv").read_bytes())
        refused("but it is one of the flights: name another", "predict", table, output=table)
        assert table.read_bytes() == Path("test.csv").read_bytes()

    def test_when_stopped_nothing_is_written(self, command, model, tmp_path, capsys):
        pipeline = deepcopy(model.pipeline)
        pipeline[-1].__class__ = Stopped
        stopped = save_model(tmp_path / "stopped.joblib", pipeline, model.aircraft)
        output = tmp_path / "new" / "out.csv"
        assert command(["predict", stopped, "test.csv", "-o", output]) == 130
        assert not output.parent.exists()
        *stages, last = capsys.readouterr().err.splitlines()
        assert last == "stopped"
        assert all(re.search(r" · \d+ s$", stage) for stage in stages)  # of a slow machine


class Stopped(DependentGPRegressor):
    """A model during whose predictions someone presses Ctrl-C."""

    def predict(self, X, **options):
        signal.raise_signal(signal.SIGINT)


class TestModel:
    def test_there_is_none(self, refused):
        message = "none.joblib: No such file"
        refused(message, "predict", "test.csv", model="none.joblib", output="a.csv")

    def test_a_pipeline_of_another_kind(self, refused, tmp_path, model):
        save_model(tmp_path / "other.joblib", model.pipeline[-2:], model.aircraft)
        refused("but expected what make_identification_pipeline makes", "validate", "test.csv",
                model=tmp_path / "other.joblib")  # fmt: skip


class TestValidate:
    def test_says_what_identify_and_changed_say(
        self, run, identified, model, tmp_path, no_pictures
    ):
        said = run("validate", "test.csv", "--horizon", "1")
        (of_flight,) = said["changed"]["derivatives"].values()
        assert {"CZ_alpha", "Cm_elevator"} <= of_flight.keys()
        assert files(tmp_path / "out") == {"report.html", "metrics.json"}
        for key in ("test", "test_together", "fit", "options"):
            assert said[key] == identified.metrics[key]
        assert json.loads((tmp_path / "out" / "metrics.json").read_text()) == said
        report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        assert "a model on other flights" in report

    def test_of_what_it_learned_from_is_remarked_on(self, command, path, capsys):
        assert command(["validate", path, "latlon.csv", "--horizon", "1"]) == 0
        assert "The model learned from a flight 'latlon'" in capsys.readouterr().err


class TestMargins:
    """Of the loops of an autopilot around the model: roll is unstable, pitch as weak as can be."""

    PARAMETERS = (
        "FW_RR_P,4.0\nFW_RR_I,0.1\nFW_RR_FF,0\nFW_R_TC,0.4\nFW_PR_P,0.001\nFW_PR_I,0\nFW_PR_FF,0\n"
        "FW_P_TC,0.4\nFW_AIRSPD_STALL,20\nFW_AIRSPD_TRIM,30\nFW_AIRSPD_MAX,50\n"
        "IMU_GYRO_CUTOFF,40\nIMU_DGYRO_CUTOFF,30\n"
    )
    WORDS = shlex.split("--airspeed 35 --altitude 100 --paths 10 --full aileron=0.4 elevator=0.4")

    def test_are_those_of_the_model(self, run, model, tmp_path):
        parameters = tmp_path / "plane.param"
        parameters.write_text(self.PARAMETERS)
        said = run("margins", "--params", parameters, *self.WORDS)
        assert files(tmp_path / "out") == {"margins.csv", "suggested.csv", "margins.json"}
        roll, pitch = (said["margins"][loop] for loop in ("roll", "pitch"))
        assert (roll["gain"]["value"], pitch["phase"]["value"]) == ("-inf", "inf")
        assert pitch["crossover"]["value"] is None
        assert said["parameters"] == str(parameters)
        assert said["delay"] == 0.02
        suggested = pd.read_csv(tmp_path / "out" / "suggested.csv")
        assert list(suggested["parameter"]) == ["FW_RR_P", "FW_RR_I", "FW_PR_P"]


class TestFly:
    WORDS = shlex.split(
        "--airspeed 35 --full aileron=0.4 elevator=0.4 rudder=0.3 --height 100 --gusts 5"
    )

    def test_answers_an_autopilot(self, run, port, tmp_path):
        is_over = threading.Event()

        def autopilot():
            """Send packets without pulses, whether or not they are answered."""
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
                number = 0
                while not is_over.wait(0.005):
                    packet = struct.pack("<HHI16H", 18458, 400, number, *[0] * 16)
                    link.sendto(packet, ("127.0.0.1", port))
                    number += 1

        thread = threading.Thread(target=autopilot)
        thread.start()
        try:
            said = run("fly", *self.WORDS, "--seconds", 0.1, "--port", port, "--path", 3)
        finally:
            is_over.set()
            thread.join()
        assert said["steps"] == 40
        flight = pd.read_csv(tmp_path / "out" / "flight.csv")
        assert flight["time"].max() <= 0.1
        assert_allclose(flight["altitude"], 100.0, atol=1.0)

    # in six seconds a stage that lasts would say so
    @pytest.mark.parametrize("wait", ["0.1", pytest.param("6", marks=pytest.mark.slow)])
    def test_silence_is_no_flight(self, command, path, port, wait, capsys):
        assert command(["fly", path, *self.WORDS, "--port", port, "--wait", wait]) == 1
        waiting, error = capsys.readouterr().err.splitlines()[-2:]
        assert waiting == f"waiting for ArduPilot at port {port}; Ctrl-C ends"
        assert f"error: Got no packet at 127.0.0.1:{port} for {wait} s" in error

    def test_full_deflections_are_checked_before_the_trim(self, refused):
        """Which would not be found at this airspeed."""
        words = shlex.split("--airspeed 1 --full elevator=0.4")
        refused("Got no value of aileron, rudder.* at full output", "fly", *words)

    def test_gusts_that_the_model_does_not_know_are_refused_before_the_trim(
        self, refused, model, tmp_path
    ):
        pipeline = copy(model.pipeline)
        pipeline.turbulence_ = None
        calm = tmp_path / "calm.joblib"
        save_model(calm, pipeline, model.aircraft, options=model.options)
        words = shlex.split("--airspeed 1 --full aileron=0.4 elevator=0.4 rudder=0.3 --gusts flown")
        refused("Got --gusts flown, but the model does not know", "fly", *words, model=calm)


class TestDerivatives:
    def test_are_those_of_the_model(self, run, model, tmp_path):
        said = run("derivatives", *shlex.split("--airspeed 35 --altitude 100 --paths 10"))
        at = trim(model.pipeline, model.aircraft, 35.0, altitude=100.0)
        (point,) = said["points"]
        assert_allclose(point["trim"]["alpha"], at.alpha)
        lift = point["derivatives"]["CL_alpha"]
        assert lift["lower"] < lift["value"] < lift["upper"]
        assert {"short period", "phugoid", "Dutch roll"} <= set(point["modes"])
        assert point["modes"]["Dutch roll"]["frequency_std"] > 0
        assert files(tmp_path / "out") == {"derivatives.csv", "modes.csv", "derivatives.json"}

    def test_thrust_and_gusts_that_are_not_flown(self, command, model, tmp_path, capsys):
        pipeline = copy(model.pipeline).set_params(thrust=None)
        pipeline.turbulence_ = Turbulence.low_altitude(height=100.0, wind_at_6m=15.0)
        kite = tmp_path / "kite.joblib"
        save_model(kite, pipeline, model.aircraft)
        assert command(["derivatives", kite, "--airspeed", "35", "--paths", "0", "--json"]) == 0
        said = capsys.readouterr()
        assert "CD is drag less thrust" in said.err
        assert "learn from flights in calmer air" in said.err
        assert (
            json.loads(said.out)["points"][0]["trim"]["climb"] < 0
        )  # without thrust it glides down
        judged = validate(load_model(kite), "test.csv", horizon=1.0)
        assert judged.options["thrust"] is None
        assert judged.mechanics.trim.climb < 0

    def test_of_several_airspeeds(self, run, tmp_path):
        said = run("derivatives", "--airspeed", "36", "33", "--paths", "0")
        assert [point["trim"]["airspeed"] for point in said["points"]] == [33.0, 36.0]
        assert "std" not in said["points"][0]["derivatives"]["CL"]
        table = pd.read_csv(tmp_path / "out" / "derivatives.csv")
        alphas = [point["trim"]["alpha"] for point in said["points"]]
        assert_allclose(table.groupby("airspeed")["alpha"].first(), alphas)
        assert all(slow > fast for slow, fast in pairwise(alphas))


@pytest.mark.usefixtures("few_manoeuvres")
class TestPlan:
    WORDS = shlex.split("--airspeed 35 --seconds 10 --axes rudder --altitude 300")

    def test_writes_what_autopilots_fly(self, run, tmp_path):
        more = shlex.split("--limits rudder=0.1 --full rudder=0.4 --goal Cn_rudder --growth 2")
        said = run("plan", *self.WORDS, *more)
        assert files(tmp_path / "out") == {
            "plan.csv", "plan.lua", "plan.svg", "expected.csv", "plan.json",
        }  # fmt: skip
        table = pd.read_csv(tmp_path / "out" / "plan.csv")
        assert table["rudder"].abs().max() <= 0.1
        assert (
            table["time"].iloc[-2] + 3.0
            < said["seconds"]
            <= min(table["time"].iloc[-1] + 3.0, 10.0)
        )
        assert json.loads((tmp_path / "out" / "plan.json").read_text()) == said
        assert said["limits"]["rudder"]["high"] > said["trim"]["controls"]["rudder"]
        errors = said["errors"]["Cn_rudder"]
        assert errors["expected"] < errors["before"]

    def test_what_an_earlier_plan_wrote_does_not_stay(
        self, command, path, run, tmp_path, no_pictures
    ):
        """Its script would be flown beside the table of another plan."""
        folder = tmp_path / "out"
        folder.mkdir()
        for name in ("plan.lua", "plan_b.csv", "my_plan.lua"):
            (folder / name).write_text("old")
        more = shlex.split("--limits rudder=0.1 --goal Cn_rudder --growth 2")
        run("plan", *self.WORDS, *more)
        assert "plan.lua" in files(folder)  # there was no plan.json beside it
        assert command(["plan", path, *self.WORDS, *more, "-o", folder]) == 0
        assert files(folder) == {
            "plan.csv", "expected.csv", "plan.json", "plan_b.csv", "my_plan.lua",
        }  # fmt: skip

    def test_full_deflections_are_checked_before_the_search(self, refused):
        """Which would refuse its goal."""
        words = shlex.split("--goal Cn_flaps --full elevator=0.5")
        refused("expected also .* move with the rudder: add", "plan", *self.WORDS, *words)
