"""``skdgp``: exit codes, outputs all or none, Ctrl-C, and what it says meanwhile."""

import io
import json
import re
import runpy
import signal
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp._cli import _shared, main
from skdgp._cli._shared import CLEAR, Console
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification import _identification, _learn, load_model
from skdgp.identification import identify as identify_flights
from skdgp.metrics import interval_coverage, median_relative_error

pytestmark = pytest.mark.usefixtures("no_report")

EXAMPLES = Path(__file__).parents[2] / "examples"
OUTPUTS = {"model.joblib", "metrics.json", "report.html"}
QUICK = ["--samples", "40", "--max-iter", "3", "--latents", "1", "--structure", "joint"]


def assert_only_stopped(messages):
    """Assert that nothing is said but of few rows and that a search stopped at its limit, which depends on rounding."""
    expected = "The fit stopped at max_iter", "Got 40 rows for 9 regressors"
    assert [each for each in messages if not any(words in each for words in expected)] == []


def identify(*arguments, output="out", train=("latlon.csv",), aircraft="uav.json"):
    return main(["identify", *train, "--aircraft", aircraft, "-o", str(output), *QUICK, *arguments])


@pytest.mark.usefixtures("short_fits")
class TestIdentify:
    def test_a_mass_and_a_span_instead_of_a_file(self, folder, tmp_path, capsys, monkeypatch):
        """The aircraft is the estimate, named by the log."""
        monkeypatch.chdir(folder)
        words = ["identify", "latlon.csv", "--test", "test.csv", *QUICK, "--horizons", "1"]
        sizes = ["--mass", "45+-0.5", "--span", "2.8", "--kind", "flying wing"]
        assert main([*words, *sizes, "-o", str(tmp_path / "out")]) == 0
        assert "assumed, as nothing was told:" in capsys.readouterr().out
        expected = Aircraft.estimate((45.0, 0.5), 2.8, kind="flying wing", name="latlon")
        assert load_model(tmp_path / "out" / "model.joblib").aircraft == expected

    def test_is_silent_in_a_pipe(self, identified):
        said = identified[1].stderr.splitlines()
        assert_only_stopped(said)
        codes = [finding["code"] for finding in identified[2]["findings"]]
        assert {*codes} <= {"few_rows", "search_stopped"}
        assert len(codes) == len(said)
        assert "\r" not in identified[1].stdout
        assert "\x1b" not in identified[1].stdout

    def test_prints_the_numbers_it_wrote(self, identified):
        output, done, metrics = identified
        (name,) = metrics["test"]
        row = re.search(r"^CZ +(.*)$", done.stdout, flags=re.MULTILINE)[1].split()
        of = metrics["test"][name]["coefficients"]
        assert float(row[0]) == round(100 * of["measured"]["CZ"]["median_relative_error"], 1)
        assert float(row[1]) == round(of["measured"]["CZ"]["normalized_rmse"], 3)
        assert float(row[2]) == round(100 * of["measured"]["CZ"]["interval_coverage"], 1)
        assert float(row[-1]) == round(of["truth"]["CZ"]["normalized_rmse"], 3)
        assert all(str(output / name) in done.stdout for name in OUTPUTS)
        assert f"flight paths {metrics['fit']['reconstruction']}" in done.stdout

    def test_the_model_gives_the_numbers_again(self, identified, folder):
        output, _, metrics = identified
        model = load_model(output / "model.joblib")
        assert model.flights == ["lateral", "latlon"]
        assert model.fit["log_marginal_likelihood"] == metrics["fit"]["log_marginal_likelihood"]
        table = pd.read_csv(folder / "test.csv")
        loads = {name: model.options[name] for name in ("thrust", "external_forces")}
        Y = aerodynamic_coefficients(table, model.aircraft, **loads)
        mean, std = model.pipeline.predict(table, return_std=True, include_noise=True)
        of = next(iter(metrics["test"].values()))["coefficients"]["measured"]
        error = median_relative_error(Y, mean, multioutput="raw_values")
        inside = interval_coverage(Y, mean, std, multioutput="raw_values")
        assert_allclose(
            error, [of[name]["median_relative_error"] for name in COEFFICIENTS], rtol=1e-9
        )
        assert_allclose(inside, [of[name]["interval_coverage"] for name in COEFFICIENTS], rtol=1e-9)

    def test_the_function_gives_what_the_command_gives(self, folder, identified, monkeypatch):
        monkeypatch.undo()  # flight mechanics are among the metrics
        monkeypatch.chdir(folder)
        printed = identified[1].stdout.splitlines()
        regressor = DependentGPRegressor(n_latent=1, max_iter=3, random_state=0, structure="joint")
        options = {"samples": 40, "horizons": [1.0], "regressor": regressor}
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            warnings.showwarning = lambda *_: None
            result = identify_flights(
                ["lateral.csv", folder / "latlon.csv"], "uav.json", test="test.csv", **options
            )
        found, expected = dict(result.metrics), dict(identified[2])
        assert json.loads(json.dumps(found, allow_nan=False)) == found
        for metrics in (found, expected):
            metrics["fit"] = metrics["fit"] | {"seconds": None}
            metrics |= {"created": None, "command": None}
        assert found == expected
        lines = result.summary().splitlines()
        assert lines[1:] == printed[1 : len(lines)]

    def test_holds_out_the_end_of_a_single_flight(self, tmp_path, capsys):
        assert identify("--json", output=tmp_path) == 0
        metrics = json.loads((tmp_path / "metrics.json").read_text())
        assert json.loads(capsys.readouterr().out) == metrics
        assert list(metrics["fit"]["flights"].values()) == [300]
        assert [flight["samples"] for flight in metrics["test"].values()] == [100]
        assert "truth" not in next(iter(metrics["test"].values()))["coefficients"]

    def test_a_log_without_attitude_is_scored_but_not_replayed(self, tmp_path, folder, capsys):
        pd.read_csv(folder / "test.csv").drop(columns="phi").to_csv(
            tmp_path / "bare.csv", index=False
        )
        pd.read_csv(folder / "latlon.csv").iloc[:160].to_csv(tmp_path / "short.csv", index=False)
        files = {"train": [str(tmp_path / "short.csv")], "output": tmp_path / "out"}
        assert identify("--test", str(tmp_path / "bare.csv"), **files) == 0
        said = capsys.readouterr().err
        assert (
            "Got flights without ['phi'], which those of the fit had: they are smoothed channel "
            "by channel" in said
        )
        (flight,) = json.loads((tmp_path / "out" / "metrics.json").read_text())["test"].values()
        assert flight["coefficients"]["measured"]["CZ"]["normalized_rmse"] > 0

    def test_what_makes_a_model_poor_is_remarked_on(self, tmp_path, folder, capsys):
        """Rows without alpha, or between gaps, a surface that never moves, a test on what was learned."""
        table = (
            pd.read_csv(folder / "latlon.csv")
            .drop(index=[*range(100, 150), *range(151, 200)])
            .assign(rudder=0.01)
        )
        table.loc[250:259, "alpha"] = np.nan
        table.to_csv(tmp_path / "gaps.csv", index=False)
        assert (
            identify(
                "--test", "latlon.csv", output=tmp_path / "out", train=[str(tmp_path / "gaps.csv")]
            )
            == 0
        )
        said = capsys.readouterr().err
        assert "10 of 301 rows are left out" in said
        assert json.loads((tmp_path / "out" / "metrics.json").read_text())["fit"]["flights"] == {
            "latlon": 290
        }
        assert "1 rows that stand alone between gaps are left out" in said
        assert "['rudder'] never change, so the model cannot learn" in said
        assert "constant over the samples" not in said  # it is said once, by name
        assert "'latlon' is both learned from and tested on" in said

    def test_several_test_flights_are_scored_together_too(self, tmp_path, capsys):
        assert identify("--test", "lateral.csv", "test.csv", output=tmp_path) == 0
        metrics = json.loads((tmp_path / "metrics.json").read_text())
        apart = [flight["coefficients"]["measured"]["CY"] for flight in metrics["test"].values()]
        together = metrics["test_together"]["coefficients"]
        assert len(apart) == 2
        shares = np.average([one["interval_coverage"] for one in apart], weights=[400, 300])
        assert together["measured"]["CY"]["interval_coverage"] == pytest.approx(shares)
        assert "truth" not in together  # the lateral flight does not know it
        assert "2 test flights together" in capsys.readouterr().out


