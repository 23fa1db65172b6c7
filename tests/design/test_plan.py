"""A planned flight: what it teaches, what it risks, and what cannot be planned."""

from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lsim

from skdgp import design, listening
from skdgp._flight.channels import COEFFICIENTS
from skdgp.design import (
    Envelope,
    Information,
    Known,
    Limits,
    Pilot,
    _information,
    _library,
    doublet,
    expected_information,
    posterior_information,
)
from skdgp.design._information import errors_of
from skdgp.design._planner import pause_of
from skdgp.design._rehearsal import Hold, Rehearsal
from skdgp.dynamics import Aerodynamics, Turbulence, linearize, simulate, trim

pytestmark = pytest.mark.usefixtures("few_manoeuvres")  # but for `planned`

NAMES = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
# Coefficients CX ... Cn by 1 and the regressors; lift and drag are linear here.
TABLE = np.array([
    [-0.01, 0.2, 0, 0, 0, 0, 0, 0, 0],
    [0, 0, -0.5, 0, 0, 0, 0, 0, 0.1],
    [-0.3, -4.5, 0, 0, 0, 0, 0, 0, 0],
    [0, 0, -0.05, -0.4, 0, 0.1, 0, 0.1, 0],
    [0.02, -0.6, 0, 0, -9, 0, -1, 0, 0],
    [0, 0, 0.08, -0.03, 0, -0.1, 0, 0, -0.06],
])  # fmt: skip
FLOWN = {
    "airspeed": (5.0, 35.0),
    "altitude": (50.0, 100.0),
    "phi": (-1.0, 1.0),
    "az": (-30.0, 10.0),
}
SPREAD = 0.08
NOISE = pd.DataFrame({"white": 0.002, "drift": 0.002, "memory": 0.5}, index=["CZ", "Cm"])
AXES = {
    "axes": ["elevator"],
    "limits": {"elevator": 0.06},
    "noise": NOISE,
    "airspeeds": 20.0,
    "n_paths": 20,
    "rate": 25.0,
    "gusts": None,
}
BANDS = pd.DataFrame(
    {"doublet_width": 0.4, "three_two_one_one_width": 0.3, "lowest": 0.3, "highest": 1.2},
    index=["elevator"],
)


def plan(model, aircraft, **options):
    """Return `skdgp.design.plan`, its options side by side, also those of `Known`, `Pilot` and `Envelope`."""
    for name, kind in (("known", Known), ("pilot", Pilot)):
        if inside := {key: options.pop(key) for key in kind._fields if key in options}:
            options[name] = kind(**inside)
    checks = {key: options.pop(key) for key in ("gusts", "n_paths") if key in options}
    if isinstance(envelope := options.get("envelope", Envelope()), Envelope):
        options["envelope"] = replace(envelope, **checks)
    return design.plan(model, aircraft, **options)


def features(X):
    return np.concatenate([np.ones((*X.shape[:-1], 1)), X], axis=-1)


@pytest.fixture(scope="module")
def model():
    """Return a model whose derivatives are known to eight parts in a hundred."""

    def sampler(n_paths, random_state):
        draws = np.random.default_rng(random_state).standard_normal((n_paths, *TABLE.shape))
        table = TABLE * (1 + SPREAD * draws)
        return (
            lambda X: np.einsum("knd,kpd->knp", features(X), table),
            lambda X: np.broadcast_to(table[:, None, :, 1:], (*X.shape[:2], 6, 8)),
        )

    def covariance(X):
        blocks = [
            features(X) @ np.diag((SPREAD * row) ** 2 + 1e-8) @ features(X).T for row in TABLE
        ]
        return np.einsum("pq,pnm->pnqm", np.eye(6), blocks).reshape(6 * len(X), -1)

    low = np.array([-0.1, -0.2, -0.1, -0.03, -0.1, -0.3, -0.3, -0.3])
    return Aerodynamics(
        lambda X: features(X) @ TABLE.T, NAMES, gradient=lambda X: np.broadcast_to(TABLE[:, 1:], (len(X), 6, 8)),
        sampler=sampler, covariance=covariance, limits=[low, -low + [0.2, 0, 0, 0, 0, 0, 0, 0]], flown=FLOWN,
    )  # fmt: skip


