"""Planned flights of known aircraft: are standard deviations found afterwards those that were promised?

    python tests/benchmarks/plans.py [--aircraft NAME ...] [--wind SPEED ...] [--seeds K ...] --out OUT

The aircraft of small_uav.py, with vanes, make a gentle first flight of 40 s under an autopilot in
Dryden turbulence. A linear trend is learned, a flight of 60 s is planned for all derivatives, flown
by the true aircraft, and the trend is learned from both flights. The table has for each aircraft
the ratio of found to promised standard deviations, their fraction between 0.7 and 1.4 and within the
range of the promise, the fraction of goals that promise more than before, and the geometric means of
promised and found over before.
"""

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from small_uav import AIRCRAFT, STALL, TERMS, aircraft_of

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.design import Envelope, doublet, plan, wavetrain
from skdgp.dynamics import (
    Aerodynamics,
    FlightComputer,
    aerodynamic_coefficients,
    dryden_wind,
    simulate,
    stability_derivatives,
    trim,
)

STEP, EVERY = 0.0125, 2  # s of the servos, steps between logged samples
SERVO_LAG, ALTITUDE = 0.04, 150.0  # s, m
FIRST_SECONDS = 40.0
PLANNED_SECONDS = 60.0
LIMITS = {"elevator": 0.08, "aileron": 0.1, "rudder": 0.15}  # rad
GENTLE = 0.4  # of the limits, in the first flight
PROMISED = (0.7, 1.4)  # found over promised of a kept promise
NOISE = {
    **dict.fromkeys(("alpha", "beta", "phi", "theta", "psi"), 0.005),
    **dict.fromkeys(("p", "q", "r"), 0.002),
    **dict.fromkeys(("ax", "ay", "az"), 0.05),
    "airspeed": 0.3,
}
RATES = ("p", "q", "r")


def truth_of(plane):
    """Return the aircraft and its true coefficients."""
    names = [f"{name}_hat" if name in RATES else name for name in TERMS[1:9]]
    W = plane["derivatives"]

    def coefficients(X):
        X = np.array(X)
        level = np.ones_like(X[..., :1])
        abs_beta = np.abs(X[..., 1:2])
        if plane["stalls"]:
            X[..., 0] = STALL * np.tanh(X[..., 0] / STALL)
        return np.concatenate([level, X, abs_beta], axis=-1) @ W.T

    return Aerodynamics(coefficients, names), aircraft_of(plane)


def fly(truth, aircraft, airspeed, train, seconds, wind_at_6m, seed):
    """Return the record of the true aircraft's sensors, held level by an autopilot."""
    steady = trim(truth, aircraft, airspeed, altitude=ALTITUDE)

    surfaces = dict(steady.controls)
    moved = 1.0 - np.exp(-STEP / SERVO_LAG)

    def controls(time, state):
        commands = {name: value + train(name, time) for name, value in steady.controls.items()}
        commands["elevator"] += 0.2 * (state["theta"] - steady.theta) + 0.05 * state["q"]
        commands["aileron"] -= 0.1 * state["phi"] + 0.02 * state["p"]
        for name, command in commands.items():
            surfaces[name] += moved * (command - surfaces[name])
        return dict(surfaces)

    wind = dryden_wind(
        seconds, airspeed, ALTITUDE, wind_at_6m=wind_at_6m, span=aircraft.span, random_state=seed
    )
    autopilot = FlightComputer(controls)
    flight = simulate(truth, aircraft, steady, autopilot, STEP, duration=seconds, air=wind)
    flight = flight.iloc[::EVERY].reset_index(drop=True)
    rng = np.random.default_rng(seed)
    for name, std in NOISE.items():
        flight[name] += std * rng.standard_normal(len(flight))
    return flight.assign(thrust_x=flight["thrust"], flight=f"flight {seed}")


