"""Flights and a model for the tests of the command line, made once by one of the processes of a test run."""

import io
import json
import sys
import threading
from contextlib import chdir, redirect_stderr, redirect_stdout
from types import SimpleNamespace
from unittest.mock import patch

import pytest

QUICK = ["--samples", "40", "--max-iter", "3"]


class Watched(io.StringIO):
    """A stream, on a terminal or not, that tells when some words were first written, and acts then."""

    def __init__(self, words, is_terminal, act=lambda: None):
        super().__init__()
        self.words = words
        self.is_terminal = is_terminal
        self.act = act
        self.was_written = threading.Event()

    def isatty(self):
        return self.is_terminal

    def write(self, text):
        super().write(text)
        if self.words in text and not self.was_written.is_set():
            self.was_written.set()
            self.act()


@pytest.fixture
def watched():
    """Return the class of streams that tell when some words were written."""
    return Watched


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
def no_report(no_pictures, no_mechanics):
    """Leave pictures out, and the flight mechanics: ``identified`` and processes of their own have them."""


@pytest.fixture(scope="session")
def identified(folder, once, cut_short, command):
    """Return what a whole run wrote and said, but for its pictures, which take longer to draw than all else."""

    def write(results):
        words = "identify lateral.csv latlon.csv --aircraft uav.json --test test.csv --horizon 1"
        with (
            patch.dict(sys.modules, {"matplotlib": None}),
            cut_short(),
            chdir(folder),
            (results / "out").open("w", encoding="utf-8") as out,
            (results / "err").open("w", encoding="utf-8") as err,
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            assert command([*words.split(), *QUICK, "-o", results / "deep" / "er"]) == 0

    results = once("results", write)
    output = results / "deep" / "er"
    metrics = json.loads((output / "metrics.json").read_text(), parse_constant=pytest.fail)
    out, err = ((results / name).read_bytes().decode() for name in ("out", "err"))
    return SimpleNamespace(output=output, out=out, err=err, metrics=metrics)