class TestBadInput:
    """Each: exit code 1, one line that says what to do, no traceback, no folder made."""

    @pytest.fixture
    def refused(self, folder, tmp_path, capsys):
        def check(message, *arguments, **options):
            assert identify(*arguments, output=tmp_path / "new" / "out", **options) == 1
            (error,) = [
                line
                for line in capsys.readouterr().err.splitlines()
                if not line.startswith("warning: ")
            ]
            assert re.search(f"^error: .*({message})", error)
            assert not (tmp_path / "new").exists()

        return check

    def test_missing_files(self, refused):
        refused("Got nowhere.csv, but there is no such file", train=["nowhere.csv"])
        refused("none.json: No such file", aircraft="none.json")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda table: table.drop(columns="airspeed"),
                "lacks the columns 'airspeed'.*pitot tube.*less an estimated wind: give a column",
            ),
            (lambda table: table.assign(beta=np.nan), "no row in which all of .*'beta': 400"),
            (lambda table: table.iloc[:1], "1 usable rows, none beside another"),
        ],
    )
    def test_a_flight_that_nothing_is_learned_from(
        self, refused, folder, tmp_path, change, message
    ):
        change(pd.read_csv(folder / "latlon.csv")).to_csv(tmp_path / "f.csv", index=False)
        refused(message, "--test", "test.csv", train=[str(tmp_path / "f.csv")])

    def test_two_flights_of_one_name(self, refused, folder, tmp_path):
        table = pd.read_csv(folder / "latlon.csv")
        table.to_csv(tmp_path / "copy.csv", index=False)
        copy = str(tmp_path / "copy.csv")
        refused(
            "'latlon' in latlon.csv and in .*copy.csv, but expected each once: .* rename one",
            train=["latlon.csv", copy],
        )
        refused("name a file once", train=["latlon.csv", "./latlon.csv"])

    def test_a_test_flight_that_lacks_a_column_is_noticed_before_the_fit(
        self, refused, folder, tmp_path, monkeypatch
    ):
        monkeypatch.setattr(
            _learn, "make_identification_pipeline", lambda *a, **k: pytest.fail("fitted")
        )
        pd.read_csv(folder / "test.csv").drop(columns="alpha").to_csv(
            tmp_path / "bare.csv", index=False
        )
        refused(
            r"The flight '\w+' lacks the columns 'alpha'\. Rename or compute",
            "--test",
            str(tmp_path / "bare.csv"),
        )

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"mass": -1}, "Got mass=-1, but expected"),
            ({"mass": float("nan")}, "Got mass=nan, but expected"),
            ({"mass": 10**400}, "Got mass=10+, but expected a number > 0"),
            ({"inertia": [[10**400]]}, "Got inertia .*, but expected 3 x 3 numbers"),
            ({"name": "a\nb"}, r"Got name='a\\nb', but expected a line of text"),
            (
                {"thrust_line": {"position": [10**400, 0, 0]}},
                "thrust-line position=.*, but expected 3 finite numbers",
            ),
            (
                {"propeller": {"diameter": "x", "thrust_coefficients": [0.1]}},
                "Got diameter='x', but expected a number > 0",
            ),
        ],
    )
    def test_a_wrong_aircraft(self, refused, folder, tmp_path, change, message):
        values = json.loads((folder / "uav.json").read_text()) | change
        (tmp_path / "wrong.json").write_text(json.dumps(values))
        refused(message, aircraft=str(tmp_path / "wrong.json"))

    @pytest.mark.parametrize("option", ["--test", "--aircraft", "-o"])
    @pytest.mark.parametrize("name", ["loop", "a" * 300])
    def test_a_name_that_the_system_cannot_follow(self, option, name, tmp_path, capsys):
        (tmp_path / "loop").symlink_to("loop")
        assert identify(option, str(tmp_path / name)) == 1
        assert name in capsys.readouterr().err.splitlines()[-1]

    def test_an_output_folder_that_is_a_file_is_noticed_before_anything_is_read(
        self, folder, capsys
    ):
        assert identify(output=folder / "uav.json", train=["nowhere.csv"]) == 1
        assert "is no folder that can be written to" in capsys.readouterr().err


