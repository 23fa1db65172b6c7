"""The flight card: whole, self-contained, and true to its plan."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pandas as pd
import pytest

from skdgp._display import page
from skdgp.design import (
    Envelope,
    Information,
    Plan,
    Wavetrain,
    doublet,
    orthogonal_multisines,
    wavetrain,
    write_flight_card,
)
from skdgp.design._envelope import QUANTITIES
from skdgp.dynamics import Aerodynamics, Aircraft, trim

NAMES = ("alpha", "q_hat", "elevator", "rudder")
PAUSE = 2.0


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

    pulse = {"elevator": doublet(0.5, np.deg2rad(4.0))}
    sines = dict(
        orthogonal_multisines({"elevator": 0.05, "rudder": 0.05}, 5.0, (0.4, 2.0), n_starts=1)
    )
    train = wavetrain([pulse, sines, pulse], pause=PAUSE)
    rows = pd.DataFrame({
        "train": 0, "airspeed": 20.0, "start": [2.0, 5.0, 12.0], "name": ["pulse", "sines", "pulse"],
        "duration": [1.0, 5.0, 1.0], "pause": PAUSE, "scale": [1.0, 0.5, 1.0], "risk": [0.03, 0.016, 0.03],
        "gain": [0.5, 0.2, 0.1],
    })  # fmt: skip
    time = np.arange(0.0, 3.0, 0.04)
    one = pd.DataFrame(
        {name: 0.01 * np.sin(time) for name in ("alpha", "beta", "phi", "q", "elevator", "rudder")}
    )
    one = one.assign(time=time, airspeed=20.0, altitude=100.0, az=-9.80665)
    for k, name in enumerate(QUANTITIES):
        one = one.assign(**{f"{name}_low": -1.0 - k, f"{name}_high": 1.0 + k})
    limits = pd.DataFrame(
        Envelope(alpha=(-0.1, 0.2), altitude=60.0).bounds(Aerodynamics(linear, NAMES))
    ).T
    limits.columns = ["low", "high"]
    limits.loc["growth of alpha"] = [-0.05, 0.3]
    before = Information(np.stack([np.eye(5) * 4.0]), ("Cm",), NAMES)
    parts = tuple(Information(np.stack([np.diag(d)]), ("Cm",), NAMES)
                  for d in ([0, 60, 0, 0, 0], [0, 0, 12, 0, 0], [0, 36, 0, 0, 0]))  # fmt: skip
    return Plan(
        (train,), (trim(Aerodynamics(linear, NAMES), aircraft, 20.0, altitude=100.0),), ("Cm_alpha", "Cm_q"), before,
        sum(parts, before), rows, pd.concat([one.assign(flight=k) for k in range(3)]), parts, limits,
        aircraft, dict.fromkeys(NAMES, 0.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def html(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("card") / "card.html"
    assert write_flight_card(path, plan, full={"elevator": np.deg2rad(20.0)}) == path
    return path.read_text(encoding="utf-8")


def words_of(html):
    """Return what a reader sees."""
    shown = re.sub(r"<(style|title)>.*?</\1>|<[^>]*>", " ", html, flags=re.DOTALL)
    return " ".join(unescape(shown).split())


def test_goals_that_are_no_derivatives_are_said_in_words(plan, tmp_path):
    one = replace(plan, goal=("function", "Cm_q"), weights={"function": np.eye(5)[None]})
    words = words_of(write_flight_card(tmp_path / "card.html", one).read_text(encoding="utf-8"))
    assert "of the error of all coefficients and Cm_q is left" in words
    assert "in thousandths; all coefficients over the flown range" in words


def test_it_needs_nothing_else(html):
    assert "<script" not in html
    assert set(re.findall(r'(?:src|href)="(.)', html)) <= {"#"}
    assert "<uav>: next flight" in words_of(html)
    assert "<uav>" not in html


def test_steps_are_the_inputs(html):
    """4 degrees are a fifth of 20."""
    words = words_of(html)
    assert "nose down 0.00 0.50 +4.0 deg" in words
    assert re.search(r"nose up 0\.50 0\.50 −4\.0 deg \S+ deg −20 ", words)
    assert (
        "By hand, or by the autopilot. Elevator 4.0 deg, nose down, for 0.5 s; elevator 4.0 deg, "
        "nose up," in words
    )
    assert "By the autopilot: sums of sines up to 1.8 Hz, which" in words


def test_steps_name_their_control_and_its_unit(plan, tmp_path):
    """Of one manoeuvre, by the throttle, which has no unit, and the aileron."""
    move = {"throttle": doublet(6.40352, 0.5817), "aileron": doublet(1.0, np.deg2rad(8.0))}
    one = replace(
        plan, trains=(wavetrain([move], pause=PAUSE),), manoeuvres=plan.manoeuvres.iloc[:1], parts=plan.parts[:1],
        flight=plan.flight[plan.flight["flight"] == 0],
    )  # fmt: skip
    words = words_of(write_flight_card(tmp_path / "card.html", one).read_text(encoding="utf-8"))
    assert "1 manoeuvre of 1 kind · planned" in words
    assert "throttle: more power 0.00 6.40 +0.58 0.58 " in words
    assert "aileron: roll left 1.00 1.00 −8.0 deg −8.0 deg " in words
    assert (
        "Throttle 0.58, more power, for 6.4 s; throttle 0.58, less power, for 6.4 s; throttle "
        "back to trim;" in words
    )
    assert "aileron 8.0 deg, roll right, for 1 s;" in words


def test_a_flight_without_limits_says_so(plan, tmp_path):
    free = pd.DataFrame(
        Envelope(growth=np.inf).bounds(Aerodynamics(lambda X: 0 * X, NAMES)), ["low", "high"]
    ).T
    path = write_flight_card(tmp_path / "card.html", replace(plan, limits=free))
    words = words_of(path.read_text(encoding="utf-8"))
    assert "Nothing limits this flight, not even a floor" in words
    assert "At any of these limits" not in words


def test_what_is_expected_may_pass_a_limit_after_the_time_that_the_risk_counts(html):
    assert (
        "up to 3 s after the inputs with the controls held. This may pass a limit: the risk "
        "counts only 1 s" in (words_of(html))
    )


def test_limits_are_the_narrower_and_in_degrees(html):
    words = words_of(html)
    assert (
        f"alpha deg {np.rad2deg(-0.05):.1f} {np.rad2deg(0.2):.1f} asked, flown −57.3 … 57.3 −57.3 "
        f"… 57.3".replace("-", "−")
        in words
    )
    assert "altitude m 60 – asked −6 … 6 −6 … 6" in words
    assert "load factor g – – no limit −3.0 … 3.0" in words
    assert words.count("abort below") == 1


def test_the_crew_knows_who_flies_when_and_at_which_risk(plan, html, tmp_path):
    """Of the flight: 1 - .97 .984 .97. Gusts of .6 m/s upwards are those of a wind of 6 m/s."""
    words = words_of(html)
    assert plan.risk == pytest.approx(1 - 0.97 * 0.984 * 0.97)
    assert "the flight 15.0 7.4 " in words
    assert "7.4 % risk of the flight: that any manoeuvre leaves a limit 3.0 % largest" in words
    assert all(name in words for name in ("Date", "Pilot", "MANUAL (ArduPilot), Manual (PX4)"))
    assert "gusts calm air: no gust was checked" in words
    gusty = write_flight_card(tmp_path / "card.html", replace(plan, gusts=(0.9, 0.9, 0.6)))
    said = words_of(gusty.read_text(encoding="utf-8"))
    assert re.search(r"above ground at most 6\.0 m/s above .* hands off within ±1\.8 m/s", said)


def test_errors_that_no_flight_lowers_stand_beside_the_others(plan, tmp_path):
    """The squares of .5 and 1.2 add up to that of 1.3."""
    one = replace(plan, merged={"Cm_q": 1.2, "Cm_alpha": 0.0})
    assert one.errors["std"].to_dict() == pytest.approx({"Cm_alpha": 0.5, "Cm_q": 1.3})
    words = words_of(write_flight_card(tmp_path / "card.html", one).read_text(encoding="utf-8"))
    assert re.search(
        r"before after std now left \[%\] C m alpha 500 100 500 20 C m q 500 250 1300 50 ", words
    )


def test_each_kind_stands_once_with_its_times_and_what_it_teaches(html):
    """Both pulses: 4 + 60 + 36 = 25 times 4, so a fifth of the error; the sines: 4 + 12 = 4 times 4, a half."""
    words = words_of(html)
    assert len(re.findall('<section class="flight">', html)) == 2 + 1  # the last is the engineer's
    assert "No. 1, 3 of the order, at 2.0 s, 12.0 s." in words
    assert "If only this is flown, it leaves 20 % of the error of C m alpha ." in words
    assert "If only this is flown, it leaves 50 % of the error of C m q ." in words
    crew, engineer = words.split("For the engineer")
    assert re.search(r"m alpha 500 100 20 ", engineer)  # thousandths
    assert "20 % of the error" not in crew


def test_without_posterior_or_matplotlib_it_says_so(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "find_spec", lambda name: None)
    bare = plan.flight[[name for name in plan.flight if not name.endswith(("_low", "_high"))]]
    write_flight_card(
        tmp_path / "card.html",
        replace(plan, flight=bare, manoeuvres=plan.manoeuvres.assign(risk=np.nan)),
    )
    words = words_of((tmp_path / "card.html").read_text(encoding="utf-8"))
    assert "of the mean of the model" in words
    assert "No pictures: they need matplotlib" in words
    with pytest.raises(FileNotFoundError):
        write_flight_card(tmp_path / "nowhere" / "card.html", plan)


def test_inputs_are_found_by_manoeuvre(plan):
    assert set(plan.inputs(1)) == {"elevator", "rudder"}
    rebuilt = Wavetrain({"elevator": {2.0: plan.inputs(0)["elevator"]}})
    assert rebuilt("elevator", 2.25) == pytest.approx(np.deg2rad(4.0))
