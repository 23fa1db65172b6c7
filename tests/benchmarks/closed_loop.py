"""Closed loop: explore, learn, plan, fly, learn again; beside classical inputs in the same time.

    python tests/benchmarks/closed_loop.py [--out OUT] [--seeds 10] [--aircraft example c172p t6texan2]

An aircraft with known truth flies 60 s of inputs of half the limits in light turbulence. From this
flight a linear trend is learned, and it flies 60 s more, after the same first flight and in gusts
of its own:

    plan, function plan
                  what `plan` chooses for the derivatives, and for the function
    doublets, 3-2-1-1
                  of the modes' widths, one axis after another
    Schroeder, multisine
                  multisines of 10 s on all axes at once, with Schroeder's phases and with optimised
                  ones

All have the same limits of the axes and the same pauses, and each manoeuvre is as large as the
check of `plan` allows in the same envelope. Controls are held during a manoeuvre, and an autopilot
returns to the trim in the pause after it. A quadratic trend is fitted by least squares to the first
flight and the first seconds of the second, as sensors saw them. Its errors:

    derivatives   at the trim, each times the range of its regressor over that of its coefficient, geometric mean of the
                  sizes, against the same trend fitted to the exact data of a flight in calm air
    function      NRMSE on that flight, mean over the coefficients
    ratio         seconds of the plan until its error is that of the best classical input after all its time, over the
                  seconds of that input until then; median over the seeds, inf if the plan does not
                  get there. The best is chosen in hindsight, seed by seed. The ratio of the errors
                  after all the time stands beside it
    floor         errors after all the time, as measured; with the rates that the aerodynamics feel, the true alpha and
                  beta, all true regressors; and with the true coefficients too, where the
                  polynomial alone is wrong

The envelope is what was flown, and half of its range more at either end; no floor. Seeds whose
first flight moved so little that gusts alone leave it have no second flight; they are left out.
Classical inputs that the check allows at no size are left out of their seeds. An aircraft of JSBSim
needs the jsbsim wheel. Each seed is kept under OUT/closed_loop and not done again.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from _closed_loop_flights import AXES, SUBJECTS, Subject, exploratory, sortie
from _common import finish, parser_of
from _study_flights import NAMES, Log
from sklearn.preprocessing import PolynomialFeatures
from study import kept

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp._flight.channels import HAT, RATE_LENGTHS
from skdgp.datasets._example_flights import MEASURED, measure
from skdgp.design import (
    Envelope,
    Known,
    Pilot,
    coefficient_noise,
    doublet,
    input_bands,
    multisine,
    orthogonal_multisines,
    three_two_one_one,
)
from skdgp.design._planner import Planner
from skdgp.design._rehearsal import RESPONSE
from skdgp.dynamics import SimulationWarning, aerodynamic_coefficients, as_aerodynamics, linearize

KEPT = ("alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder")
REGRESSORS = [name + HAT if name in RATE_LENGTHS else name for name in KEPT]
COLUMNS = [NAMES.index(name) for name in KEPT]
AIR_DATA, RATES = ([KEPT.index(name) for name in names] for names in (("alpha", "beta"), "pqr"))
EXPLORED, CUTS, AIR = 60.0, 5.0, "light"
KINDS = ("doublets", "3-2-1-1", "multisine", "Schroeder")
GOALS = {"plan": None, "function plan": ("function",)}
WIDE = Envelope(
    bank=1.0, load_factor=(-np.inf, np.inf), airspeed=(0.0, np.inf), altitude=-np.inf, growth=0.5
)
ENVELOPE = Envelope(altitude=-np.inf, growth=1.0)
"""What was flown, and half of its range more at either end: gusts alone leave less after 60 s of
level flight.
"""


class Truth(NamedTuple):
    """The flight in calm air that scores: exact regressors, coefficients, and the derivatives that they show."""

    X: np.ndarray
    Y: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, subject: Subject) -> Truth:
        log = subject.fly([exploratory(subject, 0.6, 1.3)], EXPLORED, "calm", 0)[0]
        unknown = cls(log.exact[:, COLUMNS], log.truth, np.zeros((6, len(COLUMNS))))
        return unknown._replace(slopes=unknown._trend(unknown.X, unknown.Y)[0])

    def errors(self, X: np.ndarray, Y: np.ndarray) -> tuple[float, float]:
        """Return the errors of derivatives and function that rows teach."""
        slopes, function = self._trend(X, Y)
        off = np.sqrt(np.mean((function - self.Y) ** 2, axis=0)) / self.Y.std(axis=0)
        return float(np.exp(np.mean(np.log(np.abs(slopes - self.slopes) + 1e-12)))), float(
            off.mean()
        )

    def _trend(self, X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return scaled derivatives in the middle of the flight, and the function along it."""
        weights = np.linalg.lstsq(self._terms(X), Y, rcond=None)[0]
        slopes = weights[1 : 1 + X.shape[1]].T / self.Y.std(axis=0)[:, None]
        return slopes, self._terms(self.X) @ weights

    def _terms(self, X: np.ndarray) -> np.ndarray:
        return PolynomialFeatures(2).fit_transform((X - self.X.mean(axis=0)) / self.X.std(axis=0))