@pytest.fixture(scope="module")
def late(tmp_path_factory, first_minute):
    """Return a flight whose vanes and airspeed are 80 ms late."""
    data = first_minute()
    table = data.train[data.train["flight"] == "latlon"].iloc[:2400].reset_index(drop=True)
    table = table[[name for name in table if not name.endswith("_true")]]
    air = ("airspeed", "alpha", "beta")
    table = table.assign(
        **{name: np.interp(table["time"] - 0.08, table["time"], table[name]) for name in air}
    )
    path = tmp_path_factory.mktemp("late") / "late.csv"
    table.to_csv(path, index=False)
    return str(path)


@pytest.mark.usefixtures("short_fits")
class TestLags:
    def test_are_corrected_and_said(self, late, tmp_path, monkeypatch):
        monkeypatch.setattr(_identification, "render_report", lambda content: content.facts["Lags"])
        assert identify("--test", "test.csv", "--horizons", "1", train=[late], output=tmp_path) == 0
        metrics = json.loads((tmp_path / "metrics.json").read_text())
        assert metrics["options"]["lags"] == "auto"
        assert abs(metrics["fit"]["lags"]["air"]["applied"] - 0.08) < 0.01
        assert (
            load_model(tmp_path / "model.joblib").pipeline.named_steps["lagcorrector"].lags
            == "auto"
        )
        assert (tmp_path / "report.html").read_text().startswith("air 0.07")


