"""The example of a closed loop learns, plans, flies, and learns again."""

import importlib.util
from functools import partial
from pathlib import Path

import pytest

from skdgp import datasets

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "closed_loop.py"


@pytest.fixture
def example(monkeypatch, first_minute, few_manoeuvres):
    """Return the module of the example, with the aircraft of the shared flights and few manoeuvres."""
    monkeypatch.setattr(datasets, "load_example_flights", lambda turbulence: first_minute())
    spec = importlib.util.spec_from_file_location("closed_loop", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "fly", partial(short, module.fly))
    return module


def short(fly, truth, aircraft, train, seconds, seed):
    """Fly 12 s at most."""
    return fly(truth, aircraft, train, min(seconds, 12.0), seed)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_it_runs(example, tmp_path, capsys):
    picture = tmp_path / "loop.png"
    example.main(["--rounds", "1", "--seconds", "12", "--output", str(picture)])
    assert picture.stat().st_size > 0
    assert "scale" in capsys.readouterr().out  # of the planned manoeuvres