@pytest.fixture(scope="module")
def planned(model, uav):
    with listening(lambda *progress: seen.append(progress)):
        seen = []
        found = plan(
            model, uav, seconds=15.0, goal=["Cm_alpha", "Cm_q"], bands=BANDS, envelope=Envelope(alpha=(-0.03, 0.055)),
            **AXES | {"gusts": Turbulence.low_altitude(100.0, 1.5)},
        )  # fmt: skip
    return found, seen


def test_expected_errors_are_those_of_the_whole_flight(planned, model, uav):
    found, seen = planned
    whole = sum(found.parts, found.before)
    np.testing.assert_allclose(found.errors["after"], whole.std.loc["Cm", ["alpha", "q_hat"]])
    pairs = whole.confounded()
    of_goal = (pairs["coefficient"] == "Cm") & pairs[["first", "second"]].isin(
        ["alpha", "q_hat"]
    ).any(axis=1)
    pd.testing.assert_frame_equal(found.confounded, pairs[of_goal].reset_index(drop=True))
    assert (found.errors["after"] < found.errors["before"]).all()
    gains = found.manoeuvres["gain"]
    assert 1 - np.prod(1 - gains) == pytest.approx(
        1 - np.sqrt((found.errors["after"] / found.errors["before"]).prod()), rel=1e-3
    )
    assert seen[0] == ("planning: trims", 0, 0.0)


def test_the_time_is_kept(planned):
    found, _ = planned
    assert found.trains[0].duration + 3.0 == pytest.approx(found.seconds)
    assert found.seconds <= 15.0
    assert found.trains[0].table(50.0)["elevator"].abs().max() <= 0.06


def test_surfaces_follow_with_the_lag_of_their_servo_and_teach_less(model, uav):
    lag, options = (
        0.1,
        AXES | {"seconds": 8.0, "bands": BANDS, "goal": ["Cm_elevator"], "random_state": 0},
    )
    quick = plan(model, uav, **options)
    slow = plan(model, uav, **options | {"limits": {"elevator": Limits(0.06, lag=lag)}})
    rows, time = slow.flight[slow.flight["flight"] == 0], np.arange(0.0, 5.0, 0.001)
    follows = lsim(([1.0], [lag, 1.0]), slow.inputs(0)["elevator"](time), time)[1]
    deflection = rows["elevator"].to_numpy() - slow.trims[0].controls["elevator"]
    wanted = slow.inputs(0)["elevator"]
    np.testing.assert_allclose(
        deflection, np.interp(rows["time"], time, follows), atol=0.1 * wanted.peak
    )
    assert np.abs(deflection - wanted(rows["time"].to_numpy())).max() > 0.5 * wanted.peak
    assert slow.errors.loc["Cm_elevator", "after"] > 1.05 * quick.errors.loc["Cm_elevator", "after"]


@pytest.mark.parametrize("airspeed", [30.0, 60.0])
def test_the_pause_is_a_quarter_of_the_phugoid(uav, airspeed):
    """Of an aircraft that keeps its angle of attack, as Lanchester's does."""
    table = TABLE.copy()
    table[4, 1] *= 20
    stable = Aerodynamics(lambda X: features(X) @ table.T, NAMES)
    phugoid = linearize(stable, uav, trim(stable, uav, airspeed)).modes().loc["phugoid", "period"]
    assert pause_of(airspeed) == pytest.approx(phugoid / 4, rel=0.15)
    assert pause_of(10.0) == 3.0