def seen(log: Log, seed: Any) -> pd.DataFrame:
    """Return what the sensors recorded."""
    table = pd.concat([measure(log.table, 1.0, np.random.default_rng(seed)), log.table], axis=1)
    return table[[name for name in MEASURED if name in table]].copy()


def rows_of(table: pd.DataFrame, subject: Subject) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, regressors and coefficients as the pipeline makes them."""
    steps = make_identification_pipeline(
        subject.aircraft, regressors=REGRESSORS, reconstruction="passthrough"
    )[:-2]
    return (
        table["time"].to_numpy(),
        np.asarray(steps.fit_transform(table), dtype=float),
        aerodynamic_coefficients(table, subject.aircraft).to_numpy(),
    )


def learned(table: pd.DataFrame, subject: Subject) -> Any:
    """Return the trend of the exploratory flight."""
    model = make_identification_pipeline(
        subject.aircraft,
        regressors=REGRESSORS,
        reconstruction="passthrough",
        regressor=DependentGPRegressor(structure="trend", max_iter=10, random_state=0),
    )
    return model.fit(table, aerodynamic_coefficients(table, subject.aircraft))


def classical(planner: Any, seconds: float) -> dict[str, list[dict]]:
    """Return the classical inputs, each kind as large as the limits and the envelope allow, until the time is used."""
    bands = input_bands(
        linearize(planner.model, planner.aircraft, planner.trims[0], inputs=list(AXES))
    )
    limits, pause = planner.limits, planner.rehearsals[0].pause
    kinds: dict[str, list[dict]] = {}
    for name, make in (("doublets", doublet), ("3-2-1-1", three_two_one_one)):
        widths = {axis: bands.loc[axis, f"{make.__name__}_width"] for axis in AXES}
        kinds[name] = [{axis: make(widths[axis], limits[axis].amplitude)} for axis in AXES]
    band = bands["lowest"].min(), bands["highest"].max()
    kinds["multisine"] = [dict(orthogonal_multisines(limits, 10.0, band, n_tones=5, n_starts=3))]
    kinds["Schroeder"] = [
        {
            axis: limits[axis].largest(multisine(10.0, one.harmonics, rms=1.0))
            for axis, one in kinds["multisine"][0].items()
        }
    ]
    found = {}
    for name, manoeuvres in kinds.items():
        safe = [one for one in (_safe(planner, each) for each in manoeuvres) if one]
        found[name], used = [], min(pause, RESPONSE)
        for one in itertools.cycle(safe) if safe else ():
            used += max(signal.duration for signal in one.values()) + pause
            if used > seconds:
                break
            found[name].append(one)
    return found


def _safe(planner: Any, inputs: dict) -> dict | None:
    made = planner.made(0, {"": inputs})
    safe = planner.safe(made[0])[0] if made else None
    return None if safe is None else safe.inputs


def left(
    log: Log, parts: Sequence[tuple[float, float]], model: Any, subject: Subject
) -> list[bool]:
    """Return in which parts of a flight the motion left the envelope: the controls are the pilot's trim too."""
    true = log.table[[name for name in log.table if name.endswith("_true")]]
    table = true.rename(columns=lambda name: name.removesuffix("_true"))
    table = table.assign(ended="", **log.table[["time", "altitude", *AXES]])
    out = ENVELOPE.left(table, subject.aircraft, as_aerodynamics(model))
    out = out.drop(columns=[f"growth of {axis}" for axis in AXES]).any(axis=1).to_numpy()
    time = table["time"].to_numpy()
    return [bool(out[(time >= start) & (time < end)].any()) for start, end in parts]


