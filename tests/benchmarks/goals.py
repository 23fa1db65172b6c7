"""What a plan teaches, by the goal that it was asked for: derivatives, the function, or free flight.

    python tests/benchmarks/goals.py [--out OUT] [--seeds 5]

The example aircraft flies 60 s of inputs of half the limits in light turbulence. From the trend that is learned from
them, `plan` chooses 60 s for each goal, and the truth flies them in gusts. Columns: the error of each goal that is
expected after the plan, and those that were found by a quadratic trend of both flights, as closed_loop.py scores them;
each over that of the plan for derivatives of the same seed. Medians over seeds of gusts and sensor noise. Each seed is
kept under OUT/goals and not done again.
"""

import warnings
from functools import partial
from typing import Any

import numpy as np
from _closed_loop_flights import AXES, PAUSE, SUBJECTS, exploratory, sortie
from _common import finish, parser_of
from closed_loop import AIR, EXPLORED, WIDE, Truth, _manoeuvres, learned, rows_of, seen
from study import kept

from skdgp.design import Known, Pilot, plan
from skdgp.design._information import errors_of
from skdgp.dynamics import SimulationWarning
from skdgp.identification import flight_noise

GOALS = {"derivatives": None, "Cm_q": ["Cm_q"], "function": ["function"], "free-flight": ["free-flight"]}


def run(subject: Any, truth: Truth, seed: int) -> dict[str, dict[str, float]]:
    """Return expected and found errors of the plan for each goal."""
    first = seen(subject.fly([exploratory(subject)], EXPLORED, AIR, [seed, 0])[0], [seed, 0])
    model = learned(first, subject)
    make = partial(
        plan, model, subject.aircraft, airspeeds=subject.airspeed, seconds=EXPLORED, axes=list(AXES),
        pilot=Pilot(PAUSE, 40.0), limits=subject.limits, altitude=subject.altitude, envelope=WIDE,
        known=Known(noise=flight_noise(model, first, subject.aircraft)),
    )  # fmt: skip
    plans = {name: make(goal=goal) for name, goal in GOALS.items()}
    weights = {name: plans[name].weights[name] for name in GOALS if name in plans[name].weights}
    logs = subject.fly([sortie(_manoeuvres(one)) for one in plans.values()], EXPLORED, AIR, [seed, 1])
    _, X0, Y0 = rows_of(first, subject)
    found = {}
    for k, ((name, one), log) in enumerate(zip(plans.items(), logs, strict=True)):
        _, X, Y = rows_of(seen(log, [seed, 1, k]), subject)
        slopes, function = truth.errors(np.concatenate([X0, X]), np.concatenate([Y0, Y]))
        expected = errors_of(one.after, weights)
        derivatives = float(np.exp(np.log(expected.drop([*weights])).mean()))
        found[name] = {
            "expected derivatives": derivatives, **{f"expected {goal}": expected[goal] for goal in weights},
            "found derivatives": slopes, "found function": function,
        }  # fmt: skip
    return found


def main(words: Any = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="of gusts and sensor noise")
    options = parser.parse_args(words)
    folder = options.out / "goals" if options.out else None
    every = [{goal: {"found function": 1.0} for goal in GOALS}] if options.smoke else []
    if not options.smoke:
        subject = SUBJECTS["example"]()
        truth = Truth.of(subject)
        for seed in range(options.seeds):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", SimulationWarning)  # of manoeuvres that are then made smaller
                    every.append(kept(folder, f"example-{seed}", partial(run, subject, truth, seed)))
            except ValueError as error:  # the gusts alone leave what was flown: no plan
                print(seed, error, flush=True)
    rows = []
    for goal in GOALS:
        row: dict[str, Any] = {"plan for": goal, "seeds": len(every)}
        for name in every[0][goal]:
            row[name] = float(np.median([found[goal][name] / found["derivatives"][name] for found in every]))
        rows.append(row)
    finish(options, "goals", goals=rows)


if __name__ == "__main__":
    main()
