"""A planned flight: what it promises, what it risks, and what cannot be planned."""

from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from made_flights import LINEAR_GLIDER, lasting
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.design import Envelope, plan
from skdgp.dynamics import (
    linearize,
    simulate,
    stability_derivatives,
    trim,
)
from skdgp.preprocessing import RegressorSelector

FLOWN = {
    "airspeed": (5.0, 35.0),
    "altitude": (50.0, 100.0),
    "phi": (-1.0, 1.0),
    "az": (-30.0, 10.0),
}
LIMITS = {"elevator": 0.06}
ALPHA = (-0.03, 0.055)
LIMITED = Envelope({"alpha": ALPHA})
OPTIONS = {
    "axes": ["elevator"],
    "limits": LIMITS,
    "goal": ["Cm_q"],
    "seconds": 8.0,
}


@pytest.fixture(scope="module", autouse=True)
def few(manoeuvres_of):
    """Plan with few manoeuvres, to be fast."""
    with manoeuvres_of():
        yield


@pytest.fixture(scope="module")
def uav(glider):
    return glider.aircraft


@pytest.fixture(scope="module")
def model(glider):
    """Return a model whose derivatives are known to a tenth."""
    low = np.array([-0.1, -0.2, -0.1, -0.03, -0.1, -0.3, -0.3, -0.3])
    return glider.model(limits=[low, -low + [0.2, 0, 0, 0, 0, 0, 0, 0]], flown=FLOWN)


@pytest.fixture(scope="module")
def point(model, uav):
    return trim(model, uav, 20.0, altitude=100.0)


@pytest.fixture(scope="module")
def ask(model, uav, point):
    """Plan a short flight of the elevator with changed options, by the model or another one."""

    def ask(of=model, **changed):
        return plan(of, uav, point, **OPTIONS | changed)

    return ask


@pytest.fixture(scope="module")
def planned(ask, manoeuvres_of):
    with manoeuvres_of((1.0, 2.5), (5.0, 10.0)):
        return ask(goal=["Cm_alpha", "Cm_q"], seconds=14.0, envelope=LIMITED)


def test_the_time_and_the_limits_are_kept(planned):
    table = planned.train.table(50.0)
    assert_allclose(planned.train.duration + 3.0, planned.seconds)
    assert planned.seconds <= 14.0
    assert table["elevator"].abs().max() <= 0.06
    assert planned.manoeuvres["pause"].iloc[-1] == 3.0
    ends = planned.manoeuvres["start"] + planned.manoeuvres["duration"]
    for start, end in zip(planned.manoeuvres["start"], ends, strict=True):
        is_inside = table["time"].between(start, end)
        signal = planned.train.inputs["elevator"][start]
        assert_allclose(table["elevator"][is_inside], signal(table["time"][is_inside] - start))


def test_the_pause_is_a_quarter_of_the_phugoid(glider, uav):
    """Of an aircraft that keeps its angle of attack, as Lanchester's does."""
    slopes = glider.slopes.copy()
    slopes[4, 0] *= 20
    slopes[2, 5] = 0.0
    stable = glider.model(slopes, has_paths=False)
    steady = trim(stable, uav, 40.0)
    phugoid = linearize(stable, uav, steady).modes().loc["phugoid", "period"]
    found = plan(stable, uav, steady, **OPTIONS | {"seconds": 15.0})
    assert_allclose(found.manoeuvres["start"][0], phugoid / 4, rtol=0.15)


@pytest.fixture(scope="module")
def table(planned):
    """Return the controls of the first manoeuvre, and of a second after it."""
    table = planned.train.table(50.0, trim=planned.trim.controls, pause=3.0)
    first = planned.manoeuvres.iloc[0]
    return table[table["time"].between(first["start"], first["start"] + first["duration"] + 1.0)]


def test_the_figure_shows_each_manoeuvre_at_its_time(planned):
    """The lines of the controls and of the responses begin and end with the manoeuvres."""
    display = planned.plot(Figure())
    assert display.keys == ["elevator", "alpha", "airspeed", "phi", "beta"]
    begins = display.time[np.flatnonzero(np.diff(planned.flight["flight"], prepend=-1))]
    assert_allclose(begins, planned.manoeuvres["start"])


@pytest.mark.filterwarnings("ignore::skdgp.dynamics.SimulationWarning")
def test_an_aircraft_that_responds_more_within_the_margin_stays_inside(planned, table, glider):
    assert (planned.manoeuvres["scale"] < 1).any()  # alpha was the limit
    stronger = glider.slopes.copy()
    stronger[:, 5] *= 1.0 + LIMITED.margin
    at_trim = (stronger - glider.slopes)[:, 5] * planned.trim.controls["elevator"]
    model = glider._replace(level=glider.level - at_trim).model(stronger)
    flown = simulate(model, glider.aircraft, planned.trim, table, 0.04)
    lowest, highest = ALPHA
    assert flown["alpha"].between(lowest - 1e-4, highest + 1e-4).all()  # nearly proportional
    ends = planned.flight["alpha"].agg(["min", "max"])
    expected, room = np.array([ends, ALPHA]) - planned.trim.alpha
    used = (1 + LIMITED.margin) * expected / room
    assert 0.8 < used.max() <= 1.0  # no more is given away