def test_of_a_longer_pause_three_seconds_are_response_and_end_the_flight(model, uav):
    options = AXES | {"rate": 50.0, "n_paths": 30}
    found = plan(model, uav, seconds=22.0, bands=BANDS, pause=8.0, goal=["Cm_q"], **options)
    first, last = found.manoeuvres.iloc[0], found.manoeuvres.iloc[-1]
    assert (first["start"], first["pause"], last["pause"]) == (8.0, 8.0, 3.0)
    assert found.flight["time"].max() == pytest.approx(
        found.manoeuvres["duration"].max() + 3.0, abs=0.04
    )
    assert found.seconds == pytest.approx(last["start"] + last["duration"] + 3.0)
    assert 22.0 - 8.0 < found.seconds <= 22.0


@pytest.mark.filterwarnings("ignore::skdgp.dynamics.SimulationWarning")
def test_the_risk_of_other_draws_is_what_was_allowed(planned, model, uav):
    found, _ = planned
    assert (found.manoeuvres["risk"] <= 0.05).all()
    assert (found.manoeuvres["scale"] < 1).any()  # alpha was the limit
    for _, one in found.manoeuvres.drop_duplicates("name").iterrows():
        table = found.trains[0].table(50.0, trim=found.trims[0].controls, pause=3.0)
        table = table[table["time"].between(one["start"], one["start"] + one["duration"] + 1.0)]
        paths = simulate(
            model, uav, found.trims[0], table, 0.04, n_paths=200, random_state=7,
            air=Turbulence.low_altitude(100.0, 1.5),
        )  # fmt: skip
        left = (
            Envelope(alpha=(-0.03, 0.055))
            .left(paths, uav, model)
            .groupby(paths["flight"], observed=True)
            .any()
        )
        assert left.any(axis=1).mean() <= 0.05 + 0.03


@pytest.mark.parametrize("curvature", [False, True])
def test_the_same_seed_gives_the_same_plan(model, uav, curvature):
    options = {
        "seconds": 8.0,
        "goal": ["Cm_q"],
        "bands": BANDS,
        "random_state": 3,
        "curvature": curvature,
    }
    one = plan(model, uav, **AXES, **options)
    if curvature:
        two = plan(model, uav, **AXES, **options)
        pd.testing.assert_frame_equal(one.manoeuvres, two.manoeuvres)
        np.testing.assert_allclose(one.after.fisher, two.after.fisher, rtol=1e-9, atol=1e-10)
    about = [*one.to_dict()["at"].values()] if curvature else None
    still = one.before + expected_information(one.flight, uav, NAMES, NOISE, about=about)
    ratio = one.after.std.loc["Cm", "q_hat"] / still.std.loc["Cm", "q_hat"]
    assert (
        ratio < 1 if curvature else ratio == pytest.approx(1)
    )  # entries beside the trim teach more


def test_the_posterior_is_the_information_of_a_linear_model(model):
    found = posterior_information(model, np.full(8, 0.01))
    expected = np.sqrt((SPREAD * TABLE[:, 1:]) ** 2 + 1e-8)
    np.testing.assert_allclose(found.std, expected, rtol=1e-3)
    constant = np.linalg.inv(found.fisher)[:, 0, 0]
    np.testing.assert_allclose(constant, (SPREAD * TABLE[:, 0]) ** 2 + 1e-8, rtol=1e-3, atol=1e-8)


def test_a_manoeuvre_beside_others_flies_as_alone(model, uav):
    limits = {"elevator": Limits(0.06)}
    rehearsal = Rehearsal(
        model,
        uav,
        trim(model, uav, 20.0),
        limits,
        Envelope(n_paths=20, gusts=None),
        50.0,
        1.0,
        "auto",
        0,
    )
    several = [{"elevator": doublet(0.3, 0.02)}, {"elevator": doublet(0.5, 0.01)}]
    for beside, one in zip(rehearsal.flown(several), several, strict=True):
        (alone,) = rehearsal.flown([one])
        np.testing.assert_allclose(beside[alone.columns.drop("flight")].select_dtypes(float),
                                   alone.select_dtypes(float), atol=1e-9)  # fmt: skip