@pytest.mark.usefixtures("short_fits")
class TestInterrupt:
    def test_keeps_the_best_so_far(self, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr(
            _identification, "render_report", lambda content: "; ".join(content.verdict.warnings)
        )
        monkeypatch.setattr(Console, "progress", interrupting(Console.progress, "fit", 2))
        assert identify("--test", "test.csv", "--max-iter", "50", output=tmp_path) == 0
        metrics = json.loads((tmp_path / "metrics.json").read_text())
        assert metrics["fit"]["interrupted"] is True
        assert np.isfinite(metrics["fit"]["log_marginal_likelihood"])
        assert load_model(tmp_path / "model.joblib").fit["interrupted"] is True
        said = capsys.readouterr()
        assert "The fit was interrupted" in said.err
        assert "brumby: interrupted in" in said.out
        assert "The fit was interrupted" in (tmp_path / "report.html").read_text()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def interrupting(original, stage, n):
    """Return a progress listener that is pressed Ctrl-C at the n-th evaluation of a stage."""

    def progress(self, now, n_evaluations, log_likelihood):
        original(self, now, n_evaluations, log_likelihood)
        if now == stage and n_evaluations == n:
            signal.raise_signal(signal.SIGINT)

    return progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


class TestConsole:
    @pytest.fixture(autouse=True)
    def _at_once(self, monkeypatch):
        monkeypatch.setattr(_shared, "PERIOD", 0.0)

    def test_one_line_rewritten(self):
        stream = Terminal()
        with Console(stream) as console:
            console.stage("fit")
            console.progress("output 1", 10, -5.0)
            assert "output 1 · 10 evaluations · log likelihood -5.0" in stream.getvalue()
            console.progress("fit", 7, 123.456)
            assert "all outputs · 7 evaluations · log likelihood 123.5" in stream.getvalue()
        assert "\n" not in stream.getvalue()
        assert stream.getvalue().endswith(CLEAR)

    def test_nothing_but_warnings_in_a_pipe(self):
        stream = io.StringIO()
        with Console(stream) as console:
            console.stage("fit")
            console.progress("fit", 1, 0.0)
            warnings.warn("look\n out", UserWarning, stacklevel=1)
            warnings.warn("look out", UserWarning, stacklevel=1)
        assert stream.getvalue() == "warning: look out\n"
        assert console.messages == ["look out"]


@pytest.mark.usefixtures("short_flights", "short_fits")
@pytest.mark.parametrize("short_flights", [2000], indirect=True)
def test_demo_is_honest(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    output = tmp_path / "skdgp-demo"
    assert main(["demo", "--samples", "100", "--max-iter", "15", "--horizons", "2"]) == 0
    assert_only_stopped(capsys.readouterr().err.splitlines())
    assert {path.name for path in output.iterdir()} == OUTPUTS
    (flight,) = json.loads((output / "metrics.json").read_text())["test"].values()
    means = flight["means"]
    assert 0.90 <= means["measured"]["all"]["interval_coverage"] <= 0.99
    assert means["truth"]["all"]["normalized_rmse"] < 0.2
    pipeline = load_model(output / "model.joblib").pipeline
    assert (pipeline.turbulence_.intensity > 0.2).all()  # as flown
    assert 0 < pipeline.seconds_ <= 2 * 2000 * 0.05


@pytest.mark.usefixtures("short_flights", "hasty_fits")
@pytest.mark.parametrize(
    ("short_flights", "name", "arguments"),
    [
        (
            400,
            "grid_search_flights",
            ["--samples", "24", "--max-iter", "2", "--n-jobs", "1", "--days", "1"],
        ),
        (400, "compare_methods", ["--samples", "90"]),
        (1000, "fly_the_model", ["--samples", "60", "--paths", "5"]),
    ],
    indirect=["short_flights"],
)
@pytest.mark.filterwarnings("ignore::skdgp.dynamics.SimulationWarning")
def test_examples_draw(name, arguments, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    example = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]
    if "GRID" in example.__globals__:  # one candidate of eight
        example.__globals__["GRID"] = {
            key: values[:1] for key, values in example.__globals__["GRID"].items()
        }
    example([*arguments, "--output", str(picture)])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in capsys.readouterr().out


def test_example_of_a_real_flight_says_that_there_is_no_network(tmp_path, monkeypatch, capsys):
    def refused(*arguments, **options):
        raise OSError("no route to host")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("urllib.request.urlopen", refused)
    runpy.run_path(str(EXAMPLES / "real_flight.py"))["main"]([])
    assert "No log (no route to host). Fetch it from\nhttps://" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
