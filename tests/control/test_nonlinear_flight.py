"""Gain margins in flight: the nonlinear example aircraft under PX4's roll and pitch loops."""

from collections import deque

import numpy as np
import pytest

from skdgp.control import autopilot_loops, margins
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Simulator, linearize, trim

STEP = 0.004  # s
DELAYED = 12  # steps
DELAY = (DELAYED + 0.5) * STEP  # a held command is late by half a step
AIRSPEED = 35.0
FULL = 0.42
# proportional and integral gain of the rate, time constant of the attitude
GAINS = {"aileron": (0.1, 0.1, 0.4), "elevator": (0.2, 0.3, 0.4)}
MOTION = {"aileron": ("p", "phi"), "elevator": ("q", "theta")}
PX4 = {
    "FW_RR_P": 0.1, "FW_RR_I": 0.1, "FW_RR_FF": 0.0, "FW_R_TC": 0.4,
    "FW_PR_P": 0.2, "FW_PR_I": 0.3, "FW_PR_FF": 0.0, "FW_P_TC": 0.4,
    "FW_AIRSPD_STALL": 25.0, "FW_AIRSPD_TRIM": AIRSPEED, "FW_AIRSPD_MAX": 50.0,
    "IMU_GYRO_CUTOFF": 0.0, "IMU_DGYRO_CUTOFF": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def flown():
    """Return the true model, its aircraft, a trim, and the linear model there."""
    data = load_example_flights(duration=1.0)
    model = data.truth
    steady = trim(model, data.aircraft, AIRSPEED, altitude=100.0)
    return model, data.aircraft, steady, linearize(model, data.aircraft, steady, delay=DELAY)


def rates_of(flown, factors):
    """Return the rates (n, 2) of a flight of 4 s under both loops, with each gain times its factor."""
    model, aircraft, steady, linear = flown
    simulator = Simulator(model, aircraft, STEP)
    level = simulator.reset(steady)
    state = level
    scale = 1.225 / linear.density  # of equivalent airspeed, squared
    integral = dict.fromkeys(GAINS, 0.0)
    kick = {"aileron": 0.01, "elevator": 0.01}
    commands = deque([kick] * DELAYED)
    rates = []
    for _ in range(round(4.0 / STEP)):
        command = {}
        for surface, (proportional, of_integral, time_constant) in GAINS.items():
            rate, angle = MOTION[surface]
            error = (level[angle] - state[angle]) / time_constant - state[rate]
            integral[surface] += error * STEP
            output = proportional * error + of_integral * integral[surface]
            sign = np.sign(linear.B.loc[rate, surface])
            command[surface] = sign * FULL * factors[surface] * scale * output
        commands.append(command)
        controls = dict(steady.controls)
        for surface, deflection in commands.popleft().items():
            controls[surface] += deflection
        state = simulator.step(controls)
        rates.append([state["p"], state["q"]])
    return np.abs(rates)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "loop", "column"), [("aileron", "roll", 0), ("elevator", "pitch", 1)]
)
def test_oscillations_decay_below_the_gain_margin_and_grow_above(flown, surface, loop, column):
    margin = margins(flown[3], autopilot_loops(PX4, dict.fromkeys(GAINS, FULL)))["value"][loop][
        "gain"
    ]
    later = {}
    for part in (0.97, 1.03):
        factors = dict.fromkeys(GAINS, 1.0) | {surface: part * 10 ** (margin / 20)}
        rates = rates_of(flown, factors)[:, column]
        third = len(rates) // 3
        later[part] = rates[-third:].max() / rates[third:-third].max()
    assert later[0.97] < 0.9 < 1.1 < later[1.03]