def test_responses_may_grow_until_one_path_more_leaves_than_is_allowed():
    drawn = np.zeros((3, 2, 2))
    drawn[:, 1, 0] = [0.0, 0.05, 0.15]  # beside the trim at the second row
    response = np.array([[0.0, -0.1], [0.05, 9.0]])
    low, high = np.array([-1.0, -np.inf]), np.array([0.2, np.inf])
    for allowed, up, down in ((0, 1.0, 20.0), (1, 3.0, 21.0), (2, 4.0, 23.0)):
        hold = Hold(np.zeros((2, 2)), drawn, low, high, np.zeros(2), allowed)
        assert hold.largest(response[None]) == pytest.approx(up)
        assert hold.largest(np.stack([-2 * response] * 3)) == pytest.approx(down / 2)


@pytest.mark.filterwarnings("ignore::skdgp.dynamics.SimulationWarning")
def test_an_aircraft_that_responds_more_within_the_margin_stays_inside(planned, uav):
    found, _ = planned
    trimmed, elevator, envelope = (
        found.trims[0],
        1 + NAMES.index("elevator"),
        Envelope(alpha=(-0.03, 0.055)),
    )
    stronger = TABLE.copy()
    stronger[:, elevator] *= 1 + envelope.margin
    stronger[:, 0] -= (
        envelope.margin * TABLE[:, elevator] * trimmed.controls["elevator"]
    )  # the same trim
    aircraft = Aerodynamics(lambda X: features(X) @ stronger.T, NAMES)
    flown = simulate(
        aircraft, uav, trimmed, found.trains[0].table(50.0, trim=trimmed.controls, pause=3.0), 0.04
    )
    assert not envelope.left(flown, uav, aircraft).to_numpy().any()


def test_a_pilot_flies_steps_that_he_can_count(model, uav):
    options = AXES | {
        "seconds": 20.0,
        "bands": BANDS,
        "goal": ["Cm_q"],
        "envelope": Envelope(alpha=(-0.03, 0.055)),
    }
    found = plan(model, uav, **options, pause=3.2, detents={"elevator": 0.008})
    assert found.manoeuvres["start"][0] == 3.5
    whole = []
    for k, row in found.manoeuvres.iterrows():
        (signal,) = found.inputs(k).values()
        whole += [
            *np.divide(signal.durations, 0.5),
            row["start"] / 0.5,
            *np.divide(signal.levels, 0.008),
        ]
        assert row["scale"] == pytest.approx(signal.peak / 0.06)
    np.testing.assert_allclose(whole, np.round(whole), atol=1e-9)
    with pytest.raises(ValueError, match="axes with detents lack 'aileron'"):
        plan(model, uav, **options | {"axes": ["elevator", "aileron"]}, detents={"elevator": 0.02})
    with pytest.raises(ValueError, match=r"no manoeuvre .* smaller detents"):
        plan(model, uav, **options, detents={"elevator": 0.1})


def test_ctrl_c_keeps_what_was_checked(model, uav):

    def stop(stage, *_):
        if ", 1 kinds checked" in stage:
            raise KeyboardInterrupt

    with listening(stop):
        found = plan(model, uav, seconds=12.0, bands=BANDS, **AXES)
    assert found.manoeuvres["name"].nunique() == 1


