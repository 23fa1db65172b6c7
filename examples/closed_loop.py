"""
Plan the next flight
====================

Close the loop: explore, learn, plan, fly, and learn again::

    python examples/closed_loop.py

The truth is the example aircraft, simulated in gusts. After a gentle first flight a linear trend is
learned, the next flight is planned for derivatives of Cl, Cm and Cn, and flown. The picture shows
the planned inputs, and the derivatives after each flight with two standard deviations, beside the
truth. Further flights do not reduce errors by unmeasured rates of the air, alpha_dot and curvature.
Needs matplotlib: pip install "skdgp[plot]".
"""

import argparse

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.design import Envelope, doublet, plan, wavetrain
from skdgp.dynamics import (
    Air,
    Turbulence,
    aerodynamic_coefficients,
    simulate,
    stability_derivatives,
    trim,
)

AXES = {"elevator": 0.08, "aileron": 0.12, "rudder": 0.16}  # limits [rad]
GOAL = ["Cm_alpha", "Cm_q", "Cm_elevator", "Cl_p", "Cl_aileron", "Cn_beta", "Cn_r", "Cn_rudder"]
NAMES = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
NOISE = {
    **dict.fromkeys(("alpha", "beta", "phi", "theta", "psi"), 0.005),
    **dict.fromkeys(("p", "q", "r"), 0.002),
    **dict.fromkeys(("ax", "ay", "az"), 0.05),
    "airspeed": 0.3,
}
SPEED = 35.0
ALTITUDE = 200.0
PAUSE = 3.0
STEP = 0.0125  # of the servos [s]; every other sample is logged
SERVO_LAG = 0.04  # [s]
LIMITS = {"bank": (-1.0, 1.0), "airspeed": (28.0, 42.0), "altitude": (120.0, np.inf)}
ENVELOPE = Envelope(LIMITS, growth=0.5)


def fly(truth, aircraft, train, seconds, seed):
    """Return the record of the true aircraft's sensors, held level by an autopilot, in gusts."""
    steady = trim(truth, aircraft, SPEED, altitude=ALTITUDE)

    surfaces = dict(steady.controls)
    moved = 1.0 - np.exp(-STEP / SERVO_LAG)

    def controls(time, state):
        commands = {name: value + train(name, time) for name, value in steady.controls.items()}
        commands["elevator"] += 0.2 * (state["theta"] - steady.theta) + 0.1 * state["q"]
        commands["aileron"] -= 0.06 * state["phi"] + 0.02 * state["p"]
        for name, command in commands.items():
            surfaces[name] += moved * (command - surfaces[name])
        return dict(surfaces)

    air = Air(gusts=Turbulence.low_altitude(140.0, wind_at_6m=4.0))
    flight = simulate(
        truth, aircraft, steady, controls, STEP, duration=seconds, air=air, random_state=seed
    )
    flight = flight.iloc[::2].reset_index(drop=True)
    flight["propeller_speed"] = aircraft.propeller.speed_at(flight["throttle"])
    rng = np.random.default_rng(seed)
    for name, std in NOISE.items():
        flight[name] += std * rng.standard_normal(len(flight))
    return flight.assign(flight=f"flight {seed}")


def learn(flights, aircraft):
    log = pd.concat(flights, ignore_index=True)
    regressor = DependentGPRegressor(structure="trend")
    model = make_identification_pipeline(aircraft, regressors=NAMES, regressor=regressor)
    return model.fit(log, aerodynamic_coefficients(log, aircraft))


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Explore, learn, plan, fly, and learn again.")
    parser.add_argument("--rounds", type=int, default=2, help="planned flights")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each planned flight")
    parser.add_argument("--output", default="closed_loop.png", help="the picture")
    options = parser.parse_args(arguments)

    example = load_example_flights(turbulence=0.0)
    aircraft = example.aircraft
    truth = example.truth

    gentle = [{axis: doublet(0.5, 0.4 * limit)} for axis, limit in AXES.items()] * 2
    flights = [fly(truth, aircraft, wavetrain(gentle, pause=PAUSE), 32.0, 0)]
    steady = trim(truth, aircraft, SPEED, altitude=ALTITUDE)
    model = learn(flights, aircraft)
    found = [stability_derivatives(model, aircraft, steady).loc[GOAL]]
    trains = []
    for number in range(1, options.rounds + 1):
        point = trim(model, aircraft, SPEED, altitude=ALTITUDE)
        planned = plan(
            model,
            aircraft,
            point,
            seconds=options.seconds,
            axes=list(AXES),
            goal=GOAL,
            limits=AXES,
            envelope=ENVELOPE,
        )
        print(planned.manoeuvres[["start", "name", "scale"]].round(2))
        trains.append(planned.train)
        flights.append(fly(truth, aircraft, planned.train, options.seconds, number))
        model = learn(flights, aircraft)
        found.append(stability_derivatives(model, aircraft, steady).loc[GOAL])

    exact = stability_derivatives(truth, aircraft, steady)["value"]
    draw(trains, found, exact).savefig(options.output, dpi=120)
    print(options.output)


def draw(trains, found, exact):
    """Return the picture: inputs above, derivatives below."""
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    above, below = figure.subfigures(2, 1)
    panels = above.subplots(1, len(trains), squeeze=False)[0]
    for k, (ax, train) in enumerate(zip(panels, trains, strict=True), start=1):
        time = np.arange(0.0, train.duration + PAUSE, 0.02)
        for axis in AXES:
            ax.plot(time, np.rad2deg(train(axis, time)), label=axis, linewidth=0.8)
        ax.set(title=f"planned flight {k}", xlabel="time [s]", ylabel="from trim [deg]")
    panels[0].legend(frameon=False, fontsize="small", loc="upper right")
    for ax, name in zip(below.subplots(2, 4).ravel(), GOAL, strict=True):
        values = [table.loc[name, "value"] for table in found]
        deviations = [2 * table.loc[name, "std"] for table in found]
        ax.errorbar(range(len(found)), values, deviations, fmt="o")
        ax.axhline(exact[name], color="black", linewidth=0.8)
        ax.set(title=name, xlabel="planned flights", xticks=range(len(found)))
        ax.margins(x=0.2)
    return figure


if __name__ == "__main__":
    main()
