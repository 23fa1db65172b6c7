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
    Aerodynamics,
    FlightComputer,
    aerodynamic_coefficients,
    dryden_wind,
    simulate,
    stability_derivatives,
    trim,
)

AXES = {"elevator": 0.08, "aileron": 0.12, "rudder": 0.16}  # limits [rad]
GOAL = ["Cm_alpha", "Cm_q", "Cm_elevator", "Cl_p", "Cl_aileron", "Cn_beta", "Cn_r", "Cn_rudder"]
NAMES = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
NOISE = dict.fromkeys(("alpha", "beta", "phi", "theta", "psi"), 0.005) | dict.fromkeys("pqr", 0.002)
NOISE |= dict.fromkeys(("ax", "ay", "az"), 0.05) | {"airspeed": 0.3}
SPEED, ALTITUDE, PAUSE = 35.0, 200.0, 3.0
ENVELOPE = Envelope(bank=1.0, airspeed=(28.0, 42.0), altitude=120.0, growth=0.5)


def fly(truth, aircraft, train, seconds, seed):
    """Return the record of the true aircraft's sensors, held level by an autopilot, in gusts."""
    steady = trim(truth, aircraft, SPEED, altitude=ALTITUDE)

    def controls(time, state):
        held = {
            "elevator": 0.2 * (state["theta"] - steady.theta) + 0.1 * state["q"],
            "aileron": -0.06 * state["phi"] - 0.02 * state["p"],
        }
        return {
            name: value + held.get(name, 0.0) + train(name, time)
            for name, value in steady.controls.items()
        }

    wind = dryden_wind(seconds, SPEED, 140.0, wind_at_6m=4.0, span=aircraft.span, random_state=seed)
    flight = simulate(
        truth, aircraft, steady, FlightComputer(controls), 0.025, duration=seconds, air=wind
    )
    rng = np.random.default_rng(seed)
    noisy = {
        name: flight[name] + std * rng.standard_normal(len(flight)) for name, std in NOISE.items()
    }
    speed = aircraft.propeller.speed_at(flight["throttle"])
    return flight.assign(flight=f"flight {seed}", propeller_speed=speed, **noisy)


def learn(flights, aircraft):
    log = pd.concat(flights, ignore_index=True)
    regressor = DependentGPRegressor(structure="trend", max_iter=10)
    model = make_identification_pipeline(
        aircraft, regressors=NAMES, reconstruction="passthrough", regressor=regressor
    )
    return model.fit(log, aerodynamic_coefficients(log, aircraft))


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rounds", type=int, default=2, help="planned flights (default: %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="of each (default: %(default)s)"
    )
    parser.add_argument(
        "--output", default="closed_loop.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    example = load_example_flights(turbulence=0.0)
    aircraft = example.aircraft
    rates = {"p", "q", "r", "alpha_dot", "beta_dot"}
    names = [f"{name}_hat" if name in rates else name for name in example.regressor_names]
    truth = Aerodynamics(example.aerodynamics, names)

    gentle = [{axis: doublet(0.5, 0.4 * limit)} for axis, limit in AXES.items()] * 2
    train = wavetrain(gentle, pause=PAUSE)
    flights, trains, found = [fly(truth, aircraft, train, 32.0, 0)], [], []
    for number in range(options.rounds + 1):
        model = learn(flights, aircraft)
        steady = trim(truth, aircraft, SPEED, altitude=ALTITUDE)
        found.append(stability_derivatives(model, aircraft, steady).loc[GOAL, ["value", "std"]])
        if number < options.rounds:
            planned = plan(
                model, aircraft, trim(model, aircraft, SPEED, altitude=ALTITUDE), seconds=options.seconds,
                axes=list(AXES), goal=GOAL, limits=AXES, envelope=ENVELOPE,
            )  # fmt: skip
            print(planned.manoeuvres[["start", "name", "scale"]].round(2))
            trains.append(planned.train)
            flights.append(fly(truth, aircraft, trains[-1], options.seconds, number + 1))

    exact = stability_derivatives(truth, aircraft, steady)["value"]
    draw(trains, found, exact).savefig(options.output, dpi=120)
    print(options.output)


def draw(trains, found, exact):
    """Return the picture: inputs above, derivatives below."""
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    above, below = figure.subfigures(2, 1)
    for k, (ax, train) in enumerate(
        zip(np.atleast_1d(above.subplots(1, len(trains))), trains, strict=True)
    ):
        time = np.arange(0.0, train.duration + PAUSE, 0.02)
        for axis in AXES:
            ax.plot(time, np.rad2deg(train(axis, time)), label=axis, linewidth=0.8)
        ax.set(title=f"planned flight {k + 1}", xlabel="time [s]", ylabel="from trim [deg]")
    ax.legend(frameon=False, fontsize="small", loc="upper right")
    for ax, name in zip(below.subplots(2, 4).ravel(), GOAL, strict=True):
        values = [table.loc[name, "value"] for table in found]
        deviations = [2 * table.loc[name, "std"] for table in found]
        ax.errorbar(range(len(found)), values, deviations, fmt="o")
        ax.axhline(exact[name], color="black", linewidth=0.8)
        ax.set(
            title=name,
            xlabel="planned flights",
            xticks=range(len(found)),
            xlim=(-0.5, len(found) - 0.5),
        )
    return figure


if __name__ == "__main__":
    main()