def test_the_goal_decides_what_is_learned_best(model, uav):
    """A plan for the function lowers its expected error more than a plan for a derivative, and the reverse."""
    axes = {"elevator": 0.06, "aileron": 0.06}
    options = AXES | {
        "axes": list(axes),
        "limits": axes,
        "bands": pd.concat([BANDS, BANDS]).set_axis(list(axes)),
    }
    options |= {"seconds": 14.0, "noise": NOISE.set_axis(["Cl", "Cm"])}
    plans = {goal: plan(model, uav, **options, goal=[goal]) for goal in ("function", "Cm_q")}
    weights = plans["function"].weights["function"]
    errors = pd.DataFrame(
        {asked: errors_of(one.after, {"function": weights}) for asked, one in plans.items()}
    ).loc[["function", "Cm_q"]]
    assert errors.loc["function", "function"] < 0.99 * errors.loc["function", "Cm_q"]
    assert errors.loc["Cm_q", "Cm_q"] < 0.99 * errors.loc["Cm_q", "function"]
    assert plans["function"].errors.loc["function", "after"] == pytest.approx(
        errors.loc["function", "function"]
    )


def test_the_error_of_the_function_is_the_posterior_deviation_over_the_envelope(model, uav):
    weights = _information.goal_weights(["function"], model, uav, [], COEFFICIENTS, None)[
        "function"
    ]
    rows = np.random.default_rng(1).uniform(*model.limits, size=(3000, 8))
    variance = np.stack([features(rows) ** 2 @ ((SPREAD * row) ** 2 + 1e-8) for row in TABLE])
    expected = np.sqrt(np.mean(variance.mean(axis=1) / (features(rows) @ TABLE.T).var(axis=0)))
    known = posterior_information(model, np.zeros(8))
    assert errors_of(known, {"function": weights})["function"] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("k", range(6))
def test_the_error_of_free_flight_is_that_of_a_simulation(model, uav, k):
    """By a coefficient that is off by a constant, after two seconds from the trim."""
    point, off = trim(model, uav, 20.0), np.eye(6)[k] * 1e-4
    table = pd.DataFrame(
        {"time": [0.0, 2.0], **{name: [value] * 2 for name, value in point.controls.items()}}
    )
    ends = [
        simulate(
            Aerodynamics(lambda X, more=more: features(X) @ TABLE.T + more, NAMES),
            uav,
            point,
            table,
            0.02,
        )
        for more in (off, -off)
    ]
    names = ["alpha", "beta", "phi", "theta"]
    moved = (ends[0][names].iloc[-1] - ends[1][names].iloc[-1]) / 2e-4
    found = _information._growth(model, uav, point, "auto")[k]
    assert np.sqrt(found) == pytest.approx(np.sqrt((moved**2).mean()), rel=0.02)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"goal": ["Cm_alpha_dot"]}, "Cm_alpha_dot.*learn a model with that regressor"),
        ({"goal": "function"}, "give a list"),
        ({"axes": ["elevator", "flaps"]}, "flaps"),
        ({"limits": {"aileron": 0.1}}, "aileron"),
        ({"limits": {"elevator": 5.0}}, "rad, not degrees"),
        ({"limits": {"elevator": "a"}}, "Got limits of 'a' for the elevator"),
        ({"pause": [3.0, 4.0]}, "Got pause"),
        ({"airspeeds": "auto"}, "Got airspeeds='auto', but expected numbers > 0"),
        ({"detents": {"elevator": 0.0}}, "Got detents of 0.0 for the elevator"),
        ({"detents": {"elevator": 0.01, "rudder": 0.01}}, "axes to move lack 'rudder'"),
        ({"axes": "elevator"}, "Got axes='elevator', but expected different controls in a list"),
        ({"axes": ["elevator", "elevator"]}, "different controls"),
        ({"seconds": -5.0}, "Got seconds=-5.0, but expected a number > 0"),
        (
            {"n_paths": 10**9},
            "Got n_paths=1000000000, but expected a number of aircraft to draw, 0 to 10000",
        ),
        ({"seconds": 1e9}, "Got seconds=1e[+]09, but expected at most 1800"),
        (
            {"airspeeds": 39.0, "n_paths": 30},
            "by flown airspeed .* fly at 4[.0-9]* to 34[.0-9]* m/s, widen this limit",
        ),
        ({"airspeeds": 4.0}, "no trim .* Flown were 5 to 35 m/s"),
        ({"rate": 1e9}, "at 1e[+]09 Hz, .* rows, but expected at most 1000000"),
        ({"noise": {"Cq": 0.1}}, "coefficients lack 'Cq'"),
        (
            {"goal": ["Cm_beta"]},
            r"manoeuvres of \['elevator'\] within their limits lower its errors by 0.0",
        ),
        ({"seconds": 5.0}, "give more seconds, a shorter pause"),
        ({"rate": 10.0}, "Got a rate of 10 Hz"),
        ({"n_paths": 5}, "at least 18"),
        (
            {"envelope": Envelope(altitude=200.0)},
            "trimmed flight at 20 m/s and 100 m leaves .* by altitude .*--floor",
        ),
        (
            {"seconds": 7.0, "limits": {"elevator": 1.5}},
            "every manoeuvre leaves .* by flown .*--growth",
        ),
        (
            {"information": Information(np.zeros((1, 2, 2)), ("Cm",), ("alpha",))},
            "same regressors and noise",
        ),
    ],
)
def test_what_cannot_be_planned_is_said(model, uav, changed, words):
    options = {"seconds": 20.0, "bands": BANDS} | AXES | changed
    with pytest.raises(ValueError, match=words):
        plan(model, uav, **options)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("limits", 0.05, "Mapping"),
        ("detents", 0.1, "Mapping"),
        ("envelope", {"bank": 1.0}, "Envelope"),
        ("information", 5, "Information"),
    ],
)
def test_options_of_other_types_are_refused(model, uav, name, value, expected):
    with pytest.raises(TypeError, match=f"for {name}, but expected {expected} or None"):
        plan(model, uav, **{"seconds": 20.0, "bands": BANDS} | AXES | {name: value})


