"""An aircraft with a full inertia tensor, and a smooth flight of it in wind with known coefficients."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from made_flights import LINEAR_GLIDER
from scipy.integrate import solve_ivp

from skdgp.dynamics import Air, ThrustLine, air_velocity, euler_to_quaternion, simulate

GRAVITY = 9.79
SENSED = (
    "time airspeed alpha beta density north east down v_north v_east v_down phi theta psi p q r "
    "p_dot q_dot r_dot ax ay az"
)
START = {
    "airspeed": 24.0, "alpha": 0.07, "beta": -0.04, "phi": 0.3, "theta": 0.1, "psi": 2.0, "p": 0.2, "q": 0.05,
    "r": -0.1, "north": 5.0, "east": -7.0, "altitude": 120.0,
}  # fmt: skip


@pytest.fixture(scope="session")
def aircraft():
    return replace(
        LINEAR_GLIDER.aircraft,
        inertia=[[1.1, -0.12, 0.21], [-0.12, 2.3, 0.09], [0.21, 0.09, 2.9]],
        thrust_line=ThrustLine(position=(-0.4, 0.05, -0.15), direction=(0.98, 0.03, -0.08)),
    )


def commands(t, state=None):
    """Surfaces never rest."""
    return {
        "elevator": 0.05 * np.sin(1.7 * t + 0.4), "aileron": 0.04 * np.cos(1.3 * t),
        "rudder": 0.05 * np.sin(2.1 * t + 1.0), "thrust": 14.0 + 3.0 * np.sin(0.9 * t),
    }  # fmt: skip


@pytest.fixture(scope="session")
def state():
    """No angle and no rate is zero."""
    velocity, attitude = air_velocity(36.0, 0.1, 0.04), euler_to_quaternion(0.4, 0.15, 1.0)
    return np.concatenate([[0.0, 0.0, -200.0], velocity, attitude, [0.2, 0.1, 0.15]])


@pytest.fixture(scope="session")
def flown(aircraft, glider):
    """One flight of 6 s at 100 Hz: every angle, rate and product of inertia in play, air not at rest."""
    air = Air([3.0, -2.0, 0.7], density=1.1, gravity=GRAVITY)
    t = np.arange(0.0, 6.0, 0.005)
    schedule = pd.DataFrame({"time": t, **commands(t)})
    return simulate(glider.model(), aircraft, START, schedule, dt=0.01, duration=5.99, air=air)


@pytest.fixture(scope="session")
def simulated(flown, aircraft):
    """What a perfect logger has of it."""
    table = flown[SENSED.split()].copy()
    loads = aircraft.thrust_line.loads(flown["thrust"])
    table[[f"thrust_{axis}" for axis in "xyzlmn"]] = np.hstack(loads)
    return table


@pytest.fixture(scope="session")
def true_coefficients(flown):
    return flown[COEFFICIENTS].to_numpy()


@pytest.fixture(scope="session")
def gravity():
    return GRAVITY


@pytest.fixture(scope="session")
def followed():
    """Return a function to the deflections of servos by a command, a function of time, of an independent solver."""

    def followed(command, times, lag, delay=0.0, rate_limit=np.inf):
        def rate(t, delta):
            return np.clip((command(max(t - delay, 0.0)) - delta) / lag, -rate_limit, rate_limit)

        ends = (0, times[-1])
        return solve_ivp(rate, ends, [command(0.0)], t_eval=times, max_step=1e-3, rtol=1e-6).y[0]

    return followed
