"""The flight card: whole, self-contained, and true to its plan."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pandas as pd
import pytest

from skdgp.design import (
    Envelope,
    Plan,
    doublet,
    orthogonal_multisines,
    wavetrain,
    write_flight_card,
)
from skdgp.dynamics import trim


@pytest.fixture(scope="module")
def plan(glider):
    """Return a plan of two kinds of manoeuvres, one of them flown twice, whose numbers are all known."""
    pulse = {"elevator": doublet(0.5, np.deg2rad(4.0))}
    sines = dict(orthogonal_multisines({"elevator": 0.05, "rudder": 0.05}, 5.0, (0.4, 2.0)))
    rows = pd.DataFrame({
        "start": [2.0, 5.0, 12.0], "name": ["pulse", "sines", "pulse"],
        "duration": [1.0, 5.0, 1.0], "pause": 2.0, "scale": [1.0, 0.5, 1.0],
    })  # fmt: skip
    time = np.arange(0.0, 3.0, 0.04)
    wave = np.deg2rad(6.0) * np.sin(time)
    one = pd.DataFrame({"time": time, "alpha": wave, "beta": 0.0, "phi": wave, "airspeed": 20.0})
    one = one.assign(altitude=100.0, az=-9.80665)
    bounds = Envelope(alpha=(-0.1, 0.2), altitude=60.0).bounds(glider.model())
    limits = pd.DataFrame(bounds, index=["low", "high"]).T
    limits.loc["alpha"] = [-0.05, 0.2]
    return Plan(
        train=wavetrain([pulse, sines, pulse], pause=2.0),
        trim=trim(glider.model(), glider.aircraft, 20.0, altitude=100.0),
        manoeuvres=rows,
        flight=pd.concat([one.assign(flight=k) for k in range(3)]),
        errors=pd.DataFrame({"before": [0.5, 0.4], "promised": [0.1, 0.2]}, ["Cm_alpha", "Cm_q"]),
        limits=limits,
        aircraft=replace(glider.aircraft, name="<uav>"),
        margin=0.3,
        servo_lag=0.047,
    )


@pytest.fixture
def written(tmp_path):
    """Return a function of a plan: its card."""

    def write(plan):
        path = tmp_path / "card.html"
        assert write_flight_card(path, plan, full={"elevator": np.deg2rad(20.0)}) == path
        return path.read_text(encoding="utf-8")

    return write


def words_of(html):
    """Return what a reader sees."""
    seen = re.sub(r"<(style|title)>.*?</\1>|<[^>]*>", " ", html, flags=re.DOTALL)
    return " ".join(unescape(seen).split())


def test_it_needs_nothing_else_and_holds_each_kind_once(plan, written):
    html = written(plan)
    assert "<script" not in html
    assert set(re.findall(r'(?:src|href)="(.)', html)) <= {"#", "d"}  # data:
    assert "<uav>: next flight" in words_of(html)
    assert "<uav>" not in html
    assert html.count('<section class="flight">') == 2


def test_the_crew_reads_limits_order_and_steps(plan, written):
    """4 degrees are a fifth of 20; limits are the narrower, in degrees."""
    words = words_of(written(plan))
    assert f"alpha [deg] −2.9 {np.rad2deg(0.2):.1f} 0.0 … 6.0" in words
    assert "altitude [m] 60.0 ∞ 100.0 … 100.0".replace("∞", "–") in words
    assert "bank [deg] – – 0.0 … 6.0" in words
    assert "responses 30% larger are still inside" in words
    assert "Surfaces follow these inputs 47 ms late." in words
    assert "2. sines 5.0 5.0 50 ☐" in words
    assert "the flight 15.0" in words
    assert re.search(r"elevator \[deg\] 0\.50 −4\.0 \S+ −20 ", words)
    assert "By the autopilot." in words
    assert all(name in words for name in ("Date", "Pilot", "MANUAL (ArduPilot) or Manual (PX4)"))


def test_a_flight_without_limits_says_so(plan, written, glider):
    bounds = Envelope(growth=np.inf).bounds(glider.model())
    free = pd.DataFrame(bounds, ["low", "high"]).T
    warning = "Nothing limits this flight, not even a floor"
    assert warning in words_of(written(replace(plan, limits=free)))
    assert warning not in words_of(written(plan))


def test_the_engineer_reads_the_promise(plan, written):
    """The geometric mean of a fifth and a half."""
    words = words_of(written(plan))
    assert "Geometric mean of what is left: 32 %" in words
    assert "Cm_alpha 0.5 0.1 Cm_q 0.4 0.2" in words
    assert "Nothing is promised" not in words


@pytest.mark.parametrize("promised", [[0.5, 0.4], [np.nan] * 2])
def test_a_promise_of_nothing_says_so(plan, written, promised):
    errors = plan.errors.assign(promised=promised)
    assert "Nothing is promised" in words_of(written(replace(plan, errors=errors)))


def test_a_folder_that_does_not_exist_is_refused(plan, tmp_path):
    with pytest.raises(FileNotFoundError):
        write_flight_card(tmp_path / "nowhere" / "card.html", plan)