@pytest.mark.parametrize(
    "words",
    [
        {"altitude": np.nan}, {"altitude": (100, 200)}, {"bank": "a"}, {"bank": 0.0}, {"alpha": 0.2},
        {"alpha": (1.0, np.nan)}, {"airspeed": (30.0,)}, {"risk": 1.5}, {"risk": 1.0}, {"risk": None}, {"risk": 0.0},
        {"growth": None}, {"growth": -1.0}, {"margin": np.nan},
    ],
)  # fmt: skip
def test_an_envelope_of_no_numbers_is_refused(words):
    with pytest.raises(ValueError, match=f"Got .*{next(iter(words))}"):
        Envelope(**words)


def test_the_throttle_stays_between_0_and_1():
    flown = Aerodynamics(lambda X: 0 * X, ["throttle"], limits=[[0.2], [0.95]])
    assert Envelope(growth=1.0).bounds(flown)["growth of throttle"] == (0.0, 1.0)


def test_little_that_each_of_many_manoeuvres_teaches_is_planned(planned, model, uav):
    """Where much is known."""
    known = planned[0].after
    for _ in range(10):
        known = known + known
    options = AXES | {
        "information": known,
        "bands": BANDS,
        "goal": ["Cm_alpha", "Cm_q"],
        "seconds": 60.0,
    }
    found = plan(model, uav, **options).manoeuvres
    assert len(found) > 5
    assert found["gain"].max() < 0.002 < found["gain"].sum()


