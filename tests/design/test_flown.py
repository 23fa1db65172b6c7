"""A plan beside the flight: what is recognised, what it taught, and what cannot be compared."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lsim

from skdgp import design
from skdgp.design import (
    Information,
    _flown,
    _library,
    doublet,
    expected_information,
    posterior_information,
    three_two_one_one,
)
from skdgp.design._envelope import QUANTITIES
from skdgp.design._information import errors_of
from skdgp.design._plan import read_plan, record_of
from skdgp.dynamics import Aerodynamics, Aircraft

STEP = 0.04
REGRESSORS = ("alpha", "elevator")
NOISE = pd.DataFrame({"white": 0.002, "drift": 0.001, "memory": 0.5}, index=["CZ", "Cm"])
SIGNALS = {
    "doublet": {"elevator": doublet(0.6, 0.05)},
    "3-2-1-1": {"rudder": three_two_one_one(0.4, 0.1)},
}
BEFORE = Information(np.stack([np.diag([1e4, 100.0, 400.0])]), ("Cm",), REGRESSORS)


def compare_with_plan(plan, *flown):
    return _flown.compare_with_plan(record_of(plan), *flown)


@pytest.fixture
def plan(uav):
    """Return a plan of two doublets and a 3-2-1-1, as its file holds it."""
    rows = []
    for name in ("doublet", "3-2-1-1", "doublet"):
        inputs = SIGNALS[name]
        duration = max(signal.duration for signal in inputs.values())
        sampled = {
            axis: signal(np.arange(0, duration + STEP, STEP)).tolist()
            for axis, signal in inputs.items()
        }
        expected = {quantity: {"low": -0.2, "high": 0.3} for quantity in QUANTITIES}
        rows.append(
            {
                "name": name,
                "duration": duration,
                "pause": 2.0,
                "inputs": sampled,
                "expected": expected,
            }
        )
    return {
        "aircraft": uav.to_dict(), "at": dict.fromkeys(REGRESSORS, 0.0), "manoeuvres": rows,
        "step": STEP, "curvature": False, "weights": {},
        "limits": {"alpha": {"low": None, "high": 0.25}}
        | {name: {"low": -0.5, "high": 0.5} for name in ("growth of elevator", "growth of bank")},
        "errors": {"Cm_elevator": {"before": 0.05, "after": 0.02}},
        "known": {name: np.asarray(value).tolist() for name, value in vars(BEFORE).items()},
    }  # fmt: skip


def flown(events, rate=50.0, seconds=40.0):
    """Return a flight with some of the signals at their times and sizes, about trims that are not zero."""
    time = np.arange(0.0, seconds, 1 / rate)
    table = pd.DataFrame({"time": time, "flight": "a", "elevator": -0.03, "rudder": 0.01})
    for name, start, size in events:
        for axis, signal in SIGNALS[name].items():
            table[axis] += size * signal(time - start)
    noise = 5e-4 * np.random.default_rng(0).standard_normal((len(time), 2))
    table[["elevator", "rudder"]] += noise
    alpha = (
        0.08
        + 0.01 * np.sin(0.7 * time)
        + np.convolve(table["elevator"] + 0.03, np.ones(25) / 25, "same")
    )
    return table.assign(alpha=alpha, beta=0.0, airspeed=20.0, altitude=100.0, az=-9.81, phi=0.0)


def test_manoeuvres_are_found_where_they_were_flown(plan, uav):
    events = [("3-2-1-1", 5.013, 0.8), ("doublet", 20.0, 1.0)]
    found = compare_with_plan(plan, flown(events), uav, NOISE, BEFORE)
    rows = found.manoeuvres
    assert rows["name"].tolist() == ["3-2-1-1", "doublet"]
    np.testing.assert_allclose(rows["start"], [5.013, 20.0], atol=STEP)
    np.testing.assert_allclose(rows["size"], [0.8, 1.0], atol=0.06)
    assert (rows["likeness"] > 0.95).all()
    assert found.missed == {"doublet": 1}
    assert rows["alpha_high"].iloc[1] == pytest.approx(
        flown(events).query("20 <= time <= 23.2")["alpha"].max(), abs=2e-3
    )
    assert (rows["left"] == "").all()


def test_what_was_found_is_the_information_of_what_was_flown(plan, uav):
    """The rows of the manoeuvre and of the pause after it, 25 a second, add to what was known."""
    flight = flown([("doublet", 20.0, 1.0)])
    found = compare_with_plan(plan, flight, uav, NOISE, BEFORE)
    part = flight.query("20 <= time <= 23.2").iloc[::2]
    after = BEFORE + expected_information(part, uav, REGRESSORS, NOISE.loc[["Cm"]])
    row = found.errors.loc["Cm_elevator"]
    assert row["found"] == pytest.approx(after.std.loc["Cm", "elevator"], rel=0.05)
    assert row["model"] == pytest.approx(0.05, rel=1e-6)  # 1 / sqrt(400)
    assert row["expected"] == 0.02
    assert found.remaining["model"] == pytest.approx(1.0)


def test_limits_that_were_left_are_named(plan, uav):
    """The first leaves limits of its response in the pause after it, the second one of its regressors."""
    flight = flown([("doublet", 20.0, 1.0), ("doublet", 30.0, 1.0)])
    flight.loc[flight["time"].between(22, 22.2), ["alpha", "phi"]] = 0.3, 0.6
    flight.loc[flight["time"].between(32, 32.1), "elevator"] = 0.6
    left = compare_with_plan(plan, flight, uav, NOISE, BEFORE).manoeuvres["left"]
    assert left.tolist() == ["alpha, growth of bank", "growth of elevator"]


FAST = {
    "doublet of 0.05 s": {"elevator": doublet(0.05, 0.1)},
    "doublet of 0.10 s": {"elevator": doublet(0.10, 0.1)},
    "3-2-1-1 of 0.10 s": {"rudder": three_two_one_one(0.10, 0.1)},
    "tones to 8 Hz": dict(
        design.orthogonal_multisines(
            dict.fromkeys(["elevator", "rudder"], 0.1), 10.0, (0.1, 8.0), n_tones=8, n_starts=1
        )
    ),
}


@pytest.mark.parametrize("late", [0.0, 0.0031, 0.0067, 0.013, 0.02])
@pytest.mark.parametrize("name", FAST)
def test_fast_manoeuvres_are_recognised_wherever_they_begin(plan, uav, name, late):
    """Of a plan with the steps that a plan of this manoeuvre has, flown exactly."""
    inputs = FAST[name]
    record, flight = made(plan, uav, name, inputs), still()
    for axis, signal in inputs.items():
        flight[axis] += signal(flight["time"].to_numpy() - 20.0 - late)
    (found,) = compare_with_plan(record, flight, uav, NOISE, BEFORE).manoeuvres.to_dict("records")
    assert found["likeness"] > 0.95
    assert found["size"] == pytest.approx(1.0, abs=0.1)
    assert found["start"] == pytest.approx(20.0 + late, abs=0.01)


@pytest.mark.parametrize(("width", "lag"), [(0.16, 0.1), (0.1, 0.1), (0.3, 0.2)])
def test_what_a_slow_servo_flew_is_recognised(plan, uav, width, lag):
    inputs = {"elevator": design.doublet(width, 0.1)}
    record, flight = (
        made(plan, uav, "doublet", inputs, {"elevator": design.Limits(0.2, lag=lag)}),
        still(),
    )
    time = flight["time"].to_numpy()
    flight["elevator"] += lsim(([1.0], [lag, 1.0]), inputs["elevator"](time - 20.0), time)[1]
    (found,) = compare_with_plan(record, flight, uav, NOISE, BEFORE).manoeuvres.to_dict("records")
    assert found["likeness"] > 0.95
    assert found["size"] == pytest.approx(1.0, abs=0.1)


def test_rows_without_a_value_in_a_manoeuvre_teach_nothing(plan, uav):
    flight = flown([("doublet", 20.0, 1.0)])
    lost = flight["time"].between(20.3, 20.36)
    found = compare_with_plan(
        plan, flight.assign(elevator=flight["elevator"].mask(lost)), uav, NOISE, BEFORE
    )
    assert found.manoeuvres["name"].tolist() == ["doublet"]
    assert found.errors["found"].iloc[0] == pytest.approx(
        compare_with_plan(plan, flight, uav, NOISE, BEFORE).errors["found"].iloc[0], rel=0.05
    )


def still():
    """Return trimmed flight."""
    return pd.DataFrame({"time": np.arange(0.0, 40.0, 0.01), "flight": "a", "alpha": 0.05, "beta": 0.0,
                         "airspeed": 20.0, "altitude": 100.0, "az": -9.81, "phi": 0.0, "elevator": -0.03,
                         "rudder": 0.01})  # fmt: skip


def made(plan, uav, name, inputs, limits=None):
    """Return the record of a plan of one manoeuvre."""
    duration = max(signal.duration for signal in inputs.values())
    train = design.Wavetrain({axis: {1.0: signal} for axis, signal in inputs.items()}, limits or {})
    row = plan["manoeuvres"][0] | {"name": name, "duration": duration}
    table = pd.DataFrame(
        [
            {"train": 0, "start": 1.0, "risk": np.nan}
            | {key: row[key] for key in ("name", "duration", "pause")}
        ]
    )
    flight = flown([]).assign(flight=0)
    one = design.Plan(
        (train,), (), ("Cm_elevator",), BEFORE, BEFORE, table, flight, (), pd.DataFrame(), uav, {}
    )
    return plan | {key: one.to_dict()[key] for key in ("step", "manoeuvres")}


def test_what_cannot_be_compared_is_said(plan, uav, tmp_path):
    flight = flown([("doublet", 20.0, 1.0)])
    other = Aircraft(
        mass=12, inertia=uav.inertia, wing_area=1.3, span=3.0, chord=0.55, name="other"
    )
    with pytest.raises(
        ValueError, match=r"with a span of 2\.6, but the model is of 'other' with 3"
    ):
        compare_with_plan(plan, flight, other, NOISE, BEFORE)
    with pytest.raises(ValueError, match="judge a model with the regressors"):
        compare_with_plan(
            plan, flight, uav, NOISE, Information(np.eye(2)[None], ("Cm",), ("alpha",))
        )
    with pytest.raises(ValueError, match="rudder"):
        compare_with_plan(plan, flight.drop(columns="rudder"), uav, NOISE, BEFORE)
    with pytest.raises(FileNotFoundError, match="as the plan, but there is no such file"):
        read_plan(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("events", "words"),
    [
        (
            [],
            r"but expected at least 0\.85 and 0\.5 to 2 times\. Give the flights that flew this "
            r"plan",
        ),
        (
            [("3-2-1-1", 20.0, 0.4)],
            r"'3-2-1-1' at 20\.00 s of flight 'a', .* of 1\.00 and 0\.4 times its size.* Check "
            r"the units",
        ),
        (
            [("3-2-1-1", 20.0, 57.3)],
            r"a correlation of 1\.00 and 57 times its size.* Check the units of the deflections "
            r"\(rad\)",
        ),
        (
            [("3-2-1-1", 20.0, -1.0)],
            r"a correlation of -1\.00 and 1 times .* opposite sign: check the signs",
        ),
    ],
)
def test_a_flight_without_a_manoeuvre_of_the_plan_says_what_is_nearest(plan, uav, events, words):
    with pytest.raises(ValueError, match=f"without a manoeuvre of the plan: nearest is .*{words}"):
        compare_with_plan(plan, flown(events), uav, NOISE, BEFORE)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ((), {}), ((), None), ((), [1]),
        (("known",), {}), (("known", "fisher"), [[1.0]]), (("known", "fisher"), None),
        (("manoeuvres",), []), (("manoeuvres",), {}), (("manoeuvres", 1, "inputs"), {}),
        (("manoeuvres", 1, "inputs", "rudder"), []), (("manoeuvres", 1, "inputs", "rudder"), [0.1, None]),
        (("manoeuvres", 0, "duration"), None), (("manoeuvres", 0, "expected"), {}), (("manoeuvres", 0, "name"), None),
        (("at",), {}), (("errors",), {}), (("errors", "Cm_elevator"), {}),
        (("errors",), {"Cn_p": {"before": 1, "after": 1}}), (("limits", "alpha"), {}),
        (("aircraft", "span"), None), (("step",), 0.0),
    ],
)  # fmt: skip
def test_a_damaged_plan_is_refused_with_what_is_damaged(plan, tmp_path, where, value):
    whole = {"plan": plan}
    *path, last = "plan", *where
    holder = whole
    for name in path:
        holder = holder[name]
    holder[last] = value
    (tmp_path / "plan.json").write_text(json.dumps(whole["plan"]))
    damaged = rf"whose '{where[0]}' is missing" if where else "which is none"
    with pytest.raises(ValueError, match=rf"{damaged}.*expected the plan.json that skdgp plan"):
        read_plan(tmp_path / "plan.json")


@pytest.mark.parametrize(
    "words",
    ["no plan", 100_000 * "[" + 100_000 * "]", 100_000 * '{"known": ' + "0" + 100_000 * "}"],
)
def test_a_file_that_is_no_plan_is_refused(tmp_path, words):
    (tmp_path / "plan.json").write_text(words)
    with pytest.raises(ValueError, match=r"expected the plan.json that skdgp plan writes"):
        read_plan(tmp_path / "plan.json")


def test_a_model_knows_what_its_plan_says_was_known_though_one_airspeed_is_flown_more(
    uav, monkeypatch
):
    """Its slopes are known the less well the larger the angle of attack."""
    monkeypatch.setattr(_library, "MULTISINES", ())  # for time

    def mean(X):
        alpha, q, elevator = np.moveaxis(X, -1, 0)
        lift, zero = 0.3 + 4.5 * alpha, 0 * q
        drag = 0.03 + 0.06 * lift**2 - lift * alpha
        return np.stack(
            [-drag, zero, -lift, zero, 0.02 - 0.6 * alpha - 9 * q - elevator, zero], axis=-1
        )

    def covariance(X):
        features = np.column_stack([np.ones(len(X)), X, 5 * X**2])
        return np.kron(np.eye(6), 0.01 * features @ features.T)

    model = Aerodynamics(
        mean, ["alpha", "q_hat", "elevator"], sampler=lambda *_: (mean, None), covariance=covariance,
        limits=[[-0.1, -0.1, -0.3], [0.3, 0.1, 0.3]],
    )  # fmt: skip
    plan = design.plan(
        model, uav, airspeeds=[18.0, 27.0], seconds=20.0, axes=["elevator"], goal=["Cm_alpha", "Cm_elevator"],
        limits={"elevator": 0.04}, known=design.Known(noise=NOISE),
        envelope=design.Envelope(growth=np.inf, gusts=None, n_paths=18),
    )  # fmt: skip
    assert plan.manoeuvres["airspeed"].value_counts().reindex([18.0, 27.0], fill_value=0).std() > 0
    said = posterior_information(model, read_plan(plan).at, plan.before.coefficients)
    np.testing.assert_allclose(errors_of(said)[[*plan.goal]], plan.errors["before"], rtol=1e-9)
