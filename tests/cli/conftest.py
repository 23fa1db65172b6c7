"""Flights and a model for the tests of the command line, made once by one of the processes of a test run."""

import io
import json
import pickle
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from unittest.mock import patch

import pytest

QUICK = ["--samples", "40", "--max-iter", "3"]


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
def the_error(capsys):
    """Return a function to the one line of an error that was printed, after warnings."""

    def the_error():
        lines = capsys.readouterr().err.splitlines()
        (error,) = [line for line in lines if not line.startswith("warning: ")]
        return error

    return the_error


@pytest.fixture
def no_report(no_pictures, no_mechanics):
    """Leave pictures out, and the flight mechanics: ``identified`` and processes of their own have them."""


@pytest.fixture(scope="session")
def identified(folder, once, cut_short, command):
    """Return what a whole run wrote and said, but for its pictures, which take longer to draw than all else."""

    def write(results):
        flights = ["lateral.csv", "latlon.csv", "--aircraft", "uav.json", "--test", "test.csv"]
        words = [
            "identify",
            *flights,
            *QUICK,
            "--horizon",
            "1",
            "-o",
            str(results / "deep" / "er"),
        ]
        out = io.StringIO()
        err = io.StringIO()
        with (
            patch.dict(sys.modules, {"matplotlib": None}),
            cut_short(),
            chdir(folder),
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            code = command(words)
        done = subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())
        (results / "said.pickle").write_bytes(pickle.dumps(done))

    results = once("results", write)
    output = results / "deep" / "er"
    done = pickle.loads((results / "said.pickle").read_bytes())
    assert done.returncode == 0, done.stderr
    return (
        output,
        done,
        json.loads((output / "metrics.json").read_text(), parse_constant=pytest.fail),
    )