@pytest.mark.parametrize(
    ("axis", "goal", "channel", "flown", "given"),
    [
        ("elevator", "Cm_elevator", "az", (-12.5, -7.0), {"load_factor": (-9.0, 9.0)}),
        ("aileron", "Cl_aileron", "phi", (-0.3, 0.2), {"bank": 3.0}),
    ],
)
def test_without_options_a_plan_stays_in_what_was_flown(
    model, uav, monkeypatch, axis, goal, channel, flown, given
):
    monkeypatch.setattr(_library, "WIDTHS", (2.5,))
    narrow = copy(model)
    narrow.flown = FLOWN | {channel: flown}
    options = AXES | {"axes": [axis], "limits": {axis: 0.09}, "bands": BANDS.set_axis([axis])}
    options |= {"noise": NOISE.set_axis(["Cl", "Cm"])}
    inside = []
    for words in ({}, given):
        found = plan(narrow, uav, **options, seconds=8.0, goal=[goal], envelope=Envelope(**words))
        assert found.trims[0].altitude == 100.0  # the highest
        table = found.trains[0].table(50.0, trim=found.trims[0].controls, pause=3.0)
        values = simulate(narrow, uav, found.trims[0], table, 0.04)[channel]
        inside.append(
            values.between(flown[0] - 0.1 * np.ptp(flown), flown[1] + 0.1 * np.ptp(flown)).all()
        )
    assert inside == [True, False]


def test_a_model_that_does_not_know_what_was_flown_says_so(model, uav):
    """Such as one of flights without these columns, or with a constant in one."""
    old = copy(model)
    old.flown = {}
    words = r"range of load_factor, bank, airspeed, altitude, .* --max-bank, --speeds"
    with pytest.warns(UserWarning, match=words), pytest.raises(ValueError, match="Got the goal"):
        plan(old, uav, **AXES | {"seconds": 8.0, "goal": []})
    old.flown = FLOWN | {"altitude": (100.0, 100.0)}
    assert Envelope().unlimited(old) == ["altitude"]
    assert not Envelope(altitude=0.0).unlimited(old)
    assert not Envelope(growth=np.inf).unlimited(old)


def test_limits_are_what_was_flown(model, uav):
    options = AXES | {"limits": None, "seconds": 7.0, "bands": BANDS, "goal": ["Cm_elevator"]}
    found = plan(model, uav, **options)
    elevator = found.trims[0].controls["elevator"]
    assert found.trains[0].limits["elevator"].amplitude == pytest.approx(0.3 - abs(elevator))
    with (
        pytest.warns(UserWarning, match="risks are those without gusts"),
        pytest.raises(ValueError, match="no trim"),
    ):
        plan(model, uav, **options | {"gusts": "auto", "airspeeds": 1.0})
    with pytest.raises(ValueError, match="does not say what was flown"):
        plan(Aerodynamics(model.function, NAMES), uav, **options)
    with pytest.raises(ValueError, match="'function', but the model does not say what was flown"):
        plan(
            Aerodynamics(model.function, NAMES),
            uav,
            **AXES | {"goal": ["function"], "seconds": 7.0},
        )
    still = Aerodynamics(model.function, NAMES, limits=model.limits * [1, 0, 1, 1, 1, 1, 1, 1])
    with pytest.raises(
        ValueError, match=r"Cm_beta.*beta did not move in the flights .* knows nothing"
    ):
        plan(still, uav, **options | {"goal": ["Cm_beta"]})


def test_pitch_rate_is_told_from_alpha_dot_in_a_turn(uav, monkeypatch):
    """In level flight the two differ by the slow turn of the flight path alone; here the bank angle changes."""
    monkeypatch.setattr(_library, "WIDTHS", (2.5,))
    table = np.column_stack([TABLE, [0, 0, 0, 0, -3, 0]])
    model = Aerodynamics(lambda X: features(X) @ table.T, [*NAMES, "alpha_dot_hat"])
    axes = {"elevator": 0.12, "aileron": 0.12}
    options = AXES | {
        "axes": list(axes),
        "limits": axes,
        "bands": pd.concat([BANDS, BANDS]).set_axis(list(axes)),
    }
    found = plan(model, uav, **options, seconds=20.0, goal=["Cm_q", "Cm_alpha_dot"], banks=(1.0,))
    assert abs(found.after.correlation("Cm").loc["q_hat", "alpha_dot_hat"]) < 0.7
    assert {"alpha_dot_hat", "q_hat"} not in [
        set(pair) for pair in found.confounded[["first", "second"]].to_numpy()
    ]
