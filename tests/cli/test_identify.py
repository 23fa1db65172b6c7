"""``skdgp``: exit codes, outputs all or none, Ctrl-C, and what it says meanwhile."""

import json
import re
import shlex
import signal
import warnings
from contextlib import redirect_stderr

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft, Propeller
from skdgp.identification import identify as identify_flights
from skdgp.identification import load_model

QUICK = ["--samples", "40", "--max-iter", "3"]


def assert_only_stopped(messages):
    """Assert that nothing is said but of few rows and that a search stopped at its limit, which depends on rounding."""
    expected = "The fit stopped at max_iter", "Got 40 rows for 9 regressors"
    said = without_stages(messages)
    assert [each for each in said if not any(words in each for words in expected)] == []


def without_stages(lines):
    """Leave out stages, which a command that takes long prints where there is no terminal."""
    return [line for line in lines if not re.fullmatch(r"[\w ]+( · .*)?", line)]


@pytest.fixture
def identify(command, tmp_path):
    """Run the command on ``latlon.csv``, or other flights, into a folder ``out``; return the exit code."""

    def identify(*arguments, train=("latlon.csv",), aircraft="uav.json", output=tmp_path / "out"):
        options = ["--aircraft", aircraft, "-o", output]
        return command(["identify", *train, *options, *QUICK, *arguments])

    return identify


@pytest.fixture
def metrics_of(identify, tmp_path):
    """Run the command; return the metrics."""

    def metrics_of(*arguments, **options):
        assert identify(*arguments, **options) == 0
        return json.loads((tmp_path / "out" / "metrics.json").read_text())

    return metrics_of


@pytest.fixture
def write(folder, tmp_path):
    """Write a flight of the folder under another name, changed; return the path."""

    def write(name, change=lambda table: table, *, of="latlon"):
        change(pd.read_csv(folder / f"{of}.csv")).to_csv(tmp_path / name, index=False)
        return tmp_path / name

    return write


@pytest.mark.usefixtures("short_fits", "no_report")
class TestIdentify:
    def test_is_silent_in_a_pipe(self, identified):
        said = identified.err.splitlines()
        assert_only_stopped(said)
        codes = [finding["code"] for finding in identified.metrics["findings"]]
        assert {*codes} <= {"few_rows", "search_stopped"}
        assert len(codes) == len(without_stages(said))
        assert not {"\r", "\x1b"} & {*identified.out}

    def test_the_function_gives_what_the_command_gives(self, folder, identified, monkeypatch):
        monkeypatch.undo()  # flight mechanics are among the metrics
        monkeypatch.chdir(folder)
        printed = identified.out.splitlines()
        regressor = DependentGPRegressor(max_iter=3, random_state=0)
        options = {"samples": 40, "horizon": 1.0, "regressor": regressor}
        with warnings.catch_warnings(action="default"):
            warnings.showwarning = lambda *_: None
            result = identify_flights(
                ["lateral.csv", folder / "latlon.csv"], "uav.json", test="test.csv", **options
            )
        found = dict(result.metrics)
        expected = dict(identified.metrics)
        assert json.loads(json.dumps(found, allow_nan=False)) == found
        for metrics in (found, expected):
            metrics["fit"] = metrics["fit"] | {"seconds": None, "summary": None}
            metrics |= {"created": None, "command": None}
        assert found == expected
        lines = result.summary().splitlines()
        assert lines[1:] == printed[1 : len(lines)]

    def test_holds_out_the_end_of_a_single_flight(self, metrics_of, capsys):
        metrics = metrics_of(*shlex.split("--json --samples 300 --regressors alpha,q_hat,elevator"))
        assert json.loads(capsys.readouterr().out) == metrics
        assert metrics["fit"]["regressors"] == ["alpha", "q_hat", "elevator"]
        assert metrics["fit"]["samples"] == 300
        assert [flight["samples"] for flight in metrics["train"].values()] == [300]
        (flight,) = metrics["test"].values()
        assert flight["samples"] == 100
        assert "held_out_quarter" in [finding["code"] for finding in metrics["findings"]]
        assert "truth" not in flight["coefficients"]

    def test_an_interruption_leaves_nothing(self, identify, tmp_path, watched):
        """On a terminal one line is rewritten, until it is removed for what is said."""
        terminal = watched("all outputs", True, lambda: signal.raise_signal(signal.SIGINT))
        with redirect_stderr(terminal):
            assert identify("--test", "test.csv", "--max-iter", "200", "--samples", "100") == 130
        assert not (tmp_path / "out").exists()
        progress, _, rest = terminal.getvalue().rpartition("\r\x1b[K")
        assert rest == "stopped\n"
        assert re.search(r"fit · all outputs \[[#-]+\] \d+ of \d+", progress)
        assert "\n" not in progress
        drawn = dict.fromkeys(line.split(" · ")[0] for line in progress.split("\r\x1b[K")[1:-1])
        # a short one may end before it is drawn
        assert [*drawn] == [stage for stage in ["reading", "transforming", "fit"] if stage in drawn]
        assert "fit" in drawn

    def test_a_mass_and_a_span_instead_of_a_file(self, command, tmp_path, capsys):
        """The aircraft is the estimate, named by the log."""
        words = ["identify", "latlon.csv", "--test", "test.csv", *QUICK, "--horizon", "1"]
        sizes = shlex.split("--mass 45+-0.5 --span 2.8 --kind 'flying wing' --propeller 16x8")
        assert command([*words, *sizes, "-o", tmp_path / "out"]) == 0
        assert "assumed, as nothing was told:" in capsys.readouterr().out
        propeller = Propeller.from_size(16 * 0.0254, 8 * 0.0254)
        expected = Aircraft.estimate(
            (45.0, 0.5), 2.8, kind="flying wing", name="latlon", propeller=propeller
        )
        assert load_model(tmp_path / "out" / "model.joblib").aircraft == expected

    def test_what_makes_a_model_poor_is_remarked_on(self, metrics_of, write, capsys):
        """Rows without alpha, or between gaps, a surface that never moves, a test on what was learned."""

        def spoil(table):
            table.loc[250:259, "alpha"] = np.nan
            return table.drop(index=[*range(100, 150), *range(151, 200)]).assign(rudder=0.01)

        metrics = metrics_of("--test", "latlon.csv", train=[write("gaps.csv", spoil)])
        assert metrics["train"]["latlon"]["samples"] == 290
        said = capsys.readouterr().err
        assert "11 of 301 rows are left out" in said
        assert "1 stand alone between gaps" in said
        assert "['rudder'] never change, so the model cannot learn" in said
        assert "constant over the samples" not in said  # it is said once, by name
        assert "'latlon' repeats training flight 'latlon' (its rows or its attitude)" in said


