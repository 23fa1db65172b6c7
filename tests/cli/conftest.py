"""Flights and a model for the tests of the command line, made once."""

import json
import os
import subprocess
import sys

import pytest

from skdgp.datasets import load_example_flights

QUICK = ["--samples", "40", "--max-iter", "3", "--latents", "1", "--structure", "joint"]
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Return a folder of short flights and their aircraft, as an engineer would have them."""
    folder = tmp_path_factory.mktemp("flights")
    data = load_example_flights()
    data.aircraft.to_json(folder / "uav.json")
    measured = [name for name in data.train if not name.endswith("_true")]
    for name, table in data.train.groupby("flight", observed=True):
        table[measured].iloc[1000:1700].to_csv(folder / f"{name}.csv", index=False)
    data.test.iloc[900:1400].to_csv(folder / "test.csv", index=False)
    return folder


@pytest.fixture(autouse=True)
def in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


@pytest.fixture(scope="session")
def identified(folder, tmp_path_factory):
    """Return what a whole run in a process of its own wrote and said."""
    output = tmp_path_factory.mktemp("results") / "deep" / "er"
    arguments = ["identify", "lateral.csv", "latlon.csv", "--aircraft", "uav.json", "--test", "test.csv"]
    done = process(*arguments, *QUICK, "--horizons", "1", "-o", output, cwd=folder)
    assert done.returncode == 0, done.stderr
    return output, done, json.loads((output / "metrics.json").read_text(), parse_constant=pytest.fail)


def process(*arguments, cwd, **options):
    command = [sys.executable, "-m", "skdgp", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False, **options)