def learn(flights, aircraft, regressors):
    """Return the pipeline of a linear trend."""
    log = pd.concat(flights, ignore_index=True)
    regressor = DependentGPRegressor(structure="trend")
    model = make_identification_pipeline(aircraft, regressors=regressors, regressor=regressor)
    return model.fit(log, aerodynamic_coefficients(log, aircraft))


def derivatives(model, aircraft, point, names):
    """Return standard deviations of derivatives by name, and their parts."""
    table = stability_derivatives(model, aircraft, point)
    return table.loc[names, ["std", "std_posterior", "std_random", "std_method"]]


def loop(plane, wind_at_6m, seed):
    """Return standard deviations before a planned flight, promised and found, lists by goal."""
    truth, aircraft = truth_of(plane)
    airspeed = plane["airspeed"]
    has_rudder = plane["derivatives"][:, TERMS.index("rudder")].any()
    limits = {axis: size for axis, size in LIMITS.items() if has_rudder or axis != "rudder"}
    regressors = [name for name in truth.regressors if has_rudder or name != "rudder"]
    gentle = [{axis: doublet(0.4, GENTLE * size)} for axis, size in limits.items()] * 3
    first = wavetrain(gentle, pause=3.0)
    flights = [fly(truth, aircraft, airspeed, first, FIRST_SECONDS, wind_at_6m, 2 * seed)]
    model = learn(flights, aircraft, regressors)
    steady = trim(model, aircraft, airspeed, altitude=ALTITUDE)
    envelope = Envelope(bank=1.0, altitude=50.0, growth=0.5)
    chosen = plan(
        model,
        aircraft,
        steady,
        seconds=PLANNED_SECONDS,
        axes=list(limits),
        limits=limits,
        envelope=envelope,
    )
    train = chosen.train
    flights.append(fly(truth, aircraft, airspeed, train, PLANNED_SECONDS, wind_at_6m, 2 * seed + 1))
    after = learn(flights, aircraft, regressors)
    goal = chosen.errors.index
    found = derivatives(after, aircraft, steady, goal)["std"]
    return {
        "goal": list(goal),
        "before": chosen.errors["before"].tolist(),
        "promised": chosen.errors["promised"].tolist(),
        "low": chosen.errors["low"].tolist(),
        "high": chosen.errors["high"].tolist(),
        "found": found.tolist(),
    }


def row_of(name, goals):
    """Return a row of the table for the goals of some loops."""
    ratio = goals["found"] / goals["promised"]
    kept = ratio.between(*PROMISED)
    within = goals["found"].between(goals["low"], goals["high"])
    worse = goals["promised"] > goals["before"]
    left = np.exp(np.log(goals[["promised", "found"]].div(goals["before"], axis=0)).mean())
    low, median, high = ratio.quantile([0.1, 0.5, 0.9])
    return {
        "aircraft": name,
        "found over promised: 10, 50, 90 %": f"{low:.2f}, {median:.2f}, {high:.2f}",
        "between 0.7 and 1.4": f"{kept.mean():.0%}",
        "within the range": f"{within.mean():.0%}",
        "worse than before": f"{worse.mean():.0%}",
        "promised over before": f"{left['promised']:.2f}",
        "found over before": f"{left['found']:.2f}",
    }


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", nargs="+", choices=AIRCRAFT, default=list(AIRCRAFT))
    parser.add_argument("--wind", nargs="+", type=float, default=[2.0, 6.0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    options = parser.parse_args(words)
    kept = Kept(options, "plans")
    for name in options.aircraft:
        for wind in options.wind:
            for seed in options.seeds:
                key = {"aircraft": name, "wind": wind, "seed": seed}
                kept.run(key, loop, AIRCRAFT[name], wind, seed)
    columns = ["before", "promised", "low", "high", "found"]
    goals = kept.table.explode(["goal", *columns])
    goals[columns] = goals[columns].astype(float)
    rows = [row_of(name, some) for name, some in goals.groupby("aircraft", sort=False)]
    rows.append(row_of("all", goals))
    finish(options, "plans", promises=rows)


if __name__ == "__main__":
    main()