def loop(subject: Subject, seed: int, seconds: float, n_paths: int) -> dict[str, Any]:
    """Return what one seed flew: rows of every flight, and what was predicted."""
    watch = time.process_time()
    explored = subject.fly([exploratory(subject)], EXPLORED, AIR, [seed, 0])[0]
    first = seen(explored, [seed, 0])
    model = learned(first, subject)
    took = {"learn": time.process_time() - watch}
    watch = time.process_time()
    planner = Planner(
        model, subject.aircraft, airspeeds=subject.airspeed, seconds=seconds, axes=AXES, limits=subject.allowed,
        envelope=replace(ENVELOPE, n_paths=n_paths), altitude=subject.altitude,
        known=Known(None, coefficient_noise(model)), pilot=Pilot(rate=40.0), seed=seed,
    )  # fmt: skip
    found = {name: planner.search(goal) for name, goal in GOALS.items()}
    took["plan"] = time.process_time() - watch
    kinds = {name: _manoeuvres(one) for name, one in found.items()} | classical(planner, seconds)
    sorties = {name: sortie(one, planner.rehearsals[0].pause) for name, one in kinds.items() if one}
    logs = dict(
        zip(sorties, subject.fly([*sorties.values()], seconds, AIR, [seed, 1]), strict=True)
    )
    rows = {"explored": rows_of(first, subject)}
    rows |= {
        name: rows_of(seen(log, [seed, 1, k]), subject)
        for k, (name, log) in enumerate(logs.items())
    }
    exact = {name: felt(log) for name, log in [("explored", explored), *logs.items()]}
    took["all"] = time.process_time() - watch + took["learn"]
    return {
        "rows": rows, "exact": exact, "took": took, "pause": planner.rehearsals[0].pause,
        "manoeuvres": {name: one.manoeuvres for name, one in found.items()},
        "left": {name: left(log, sorties[name].busy, model, subject) for name, log in logs.items()},
        "pauses left": {name: left(log, sorties[name].pauses(seconds), model, subject) for name, log in logs.items()},
        "scales": {name: [max(signal.peak / subject.limits[axis] for axis, signal in one.items()) for one in each]
                   for name, each in kinds.items()},
    }  # fmt: skip