class TestBadInput:
    """Each: exit code 1, one line that says what to do, no traceback, no folder made."""

    @pytest.fixture
    def refused(self, identify, tmp_path, the_error):
        def refused(message, *arguments, **options):
            output = tmp_path / "new" / "out"
            assert identify(*arguments, output=output, **options) == 1
            assert re.search(f"^error: .*({message})", the_error())
            assert not output.parent.exists()

        return refused

    def test_missing_files(self, refused):
        refused("Got nowhere.csv, but there is no such file", train=["nowhere.csv"])
        refused("none.json: No such file", aircraft="none.json")

    def test_a_wrong_output_is_noticed_before_anything_is_read(self, identify, folder, the_error):
        assert identify(output=folder / "uav.json", train=["nowhere.csv"]) == 1
        assert "is no folder that can be written to" in the_error()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda table: table.drop(columns="airspeed"),
                "lacks the columns 'airspeed'.*pitot tube.*less an estimated wind: give a column",
            ),
            (lambda table: table.assign(beta=np.nan), "0 rows in which all of .*'beta': 400"),
            (lambda table: table.iloc[:1], "1 rows in which all .* none beside another"),
        ],
    )
    def test_a_flight_that_nothing_is_learned_from(self, refused, write, change, message):
        refused(message, "--test", "test.csv", train=[write("f.csv", change)])

    def test_two_flights_of_one_name(self, refused, write):
        words = "'latlon' in latlon.csv and in .*copy.csv, but expected each once: .* rename one"
        refused(words, train=["latlon.csv", write("copy.csv")])
        refused("name a file once", train=["latlon.csv", "./latlon.csv"])


@pytest.mark.slow
@pytest.mark.usefixtures("short_flights", "short_fits", "no_report")
@pytest.mark.parametrize("short_flights", [2000], indirect=True)
def test_demo_is_honest(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    output = tmp_path / "skdgp-demo"
    assert command(["demo", "--samples", "100", "--max-iter", "15", "--horizon", "2"]) == 0
    assert_only_stopped(capsys.readouterr().err.splitlines())
    assert {path.name for path in output.iterdir()} == {
        "model.joblib", "metrics.json", "report.html",
    }  # fmt: skip
    (flight,) = json.loads((output / "metrics.json").read_text())["test"].values()
    means = flight["means"]
    assert 0.90 <= means["measured"]["interval_coverage"] <= 0.99
    assert means["truth"]["normalized_rmse"] < 0.2
    pipeline = load_model(output / "model.joblib").pipeline
    assert (pipeline.turbulence_.intensity > 0.2).all()  # as flown
    assert 0 < pipeline.seconds_ <= 2 * 2000 * 0.05


@pytest.mark.slow
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
        (1000, "after_the_model", ["--samples", "60", "--paths", "5"]),
    ],
    indirect=["short_flights"],
)
@pytest.mark.filterwarnings("ignore::skdgp.dynamics.SimulationWarning")
def test_examples_draw(name, arguments, example, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    module = example(name)
    if name == "grid_search_flights":  # one candidate of eight
        module.GRID = {key: values[:1] for key, values in module.GRID.items()}
    module.main([*arguments, "--output", str(picture)])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in capsys.readouterr().out


def test_example_of_a_real_flight_says_that_there_is_no_network(
    example, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")  # nobody listens there
    example("real_flight").main([])
    assert re.search(r"No log \(.*\)\. Fetch it from\nhttps://", capsys.readouterr().out)
    assert list(tmp_path.iterdir()) == []
