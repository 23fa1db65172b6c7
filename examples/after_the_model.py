"""
After the model
===============

Learn the example aircraft, tune an autopilot, and fly it::

    python examples/after_the_model.py

The gains of PX4's roll and pitch loops become the largest with 6 dB and 45 deg in 95 % of the aircraft
that the posterior holds. Some of these aircraft fly a step of the bank angle with the gains before
and after. Needs matplotlib: pip install "skdgp[plot]".
"""

import argparse

import numpy as np
from matplotlib.figure import Figure

from skdgp import make_identification_pipeline
from skdgp.control import autopilot_loops, margins, suggest_gains
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Air,
    aerodynamic_coefficients,
    linearize,
    simulate,
    trajectory_bands,
    trim,
)

FULL = {"aileron": 0.42, "elevator": 0.42}
SLOW_GAINS = {
    "FW_RR_P": 0.05, "FW_RR_I": 0.05, "FW_RR_FF": 0.1, "FW_R_TC": 0.5,
    "FW_PR_P": 0.05, "FW_PR_I": 0.05, "FW_PR_FF": 0.1, "FW_P_TC": 0.5,
    "FW_AIRSPD_STALL": 25.0, "FW_AIRSPD_TRIM": 35.0, "FW_AIRSPD_MAX": 50.0,
    "IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0,
}  # fmt: skip
AIRSPEED, ALTITUDE, BANK = 35.0, 200.0, np.deg2rad(20.0)
STEP, DELAY = 0.02, 0.02


class Autopilot:
    """Roll and pitch loops, for many aircraft at once: called once a step with their channels."""

    def __init__(self, loops, steady, linear):
        self.loops = {loop.control: loop for loop in loops}
        self.steady = steady
        self.signs = {
            "aileron": np.sign(linear.B.loc["p", "aileron"]),
            "elevator": np.sign(linear.B.loc["q", "elevator"]),
        }
        self.integrals = {"aileron": 0.0, "elevator": 0.0}

    def __call__(self, t, state):
        wanted = BANK if t >= 1.0 else 0.0
        roll = self._output("aileron", wanted - state["phi"], state["p"])
        pitch = self._output("elevator", self.steady.theta - state["theta"], state["q"])
        controls = dict(self.steady.controls)
        controls["aileron"] = controls["aileron"] + roll
        controls["elevator"] = controls["elevator"] + pitch
        return controls

    def _output(self, control, error, rate):
        """Return the deflection for an error of the attitude and a rate."""
        loop = self.loops[control]
        commanded = error / loop.time_constant
        self.integrals[control] = self.integrals[control] + STEP * (commanded - rate)
        output = loop.P * (commanded - rate) + loop.I * self.integrals[control]
        output = output + loop.FF * commanded
        return self.signs[control] * loop.full * np.clip(output, -1.0, 1.0)


def fly(model, aircraft, loops, steady, linear, n_paths):
    """Return bands of flights with a step of the bank angle, each of another aircraft of the posterior."""
    law = Autopilot(loops, steady, linear)
    calm = Air(gusts=None, drift=False)
    options = {"dt": STEP, "duration": 6.0, "air": calm, "n_paths": n_paths}
    return trajectory_bands(simulate(model, aircraft, steady, law, **options))


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--samples", type=int, default=None, help="rows to learn from (default: all)"
    )
    parser.add_argument(
        "--paths", type=int, default=100, help="aircraft of the posterior (default: %(default)s)"
    )
    parser.add_argument("--output", default="after.png", help="the picture (default: %(default)s)")
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    aircraft = flights.aircraft
    Y = aerodynamic_coefficients(flights.train, aircraft)
    model = make_identification_pipeline(aircraft, samples=options.samples or "all")
    model.set_params(dependentgpregressor__random_state=0)
    model.fit(flights.train, Y)

    steady = trim(model, aircraft, AIRSPEED, altitude=ALTITUDE)
    linear = linearize(model, aircraft, steady, n_paths=options.paths, delay=DELAY)

    loops = autopilot_loops(SLOW_GAINS, FULL)
    print("margins before\n", margins(linear, loops).round(2), "\n")
    better = suggest_gains(linear, loops)
    print("margins after\n", margins(linear, better).round(2), "\n")
    for loop in better:
        print({name: round(value, 4) for name, value in loop.parameters.items()})
    before, after = (
        fly(model, aircraft, chosen, steady, linear, options.paths) for chosen in (loops, better)
    )

    figure = Figure(figsize=(6, 4.5), layout="constrained")
    bank = figure.subplots()
    for bands, name in ((before, "gains before"), (after, "gains suggested")):
        low, high = np.rad2deg(bands["phi_low"]), np.rad2deg(bands["phi_high"])
        bank.fill_between(bands["time"], low, high, alpha=0.3)
        bank.plot(bands["time"], np.rad2deg(bands["phi"]), label=name)
    bank.axhline(np.rad2deg(BANK), color="k", linewidth=0.5)
    bank.set(xlabel="time [s]", ylabel="bank angle [deg], 95 %")
    bank.legend()
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()