def felt(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Return the true regressors of a flight, with the rates that the aerodynamics feel, and coefficients."""
    X = log.exact[:, COLUMNS].copy()
    X[:, RATES] -= log.gust
    return X, log.truth


def _manoeuvres(found: Any) -> list[dict]:
    """Return the manoeuvres of a plan of one wavetrain."""
    starts: dict[float, dict] = {}
    for axis, start, signal in sorted(found.trains[0].events(), key=lambda event: event[1]):
        starts.setdefault(round(start, 6), {})[axis] = signal
    return [*starts.values()]


# -- tables
# --------------------------------------------------------------------------------------------


def curves(found: dict[str, Any], truth: Truth) -> dict[str, np.ndarray]:
    """Return the errors of derivatives and function of each kind of flight after every `CUTS`, (n, 3) with the time."""
    _, X0, Y0 = found["rows"]["explored"]
    result = {}
    for name, (clock, X, Y) in found["rows"].items():
        cuts = [0.0] if name == "explored" else np.arange(0.0, clock[-1] + CUTS, CUTS)
        rows = [
            (np.concatenate([X0, X[clock < cut]]), np.concatenate([Y0, Y[clock < cut]]))
            for cut in cuts
        ]
        result[name] = np.array(
            [(cut, *truth.errors(*one)) for cut, one in zip(cuts, rows, strict=True)]
        )
    return result


def reached(curve: np.ndarray, column: int, error: float) -> float:
    """Return the time at which an error is reached, linear between the cuts; inf if it is not."""
    below = np.flatnonzero(curve[:, column] <= error)
    if not len(below):
        return np.inf
    k = below[0]
    if k == 0:
        return float(curve[0, 0])
    (t0, e0), (t1, e1) = curve[k - 1, [0, column]], curve[k, [0, column]]
    return float(t0 + (t1 - t0) * (e0 - error) / (e0 - e1))


def ratio_rows(name: str, every: list[dict[str, np.ndarray]]) -> list[dict[str, Any]]:
    """Return the median seconds of the plan to the last error of the best classical input, over those of that input."""
    rows = []
    every = [found for found in every if {*KINDS} & {*found}]
    for plan, (what, column) in zip(GOALS, (("derivatives", 1), ("function", 2)), strict=True):
        seconds, errors = [], []
        for found in every:
            best = min({*KINDS} & {*found}, key=lambda kind: found[kind][-1, column])
            error = found[best][-1, column]
            errors.append(found[plan][-1, column] / error)
            own, other = (max(CUTS, reached(found[kind], column, error)) for kind in (plan, best))
            seconds.append(own / other)
        if every:
            medians = {
                "seconds over the best": float(np.median(seconds)),
                "error over the best": np.median(errors),
            }
            rows.append(
                {"aircraft": name, "flight": plan, "error of": what, **medians, "seeds": len(every)}
            )
    return rows


def risk_rows(name: str, every: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the predicted and the found rate of manoeuvres that leave the envelope, of the plan and of all flights."""
    kinds = [kind for kind in GOALS if kind in every[0]["left"]]
    predicted = np.concatenate(
        [found["manoeuvres"][kind]["risk"] for found in every for kind in kinds]
    )
    left = np.concatenate([found["left"][kind] for found in every for kind in kinds])
    pauses = np.concatenate([found["pauses left"][kind] for found in every for kind in kinds])
    others = np.concatenate(
        [one for found in every for kind, one in found["left"].items() if kind in KINDS] or [[]]
    )
    return [{
        "aircraft": name, "allowed %": 100.0 * ENVELOPE.risk, "predicted %": float(100.0 * predicted.mean()),
        "found %": float(100.0 * left.mean()), "pauses, found %": float(100.0 * pauses.mean()), "manoeuvres": len(left),
        "of classical inputs, found %": float(100.0 * np.mean(others)) if len(others) else None,
        "their manoeuvres": len(others), "seeds": len(every),
        "median planning, CPU s": float(np.median([found["took"]["plan"] for found in every])),
    }]  # fmt: skip


def floor_rows(name: str, every: list[dict[str, Any]], truth: Truth) -> list[dict[str, Any]]:
    """Return the median errors after all the time, with the true values of more and more that was measured."""
    rows = []
    true = {"true rates of the air": RATES, "true alpha, beta": AIR_DATA, "all true": slice(None)}
    errors = []
    for found in every:
        if "plan" not in found["exact"]:
            continue
        X, Y = (
            np.concatenate([found["rows"][one][k] for one in ("explored", "plan")]) for k in (1, 2)
        )
        exact, coefficients = (
            np.concatenate([found["exact"][one][k] for one in ("explored", "plan")]) for k in (0, 1)
        )
        tried = {"measured": (X, Y)}
        for what, columns in true.items():
            tried[what] = X.copy(), Y
            tried[what][0][:, columns] = exact[:, columns]
        tried["and coefficients"] = exact, coefficients
        errors.append([truth.errors(*one) for one in tried.values()])
    for column, what in enumerate(("derivatives", "function") if errors else ()):
        values = np.median(errors, axis=0)[:, column].tolist()
        rows.append(
            {
                "aircraft": name,
                "flight": "plan",
                "error of": what,
                **dict(zip(tried, values, strict=True)),
            }
        )
    return rows


def main(words: Any = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", nargs="+", default=["example"], choices=SUBJECTS)
    parser.add_argument("--seeds", type=int, default=10, help="of gusts and sensor noise")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the second flight")
    parser.add_argument(
        "--paths", type=int, default=200, help="aircraft drawn for each check of a manoeuvre"
    )
    options = parser.parse_args(words)
    folder = options.out / "closed_loop" if options.out else None
    subjects = {name: SUBJECTS[name]() for name in options.aircraft}
    truths = {name: Truth.of(subject) for name, subject in subjects.items()}
    flown: dict[str, list] = {name: [] for name in subjects}
    for seed, name in itertools.product(range(options.seeds), subjects):
        make = partial(loop, subjects[name], seed, options.seconds, options.paths)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", SimulationWarning
                )  # of manoeuvres that are then made smaller
                flown[name].append(kept(folder, f"{name}-{seed}", make))
        except (
            ValueError
        ) as error:  # the gusts alone leave what was flown: no plan, and no other input
            print(name, seed, error, flush=True)
            continue
        print(name, seed, flown[name][-1]["took"], flush=True)
    tables: dict[str, list] = {"ratios": [], "floor": [], "risks": []}
    for name, every in flown.items():
        if not every:  # planning was refused for all seeds
            continue
        tables["ratios"] += ratio_rows(name, [curves(found, truths[name]) for found in every])
        tables["floor"] += floor_rows(name, every, truths[name])
        tables["risks"] += risk_rows(name, every)
    finish(options, "closed_loop", **tables)


if __name__ == "__main__":
    main()
