"""The verdict: what it says follows from errors, bands, derivatives and simulations by its thresholds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS, WIND
from made_flights import LINEAR_GLIDER, rms
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from sklearn.utils import Bunch

from skdgp._flight.findings import Code, Finding
from skdgp._regressor import FitCode, search_ended
from skdgp.dynamics import (
    Air,
    Turbulence,
    dryden_gusts,
    simulate,
    trim,
)
from skdgp.identification import (
    Evaluation,
    FlightMechanics,
    Identification,
)

AIRCRAFT = LINEAR_GLIDER.aircraft
SETTINGS = {"thrust": None, "horizon": 4.0}
FIT = Bunch(
    regressors=LINEAR_GLIDER.names,
    noise_std=dict.fromkeys(COEFFICIENTS, 0.01),
    doubts=[],
    reconstruction=None,
    lags_corrected={},
    summary="",
    samples=1000,
    flown=100.0,
    conditions={},
)


def glider(elevator=-1.0):
    """Return a glider of which the effect of the elevator on the pitching moment is chosen."""
    slopes = LINEAR_GLIDER.slopes.copy()
    slopes[4, 5] = elevator
    return LINEAR_GLIDER.model(slopes, has_paths=False)


def slow(time):
    """Return a slow motion of the aileron [rad]."""
    return 0.02 * np.sin(time)


def glide(seconds=24.0, aileron=slow, **air):
    """Return a glide of the true glider with doublets of the elevator, its measured states without noise."""
    steady = trim(glider(), AIRCRAFT, 20.0, climb=None, thrust=None)
    time = np.arange(0, seconds, 0.05)
    controls = pd.DataFrame({"time": time, **steady.controls})
    controls["elevator"] += 0.03 * np.sign(np.sin(1.5 * time))
    controls["aileron"] += aileron(time)
    flown = simulate(glider(), AIRCRAFT, steady, controls, dt=0.05, thrust=None, **air)
    return flown.drop(columns=["ended", "beyond", "flight"], errors="ignore").assign(density=1.225)


@pytest.fixture(scope="module")
def flight():
    return glide()


def evaluation(name="a", error=0.1, linear=0.2, inside=True, n=2000):
    """Return a flight whose errors are these parts of the spread, exactly."""
    measured, noise = default_rng(0).normal(size=(2, n, 6))
    measured = (measured - measured.mean(axis=0)) / measured.std(axis=0)
    noise /= rms(noise)
    error = np.broadcast_to(error, 6)
    time = 0.05 * np.arange(n)
    prediction_std = error * np.broadcast_to(np.where(inside, 1.0, 0.5), (n, 6))
    return Evaluation(
        name=name,
        measured=measured,
        mean=measured + error * noise,
        baseline=measured + linear * noise,
        std=np.sqrt(prediction_std**2 - 0.01**2),  # of the function; the noise is small
        prediction_std=prediction_std,
        table=pd.DataFrame({"time": time, "alpha": 0.0, "beta": 0.0}),
        states=pd.DataFrame({"time": time}),
        regressors=measured,
    )


def mechanics(**changes):
    found = {
        "trim": trim(glider(), AIRCRAFT, 20.0, climb=None, thrust=None),
        "derivatives": pd.DataFrame(
            {"value": [-1.0, 0.1, -0.06], "std": [0.1, 0.01, 0.01]}, index=CONTROLS
        ),
        "simulation": simulated([4.0, 4.0]),
    }
    return FlightMechanics(**found | changes)


NO_ALPHA = Finding(Code.NOT_SIMULATED, error="no alpha")
NO_DERIVATIVES = Finding(Code.NO_DERIVATIVES, error="left out")
NO_TRIM = Finding(Code.NO_TRIM, airspeed=20.0)
ALONE = {
    name: Finding(Code.ROWS_LEFT_OUT, flight=name, left_out=2, rows=9, alone=2) for name in "ab"
}
CONTROLS = ["Cm_elevator", "Cl_aileron", "Cn_rudder"]
PREDICT = "predict coefficients"
SIMULATE = "simulate"
CONTROL = "design a controller"
PURPOSES = (PREDICT, SIMULATE, CONTROL)


def simulated(lasts):
    return pd.DataFrame({"lasts": lasts, "wind_known": True, "horizon": 4.0}, index=["theta", "p"])


def identification(
    train, evaluations, *, model=None, aircraft=AIRCRAFT, findings=(), fit=FIT, **settings
):
    """Return the result of an identification of a model, by default the true glider."""
    return Identification(
        pipeline=model or glider(),
        aircraft=aircraft,
        options=SETTINGS | settings,
        fit=fit,
        train=dict(enumerate(train)),
        evaluations=evaluations,
        findings=tuple(findings),
    )


def verdict(evaluations=None, findings=(), fit=None, **parts):
    """Return the verdict on evaluations, mechanics and the record of a fit of three flights."""
    evaluations = evaluations or [evaluation()]
    train = 3 * [evaluations[0].table]
    result = identification(train, evaluations, findings=findings, fit=Bunch(**FIT | (fit or {})))
    vars(result)["mechanics"] = mechanics(**parts)
    return result.verdict


def with_derivative(name, value, std=0.01, **parts):
    """Return the derivatives by the controls, and another one."""
    added = pd.DataFrame({"value": value, "std": std, **parts}, index=[name])
    return pd.concat([mechanics().derivatives, added])


def use(found, purpose):
    (one,) = [one for one in found.uses if one.purpose == purpose]
    return one.judgement, {finding.code.name for finding in one.findings}


def mechanics_of(*tables, train=None, **options):
    """Return the mechanics of a model that flies like these tables, or not."""
    tested = [replace(evaluation(n=2), table=table, states=table) for table in tables]
    conditions = (tables[0] if train is None else train).median(numeric_only=True)
    fit = Bunch(**FIT | {"conditions": conditions.to_dict()})
    return identification(tables, tested, fit=fit, **options).mechanics


def errors_of(*tables, elevator=-1.0):
    """Return how a simulation by a glider follows the tables."""
    return mechanics_of(*tables, model=glider(elevator)).simulation


def test_one_error_and_one_coverage():
    found = verdict([evaluation(error=0.1), evaluation("b", error=0.3)])
    assert_allclose(found.error, rms([0.1, 0.3]))
    assert_allclose(found.coverage, 0.95, rtol=0, atol=0.01)


def test_least_squares_that_is_better_is_a_warning():
    linear = [0.2, 0.2, 0.101, 0.1, 0.05, 0.05]
    assert verdict([evaluation(error=0.1, linear=linear)]).findings == ()
    (better,) = verdict([evaluation(error=0.3, linear=linear)]).findings
    assert better.code is Code.LEAST_SQUARES_BETTER
    assert better.numbers["names"] == [*COEFFICIENTS]
    (better,) = verdict([evaluation(error=0.1, linear=[0.05, 0.05, 0.05, 0.4, 0.4, 0.4])]).findings
    assert better.numbers["names"] == [*COEFFICIENTS[:3]]


@pytest.mark.parametrize(
    ("flown", "samples", "fit"),
    [(60.0, 1000, "yes"), (29.0, 1000, "unknown"), (60.0, 79, "unknown")],
)
def test_little_flown_or_few_rows_leave_it_open(flown, samples, fit):
    uses = verdict(fit={"flown": flown, "samples": samples}).uses
    assert {use.judgement for use in uses} == {fit}


class TestSimulation:
    def test_the_true_aircraft_follows_and_another_does_not(self, flight):
        true = errors_of(flight)
        assert (true["lasts"] == true["horizon"]).all()
        assert_allclose(true["horizon"].iloc[0], 4.0, rtol=0.06)
        assert_allclose(true.loc["theta", "spread"], flight["theta"].std(), rtol=0.01)
        wrong = errors_of(flight, elevator=-0.2)
        assert wrong.loc["q", "lasts"] < 2
        assert (wrong["error"] >= true["error"]).all()

    def test_the_true_aircraft_follows_in_gusts_where_their_wind_is_known(self):
        size = Turbulence.low_altitude(100.0, wind_at_6m=8.0)
        size = ([size.length], [size.intensity], 2.0)
        gusts = dryden_gusts(2101, 0.02, 20.0, *size, default_rng(0)).velocity[:, 0]
        wind = pd.DataFrame(gusts, columns=WIND).assign(time=0.02 * np.arange(len(gusts)))
        gusty = glide(40.0, air=Air(wind, gusts=None))
        still = errors_of(gusty.drop(columns=WIND))
        known = errors_of(gusty)
        assert still["lasts"].min() < 1
        assert not still["wind_known"].any()
        assert known["wind_known"].all()
        assert (known["lasts"] >= 4 * still["lasts"].min()).all()
        turns = gusty.assign(psi=gusty["psi"] + 4 * np.pi)  # after two turns of heading
        assert_frame_equal(errors_of(turns), known, rtol=1e-6)

    def test_gaps_are_not_flown_through(self, flight):
        broken = flight.assign(time=flight["time"] + 100.0 * (flight["time"] > 12))
        found = errors_of(broken)
        assert (found["lasts"] == found["horizon"]).all()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda table: table.drop(columns="alpha"), "the flights lack alpha"),
            (lambda table: table.assign(theta=np.nan), "no part of"),
        ],
    )
    def test_says_what_it_cannot_fly(self, flight, change, message):
        found = mechanics_of(change(flight), train=flight)
        assert found.simulation is None
        assert message in found.notes[-1].numbers["error"]

    def test_the_true_aircraft_follows_from_starts_within_fast_rolls(self):
        """Doublets of 0.4 s, in whose middle the simulations start."""

        def doublet(time):
            phase = (time + 0.1) % 4
            return np.where(phase < 0.4, 0.2 * np.sign(0.2 - phase), 0.0)

        found = errors_of(glide(aileron=doublet)).loc[["phi", "p"]]
        assert (found["lasts"] == found["horizon"]).all()

    def test_flights_too_short_to_show_their_noise_do_not_narrow_the_limit(self, flight):
        noise = default_rng(0).normal(0, 0.05, len(flight))
        noisy = flight.assign(q=flight["q"] + noise)
        found = errors_of(noisy, noisy[:8], noisy[8:16].reset_index(drop=True)).loc["q", "limit"]
        assert_allclose(found, errors_of(noisy).loc["q", "limit"])
        assert_allclose(found, 3 * 0.05, rtol=0.2)


def still(flight, *outputs):
    """Return a flight in which outputs vary by a thousandth of their noise, and the model errs by as much as that."""
    noise = 0.1
    spread = np.where(np.isin(np.arange(6), outputs), 1e-3 * noise, 1.0)
    std = np.sqrt(flight.prediction_std**2 + noise**2)
    measured = spread * flight.measured
    mean = measured + flight.mean - flight.measured
    return replace(flight, measured=measured, mean=mean, prediction_std=std)


class TestCoefficientsThatDoNotVary:
    def test_one_is_left_out_of_the_error(self):
        found = verdict([still(evaluation(), 5)])
        assert_allclose(found.error, verdict().error)
        assert use(found, PREDICT) == ("partly", {"NOT_VARYING"})
        assert "without Cn" in found.compared()
        (not_varying,) = [one for one in found.findings if one.code is Code.NOT_VARYING]
        assert not_varying.numbers["names"] == ["Cn"]

    def test_of_none_there_is_no_error(self):
        found = verdict([still(evaluation(), *range(6))])
        assert np.isnan(found.error)
        assert use(found, PREDICT)[0] == "unknown"
        assert [one.code for one in found.findings] == [Code.BANDS_TOO_WIDE, Code.NOT_VARYING]


def test_where_the_air_was_estimated_wrongly_nothing_is_even_partly_of_use():
    cause = Finding(Code.AIR_NOT_CONVERGED)
    doubt = Finding(Code.GUSTS_UNKNOWN, cause=cause)
    found = verdict([evaluation(error=[0.1, 0.1, 0.1, 0.1, 0.1, 0.7])], findings=[doubt])
    assert {use.judgement for use in found.uses} == {"no"}
    told = " ".join([*found.warnings, *(use.reason for use in found.uses)])
    assert told.count(cause.clause) == 1 + len(found.uses)


def test_contradictions_of_several_channels_are_told_first_and_each():
    numbers = {
        "y": "p", "x": "q", "slope": -1.0, "std": 0.1, "expected": "1", "t": 20.0, "correlation": 0.9,
        "effective_samples": 100.0,
    }  # fmt: skip
    contradictions = [
        Finding(Code.CONTRADICTION, channels=[name], **numbers) for name in ("p", "elevator")
    ]
    copied = Finding(Code.ALREADY_LEARNED, flight="monday")
    found = verdict(findings=[copied, *contradictions])
    assert found.findings == (*contradictions, copied)
    for purpose in PURPOSES:
        assert use(found, purpose) == ("partly", {"CONTRADICTION"})
    assert [text.split()[0] for text in found.warnings[:2]] == ["p", "elevator"]


def test_bands_that_hold_everything_are_too_wide():
    flight = evaluation(error=0.1)
    found = verdict([replace(flight, prediction_std=3 * flight.prediction_std)]).findings[0]
    assert found.code is Code.BANDS_TOO_WIDE
    assert found.numbers["coverages"]["CX"] == 1.0


def test_a_copy_of_a_training_flight_judges_no_use():
    copied = Finding(Code.TESTED_ON_COPY, flight="b", other="a")
    found = verdict(findings=[copied])
    for purpose in PURPOSES:
        assert use(found, purpose) == ("unknown", {"TESTED_ON_COPY"})


@pytest.mark.parametrize("where", ["fit", "test"])
def test_with_gusts_that_are_not_known_nothing_is_yes(where):
    doubt = Finding(Code.GUSTS_UNKNOWN, cause=Finding(Code.AIR_NOT_ESTIMATED, error="too short."))
    found = verdict(fit={"doubts": [doubt]}) if where == "fit" else verdict(findings=[doubt])
    assert found.findings == (doubt,)
    assert found.warnings == ("Gusts without vanes are not known: too short.",)
    for purpose, judgement in {PREDICT: "partly", SIMULATE: "partly", CONTROL: "no"}.items():
        assert use(found, purpose) == (judgement, {"GUSTS_UNKNOWN"})


AX = {"regressors": ["alpha", "ax"]}
BIASED = still(evaluation(), 5)
BIASED = replace(BIASED, mean=np.add(BIASED.mean, [0, 0, 0, 0, 0, 1.0]))
SHORT = simulated([4.0, 0.5])
WIDE = pd.DataFrame(
    {"value": -1.0, "std": 0.5, "std_errors": 0.49, "std_posterior": 0.1},
    index=["Cm_elevator"],
)
ANGLES = pd.DataFrame({"value": -4.5, "std": 0.1}, index=["CZ_alpha"])


def errors(*last):
    """Return an evaluation of errors of 0.1 but for the last coefficients."""
    return evaluation(error=[0.1] * (6 - len(last)) + [*last])


def modes(name):
    frequencies = {"frequency": [5.0, 0.2], "frequency_std": [2.0, 1.0]}
    return {"modes": pd.DataFrame(frequencies, index=[name, "phugoid"])}


BLIND = replace(errors(0.7), table=errors().table[["time"]])
HIDDEN = SHORT.assign(wind_known=False)
LITTLE = {"flown": 5.0}
SLOW = Finding(Code.SLOW_LOG, rate=4.0)
DIVERGED = Finding(Code.PATHS_NOT_CONVERGED, flights=["a"])
BEYOND = replace(mechanics().trim, beyond={"alpha": (0.3, 0.0, 0.2)})
RATES = {"regressors": ["p_hat", "elevator"]}
USES = [
    (PREDICT, {}, "yes", "ERRORS_SMALL"),
    (PREDICT, {"evaluations": [errors(0.49, 0.1, 0.51)]}, "partly", "ERRORS_TOO_LARGE"),
    (PREDICT, {"evaluations": [evaluation(inside=[False] + [True] * 5)]}, "partly", "ERRORS_TOO_LARGE"),
    # its band does not hold, though Cn does not vary
    (PREDICT, {"evaluations": [BIASED]}, "no", "DIVERGING"),
    (PREDICT, {"evaluations": [evaluation(error=1.5)]}, "no", "DIVERGING"),
    (PREDICT, {"evaluations": [errors(187.3)]}, "no", "DIVERGING"),
    (PREDICT, {"evaluations": [evaluation(error=0.6)]}, "no", "ALL_ERRORS_TOO_LARGE"),
    # without vanes alpha and beta follow from the accelerometers that give CZ and CY
    (PREDICT, {"evaluations": [BLIND]}, "partly", "BY_CONSTRUCTION ERRORS_TOO_LARGE"),
    (PREDICT, {"evaluations": [BLIND], "fit": RATES}, "partly", "ERRORS_TOO_LARGE"),
    (SIMULATE, {}, "yes", "FOLLOWS"),
    (SIMULATE, {"simulation": simulated([2.5, 4.0])}, "partly", "FOLLOWS_SHORTLY"),
    (SIMULATE, {"simulation": SHORT}, "no", "FOLLOWS_TOO_SHORTLY"),
    (SIMULATE, {"simulation": HIDDEN}, "unknown", "GUSTS_HIDE_ERRORS"),
    (SIMULATE, {"simulation": None, "notes": (NO_ALPHA,)}, "unknown", "NOT_SIMULATED"),
    (SIMULATE, {"simulation": None}, "unknown", ""),
    (SIMULATE, {"fit": AX}, "no", "ACCELERATIONS_AS_REGRESSORS"),
    (CONTROL, {}, "yes", "CONTROLS_KNOWN"),
    (CONTROL, {"derivatives": WIDE}, "no", "CONTROLS_TOO_UNCERTAIN"),
    *[(CONTROL, {"derivatives": with_derivative(name, value)}, "no", "WRONG_SIGNS")
      for name, value in (("Cm_q", 7.5), ("Cl_p", 0.1), ("Cn_beta", -0.1))],
    *[(CONTROL, {"derivatives": with_derivative(name, value)}, "yes", "CONTROLS_KNOWN")
      for name, value in (("Cm_q", -7.5), ("Cl_p", -0.1), ("Cn_beta", 0.1), ("CY_rudder", 0.1))],
    # a wrong sign that the band does not exclude
    (CONTROL, {"derivatives": with_derivative("CY_beta", 0.1, 0.2)}, "no", "SIGNS_UNKNOWN"),
    *[(CONTROL, modes(name), "no", "CONTROLS_TOO_UNCERTAIN")
      for name in ("Dutch roll 1", "short period 2", "roll-spiral")],
    (CONTROL, {"derivatives": pd.DataFrame(), "notes": (NO_DERIVATIVES,)}, "no", "NO_DERIVATIVES"),
    (CONTROL, {"derivatives": ANGLES}, "no", "CONTROLS_MISSING"),
    (CONTROL, {"evaluations": [errors(0.6, 0.1)]}, "partly", "MOMENTS_UNEXPLAINED"),
    (CONTROL, {"evaluations": [errors(0.4, 0.1)]}, "yes", "CONTROLS_KNOWN"),
    (CONTROL, {"evaluations": [evaluation(inside=[True, False] + [True] * 4)]}, "no", "BANDS_DO_NOT_HOLD"),
    (CONTROL, {"simulation": SHORT}, "partly", "FOLLOWS_TOO_SHORTLY"),
    (CONTROL, {"simulation": simulated([4.0, 2.0])}, "yes", "CONTROLS_KNOWN"),
    (CONTROL, {"fit": AX}, "partly", "ACCELERATIONS_AS_REGRESSORS"),
    (CONTROL, {"trim": BEYOND}, "no", "TRIM_BEYOND"),
    (CONTROL, {"findings": [SLOW]}, "no", "SLOW_LOG"),
    (CONTROL, {"fit": {"doubts": [DIVERGED]}}, "no", "PATHS_NOT_CONVERGED"),
    (PREDICT, {"findings": [DIVERGED]}, "partly", "PATHS_NOT_CONVERGED"),
    (CONTROL, {"trim": None, "notes": (NO_TRIM,)}, "no", "NO_TRIM"),
    (CONTROL, {"trim": None}, "no", "CONTROLS_MISSING"),
]  # fmt: skip


@pytest.mark.parametrize(("purpose", "parts", "judgement", "codes"), USES)
def test_what_a_model_may_be_used_for_and_why(purpose, parts, judgement, codes):
    assert use(verdict(**parts), purpose) == (judgement, {*codes.split()})


class TestMechanics:
    def test_is_at_the_median_of_what_was_flown(self, flight):
        found = mechanics_of(flight)
        assert_allclose(found.trim.airspeed, flight["airspeed"].median())
        assert_allclose(found.derivatives.loc["Cm_elevator", "value"], -1.0)
        assert {"short period", "Dutch roll"} <= set(found.modes.index)
        assert (found.simulation["lasts"] == found.simulation["horizon"]).all()

    def test_without_a_trim_derivatives_are_at_the_median_state(self, flight):
        found = mechanics_of(flight, aircraft=replace(AIRCRAFT, mass=500))
        assert found.trim is None
        assert found.modes is None
        assert [note.code for note in found.notes] == [Code.NO_TRIM]
        assert_allclose(found.derivatives.loc["Cm_elevator", "value"], -1.0)


def test_of_little_flown_a_large_error_says_nothing():
    found = verdict([evaluation(error=1.5)], fit={"flown": 5.0}, trim=None)
    assert {use.judgement for use in found.uses} == {"unknown"}
    assert {use.findings[0].numbers["seconds"] for use in found.uses} == {5.0}


def test_a_search_that_rounding_ends_is_not_to_go_on():
    ended = {"converged_": False, "max_iter": 300}
    assert search_ended(Bunch(**ended, n_iter_=40)).code == FitCode.SEARCH_ROUNDED
    assert search_ended(Bunch(**ended, n_iter_=300)).code == FitCode.SEARCH_STOPPED


def test_warnings_are_ranked():
    stopped = Finding(FitCode.SEARCH_STOPPED, max_iter=300)
    findings = [ALONE["a"], Finding(Code.NO_ELEVATOR), ALONE["b"], stopped]
    bad = [
        evaluation(error=1.2, linear=0.5, inside=False),
        evaluation("b", error=0.1, inside=False),
    ]
    found = verdict(bad, findings=findings)
    assert list(dict.fromkeys(finding.code for finding in found.findings)) == [
        Code.LEAST_SQUARES_BETTER,
        Code.BANDS_TOO_NARROW,
        FitCode.SEARCH_STOPPED,
        Code.ROWS_LEFT_OUT,
        Code.NO_ELEVATOR,
    ]
    assert found.findings[0].numbers["worse"] == 6
    assert verdict().warnings == ()
    assert verdict(derivatives=with_derivative("Cm_q", -7.5)).warnings == ()
    assert "CY_beta +0.1." in verdict(derivatives=with_derivative("CY_beta", 0.1, 0.2)).warnings[0]