@pytest.mark.parametrize(("goal", "axis"), [("Cm_elevator", "elevator"), ("Cn_rudder", "rudder")])
def test_the_goal_decides_which_axis_moves(ask, goal, axis):
    limits = {"elevator": 0.06, "rudder": 0.06}
    found = ask(axes=[*limits], limits=limits, goal=[goal], seconds=7.0)
    assert found.manoeuvres["name"].str.startswith(axis).all()


LONGITUDINAL = ["alpha", "q_hat", "elevator"]
SLOPES = LINEAR_GLIDER.slopes[:, [0, 3, 5]]


def with_coefficients(X, rng):
    """Return regressors of a flight, and coefficients with errors that last five rows."""
    noise = 0.017 * lasting(rng, (len(X), 6), 4.5)
    noise[:, [1, 3, 5]] *= 1e-5  # there is a trim
    return X, LINEAR_GLIDER.level + X.to_numpy() @ SLOPES.T + noise


def flown_rows(n, size):
    rng = default_rng(1)
    X = 1.7 * size * lasting(rng, (n, 3), 4.5)
    return with_coefficients(pd.DataFrame(X, columns=LONGITUDINAL), rng)


def learned(*flights):
    tables, targets = zip(*flights, strict=True)
    regressor = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
    pipeline = make_pipeline(RegressorSelector(LONGITUDINAL), StandardScaler(), regressor)
    Y = pd.DataFrame(np.concatenate(targets), columns=COEFFICIENTS)
    return pipeline.fit(pd.concat(tables, ignore_index=True), Y)


def test_what_is_expected_is_what_derivatives_state_after_both_flights(ask, uav, point):
    first = flown_rows(200, 0.02)
    wide = Envelope({"bank": (-1.5, 1.5), "airspeed": (5.0, np.inf)}, growth=np.inf)
    found = ask(learned(first), goal=None, seconds=20.0, envelope=wide)
    q_hat = found.flight["q"] * uav.chord / (2 * found.flight["airspeed"])
    X = found.flight.assign(q_hat=q_hat)[LONGITUDINAL]
    after = learned(first, with_coefficients(X, default_rng(2)))
    errors = found.errors.assign(after=stability_derivatives(after, uav, point)["std"])
    assert (errors["expected"] < errors["before"]).all()
    assert 1 / 1.2 < (errors["expected"] / errors["after"]).median() < 1.2
    assert (errors["expected"] / errors["before"]).filter(like="elevator").max() < 0.6


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"goal": ["Cm_alpha_dot"]}, "Cm_alpha_dot.*learn a model with that regressor"),
        ({"goal": "Cm_q"}, "give a list"),
        ({"envelope": Envelope({"roll": (-1.0, 1.0)})}, "quantities of an envelope lack 'roll'"),
        ({"axes": ["elevator", "flaps"]}, "controls of the trim lack 'flaps'"),
        ({"limits": {"elevator": 5.0}}, "rad, not degrees"),
        ({"axes": "elevator"}, "Got axes='elevator', but expected different controls in a list"),
        ({"seconds": 1e9}, "at most 1800"),
        ({"goal": ["Cm_beta"]}, r"manoeuvres of \['elevator'\] within their limits lower"),
        ({"seconds": 5.0}, r"but expected at least .* s: give .* s more"),
        (
            {"envelope": Envelope({"altitude": (200.0, np.inf)})},
            "trimmed flight at 20 m/s and 100 m leaves by altitude: widen",
        ),
        (
            {"seconds": 7.0, "limits": {"elevator": 1.5}},
            "every manoeuvre leaves .* by alpha: widen .*--growth",
        ),
    ],
)
def test_what_cannot_be_planned_is_said(ask, changed, words):
    with pytest.raises(ValueError, match=words):
        ask(**changed)


@pytest.mark.parametrize(
    "limit",
    [
        {"alpha": (None, 0.2)},
        {"beta": (0.2, -0.2)},
    ],
    ids=str,
)
def test_invalid_limits_are_refused_by_name(limit):
    with pytest.raises(ValueError, match=f"Got {next(iter(limit))}="):
        Envelope(limit)


@pytest.mark.parametrize(
    ("axis", "limits", "words"),
    [
        ("elevator", {}, "does not say what was flown"),
        ("throttle", {"throttle": 0.2}, "0 to 1, which leaves it no room"),
    ],
)
def test_a_control_without_room_is_told(axis, limits, words, glider, uav, point):
    full = replace(point, controls=point.controls | {"throttle": 1.0})
    with pytest.raises(ValueError, match=words):
        plan(
            glider.model(flown=FLOWN),
            uav,
            full,
            **OPTIONS | {"axes": [axis], "limits": limits, "envelope": Envelope(growth=np.inf)},
        )


def test_without_options_a_plan_stays_in_what_was_flown(ask, model, uav, point):
    narrow = copy(model)
    narrow.flown = FLOWN | {"az": (-12.5, -7.0)}
    inside = []
    for envelope in (Envelope(), Envelope({"load_factor": (-9.0, 9.0)})):
        found = ask(narrow, limits={"elevator": 0.09}, envelope=envelope)
        table = found.train.table(50.0, trim=point.controls, pause=3.0)
        flown = simulate(narrow, uav, point, table, 0.04)
        inside.append(flown["az"].between(-12.5 - 0.55, -7.0 + 0.55).all())
    assert inside == [True, False]
