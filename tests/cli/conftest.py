"""Flights and a model for the tests of the command line, made once by one of the processes of a test run."""

import io
import json
import pickle
import subprocess
from contextlib import redirect_stderr, redirect_stdout

import pytest

from skdgp._cli import main
from skdgp.identification import _identification
from skdgp.plotting import EffectsDisplay

QUICK = ["--samples", "40", "--max-iter", "3", "--latents", "1", "--structure", "joint"]


@pytest.fixture(scope="session")
def folder(once, first_minute):
    """Return a folder of short flights and their aircraft, as an engineer would have them."""
    return once("flights", lambda folder: write_flights(folder, first_minute()))


def write_flights(folder, data):
    (folder / "uav.json").write_text(data.aircraft.to_json())
    measured = [name for name in data.train if not name.endswith("_true")]
    for name, table in data.train.groupby("flight", observed=True):
        table[measured].iloc[1000:1400].to_csv(folder / f"{name}.csv", index=False)
    data.test.iloc[900:1200].to_csv(folder / "test.csv", index=False)


@pytest.fixture(autouse=True)
def in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.fixture
def no_report(monkeypatch, no_mechanics):
    """Leave the report out, and the flight mechanics it shows: ``identified`` and processes of their own have them."""
    leave_report_out(monkeypatch)


def leave_report_out(patch):
    patch.setattr(_identification, "render_report", lambda content: "")
    patch.setattr(EffectsDisplay, "from_model", lambda model, ax: None)


@pytest.fixture(scope="session")
def identified(folder, once, cut_short):
    """Return what a whole run wrote and said, but for its report, which takes longer to draw than all else."""

    def write(results):
        arguments = [
            "identify",
            "lateral.csv",
            "latlon.csv",
            "--aircraft",
            "uav.json",
            "--test",
            "test.csv",
        ]
        words = [*arguments, *QUICK, "--horizons", "1", "-o", str(results / "deep" / "er")]
        said = io.StringIO(), io.StringIO()
        with (
            pytest.MonkeyPatch.context() as patch,
            cut_short(),
            redirect_stdout(said[0]),
            redirect_stderr(said[1]),
        ):
            patch.chdir(folder)
            leave_report_out(patch)
            done = subprocess.CompletedProcess(
                words, main(words), *(stream.getvalue() for stream in said)
            )
        (results / "said.pickle").write_bytes(pickle.dumps(done))

    results = once("results", write)
    output, done = results / "deep" / "er", pickle.loads((results / "said.pickle").read_bytes())
    assert done.returncode == 0, done.stderr
    return (
        output,
        done,
        json.loads((output / "metrics.json").read_text(), parse_constant=pytest.fail),
    )
