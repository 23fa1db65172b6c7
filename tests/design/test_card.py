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
from skdgp.dynamics import Aerodynamics, Aircraft, trim

NAMES = ("alpha", "q_hat", "elevator", "rudder")
QUANTITIES = ("alpha", "beta", "load_factor", "bank", "airspeed", "altitude")


@pytest.fixture(scope="module")
def plan():
    """Return a plan of two kinds of manoeuvres, one of them flown twice, whose numbers are all known."""
    aircraft = Aircraft(
        mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55, name="<uav>"
    )

    def linear(X):
        alpha, q, elevator, rudder = X.T
        lift = 0.3 + 4.5 * alpha
        moment = 0.02 - 0.6 * alpha - 9 * q - elevator
        return np.stack([-0.02 * lift, 0 * q, -lift, 0 * q, moment, -0.06 * rudder], axis=-1)

    model = Aerodynamics(linear, NAMES)
    pulse = {"elevator": doublet(0.5, np.deg2rad(4.0))}
    sines = dict(orthogonal_multisines({"elevator": 0.05, "rudder": 0.05}, 5.0, (0.4, 2.0)))
    rows = pd.DataFrame({
        "start": [2.0, 5.0, 12.0], "name": ["pulse", "sines", "pulse"],
        "duration": [1.0, 5.0, 1.0], "pause": 2.0, "scale": [1.0, 0.5, 1.0], "risk": [0.03, 0.016, 0.03],
    })  # fmt: skip
    time = np.arange(0.0, 3.0, 0.04)
    wave = 0.01 * np.sin(time)
    names = ("alpha", "beta", "phi", "q", "elevator", "rudder")
    one = pd.DataFrame(dict.fromkeys(names, wave))
    one = one.assign(time=time, airspeed=20.0, altitude=100.0, az=-9.80665)
    for k, name in enumerate(QUANTITIES):
        one = one.assign(**{f"{name}_low": -1.0 - k, f"{name}_high": 1.0 + k})
    bounds = Envelope(alpha=(-0.1, 0.2), altitude=60.0).bounds(model)
    limits = pd.DataFrame(bounds, index=["low", "high"]).T
    limits.loc["growth of alpha"] = [-0.05, 0.3]
    return Plan(
        train=wavetrain([pulse, sines, pulse], pause=2.0),
        trim=trim(model, aircraft, 20.0, altitude=100.0),
        manoeuvres=rows,
        flight=pd.concat([one.assign(flight=k) for k in range(3)]),
        errors=pd.DataFrame({"before": [0.5, 0.4], "promised": [0.1, 0.2]}, ["Cm_alpha", "Cm_q"]),
        limits=limits,
        aircraft=aircraft,
    )


@pytest.fixture(scope="module")
def html(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("card") / "card.html"
    assert write_flight_card(path, plan, full={"elevator": np.deg2rad(20.0)}) == path
    return path.read_text(encoding="utf-8")


def words_of(html):
    """Return what a reader sees."""
    seen = re.sub(r"<(style|title)>.*?</\1>|<[^>]*>", " ", html, flags=re.DOTALL)
    return " ".join(unescape(seen).split())


def test_it_needs_nothing_else(html):
    assert "<script" not in html
    assert set(re.findall(r'(?:src|href)="(.)', html)) <= {"#", "d"}  # data:
    assert "<uav>: next flight" in words_of(html)
    assert "<uav>" not in html


def test_steps_are_the_inputs(html):
    """4 degrees are a fifth of 20."""
    words = words_of(html)
    assert "elevator: nose down 0.00 0.50 4.0 " in words
    assert re.search(r"nose up 0\.50 0\.50 −4\.0 \S+ −20 ", words)
    assert "By hand, or by the autopilot." in words
    assert "By the autopilot: sums of sines up to 1.8 Hz" in words


def test_a_flight_without_limits_says_so(plan, tmp_path):
    bounds = Envelope(growth=np.inf).bounds(Aerodynamics(lambda X: 0 * X, NAMES))
    free = pd.DataFrame(bounds, ["low", "high"]).T
    path = write_flight_card(tmp_path / "card.html", replace(plan, limits=free))
    words = words_of(path.read_text(encoding="utf-8"))
    assert "Nothing limits this flight, not even a floor" in words
    assert "At any of these limits" not in words


def test_limits_are_the_narrower_and_in_degrees(html):
    words = words_of(html)
    ends = f"{np.rad2deg(-0.05):.1f} {np.rad2deg(0.2):.1f} asked, flown −57.3 … 57.3"
    assert f"alpha deg {ends}".replace("-", "−") in words
    assert "altitude m 60 – asked −6 … 6" in words
    assert "load factor g – – no limit −3.00 … 3.00" in words.replace("3.0 ", "3.00 ")
    assert "up to 3 s after the inputs with the controls held; the risk counts only 1 s" in words


def test_the_crew_knows_who_flies_when_and_at_which_risk(plan, html, tmp_path):
    """Of the flight: 1 - .97 .984 .97. Gusts of .6 m/s upwards are those of a wind of 6 m/s."""
    words = words_of(html)
    assert plan.risk == pytest.approx(1 - 0.97 * 0.984 * 0.97)
    assert "the flight 15.0 7.4 " in words
    assert all(name in words for name in ("Date", "Pilot", "MANUAL (ArduPilot) or Manual (PX4)"))
    assert "gusts calm air: no gust was checked" in words
    late = replace(plan, gusts=(0.9, 0.9, 0.6), servo_lag=0.047)
    gusty = write_flight_card(tmp_path / "card.html", late)
    said = words_of(gusty.read_text(encoding="utf-8"))
    assert "Surfaces follow these inputs 47 ms late." in said
    assert re.search(r"above ground at most 6\.0 m/s above .* hands off within ±1\.8 m/s", said)


def test_each_kind_stands_once_and_the_engineer_reads_the_promise(html):
    """The geometric mean of a fifth and a half."""
    words = words_of(html)
    assert len(re.findall('<section class="flight">', html)) == 2 + 1
    assert "No. 1, 3 of the order, at 2.0, 12.0 s." in words
    _, engineer = words.split("For the engineer")
    assert "Geometric mean of what is left: 32 %" in engineer
    assert "Cm_alpha 0.5 0.1 20 Cm_q 0.4 0.2 50" in engineer


@pytest.mark.parametrize(
    ("promised", "sentence"),
    [([0.6, 0.2], "Over 100: "), ([0.5, 0.4], "Nothing is "), ([np.nan] * 2, "Nothing is ")],
)
def test_a_promise_of_nothing_or_of_more_than_before_says_so(
    plan, html, tmp_path, promised, sentence
):
    assert sentence not in words_of(html)
    errors = plan.errors.assign(promised=promised)
    path = write_flight_card(tmp_path / "card.html", replace(plan, errors=errors))
    assert sentence in words_of(path.read_text(encoding="utf-8"))


def test_without_posterior_it_says_so(plan, tmp_path):
    bare = plan.flight[[name for name in plan.flight if not name.endswith(("_low", "_high"))]]
    rows = plan.manoeuvres.assign(risk=np.nan)
    write_flight_card(tmp_path / "card.html", replace(plan, flight=bare, manoeuvres=rows))
    assert "the mean of the model" in words_of((tmp_path / "card.html").read_text("utf-8"))
    with pytest.raises(FileNotFoundError):
        write_flight_card(tmp_path / "nowhere" / "card.html", plan)
