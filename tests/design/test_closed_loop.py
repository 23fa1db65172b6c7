"""The example of a closed loop learns, plans, flies, and learns again."""

from functools import partial

import pytest

from skdgp import datasets


def short(fly, truth, aircraft, train, seconds, seed):
    """Fly 12 s at most."""
    return fly(truth, aircraft, train, min(seconds, 12.0), seed)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.usefixtures("few_manoeuvres", "short_fits")
def test_it_runs(example, first_minute, monkeypatch, tmp_path, capsys):
    """With the aircraft of the shared flights."""
    monkeypatch.setattr(datasets, "load_example_flights", lambda turbulence: first_minute())
    loop = example("closed_loop")
    monkeypatch.setattr(loop, "fly", partial(short, loop.fly))
    picture = tmp_path / "loop.png"
    loop.main(["--rounds", "1", "--seconds", "12", "--output", str(picture)])
    assert picture.stat().st_size > 0
    assert "scale" in capsys.readouterr().out  # of the planned manoeuvres
