"""Standard errors predicted before a flight, beside the scatter of estimates over 100 flights of the same plan.

    python tests/benchmarks/standard_errors.py [--out OUT] [--flights 100] [--aircraft example c172p t6texan2]

An aircraft with known truth flies 60 s of inputs of half the limits, in calm or in moderate air.
From this flight a linear trend is learned, and its noise (`flight_noise`). `plan` chooses 60 s from
it and predicts the standard errors of all derivatives from these 60 s alone. The plan is flown 100
times by the truth, each time in other gusts and with other noise of the sensors. From each flight
derivatives at its trim are estimated by the polynomial of second order of least squares; predicted
is their standard error, found their standard deviation. Columns:

    within 25 %   the share of the 48 derivatives with predicted / found of .75 to 1.25
    goal          predicted / found of the plan's goal, their geometric mean

A second table has what no noise is: of the residuals of the first flight in calm air, at the
frequencies of its motion, the share of the power that stays the same when the same flight is
recorded with other noise of the sensors.

An aircraft of JSBSim needs the jsbsim wheel. Each case is kept under OUT/standard_errors and not
done again.
"""

import itertools
import warnings
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from _closed_loop_flights import AXES, PAUSE, SUBJECTS, Subject, exploratory, sortie
from _common import finish, parser_of
from closed_loop import REGRESSORS, WIDE, _manoeuvres, learned, rows_of, seen
from scipy.linalg import orth
from sklearn.preprocessing import PolynomialFeatures
from study import kept

from skdgp._flight.channels import COEFFICIENTS
from skdgp.design import Information, Known, Pilot, plan
from skdgp.dynamics import SimulationWarning
from skdgp.identification import flight_noise

SECONDS, EVERY, RECORDED = 60.0, 2, 8
AIR = ("calm", "moderate")
GROWTH = (0.5, 1.0, 2.0)
"""Of the envelope: the first of these that gusts alone do not leave."""


def case(subject: Subject, air: str, n_flights: int) -> dict[str, Any]:
    """Return the standard errors that were predicted, and those that were found, (6, 8) each."""
    first = seen(subject.fly([exploratory(subject)], SECONDS, air, [0, 0])[0], [0, 0])
    model = learned(first, subject)
    noise = flight_noise(model, first, subject.aircraft)
    size = 1 + len(REGRESSORS)
    nothing = Information(np.zeros((6, size, size)), COEFFICIENTS, tuple(REGRESSORS))
    make = partial(
        plan, model, subject.aircraft, airspeeds=subject.airspeed, seconds=SECONDS, axes=list(AXES),
        limits=subject.allowed, altitude=subject.altitude, known=Known(nothing, noise, curvature=True),
        pilot=Pilot(PAUSE, 40.0),
    )  # fmt: skip
    for growth in GROWTH:
        try:
            found = make(envelope=replace(WIDE, growth=growth))
            break
        except ValueError as error:
            print(error, flush=True)
    inputs = sortie(_manoeuvres(found))
    rows = []
    for k, log in enumerate(subject.fly([inputs] * n_flights, SECONDS, air, [0, 1])):
        rows.append(rows_of(seen(log, [0, 1, k]), subject))
    flown_at = np.mean(
        [X[time < PAUSE].mean(axis=0) for time, X, _ in rows], axis=0
    )  # the model's trim differs
    predicted = found.after.std.to_numpy()
    return {
        "predicted": predicted,
        "found": scatter(rows, flown_at),
        "manoeuvres": found.manoeuvres,
        "growth": growth,
    }


def scatter(rows: list[Any], about: np.ndarray) -> np.ndarray:
    """Return the standard deviation of the derivatives (6, 8) at a point, by least squares of second order."""
    slopes = []
    for _, X, Y in rows:
        size = X.std(axis=0)
        basis = PolynomialFeatures(2).fit_transform((X[::EVERY] - about) / size)
        slopes.append(np.linalg.lstsq(basis, Y[::EVERY], rcond=None)[0][1 : 1 + len(size)].T / size)
    return np.std(slopes, axis=0, ddof=1)


def repeated(name: str, subject: Subject) -> dict[str, Any]:
    """Return the share of the power of residuals that does not change with the noise of the sensors."""
    (log,) = subject.fly([exploratory(subject)], SECONDS, "calm", [0, 0])
    found, moved = [], 0.0
    for k in range(RECORDED):
        _, X, Y = rows_of(seen(log, [k, 5]), subject)
        terms = [
            orth(PolynomialFeatures(degree).fit_transform((X - X.mean(axis=0)) / X.std(axis=0)))
            for degree in (1, 2)
        ]
        found.append(Y - terms[1] @ (terms[1].T @ Y))
        moved = moved + power(terms[0]).sum(axis=1) / RECORDED
    whole = np.mean([moved @ power(one) for one in found], axis=0)
    mean = moved @ power(np.mean(found, axis=0))
    share = (mean - whole / RECORDED) / (1 - 1 / RECORDED) / whole
    return {"aircraft": name} | {
        one: f"{100 * x:.0f} %" for one, x in zip(COEFFICIENTS, share, strict=True)
    }


def power(values: np.ndarray) -> np.ndarray:
    """Return the squared Fourier transform of each column."""
    return np.abs(np.fft.rfft(values, axis=0)) ** 2


def summary(name: str, air: str, found: dict[str, Any]) -> dict[str, Any]:
    """Return the share of ratios of predicted to found errors within 25 %, and their geometric mean."""
    ratio = found["predicted"] / found["found"]
    within = f"{100 * np.mean(np.abs(ratio - 1) <= 0.25):.0f} %"
    return {
        "aircraft": name,
        "air": air,
        "within 25 %": within,
        "goal": f"{np.exp(np.log(ratio).mean()):.2f}",
    }


def main(words: Any = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", nargs="+", default=["example", "c172p"], choices=SUBJECTS)
    parser.add_argument("--flights", type=int, default=100)
    options = parser.parse_args(words)
    folder = options.out / "standard_errors" if options.out else None
    cases = {}
    for name, air in itertools.product(options.aircraft, AIR):
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", SimulationWarning
            )  # of manoeuvres that are then made smaller
            cases[name, air] = kept(
                folder,
                f"{name}-{air}-{options.flights}",
                lambda: case(SUBJECTS[name](), air, options.flights),  # noqa: B023
            )
        print(name, air, cases[name, air].get("growth"), flush=True)
    finish(
        options,
        "standard_errors",
        summary=[summary(*key, found) for key, found in cases.items()],
        repeated=[repeated(name, SUBJECTS[name]()) for name in options.aircraft],
    )


if __name__ == "__main__":
    main()
