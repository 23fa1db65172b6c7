"""An aircraft with a full inertia tensor, and a smooth flight of it in wind with known coefficients."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import (
    Aircraft,
    ThrustLine,
    aerodynamic_loads,
    air_data,
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_euler,
    rigid_body_derivative,
    rk4,
)

WIND = np.array([3.0, -2.0, 0.7])
DENSITY = 1.1
GRAVITY = 9.79


@pytest.fixture(scope="session")
def aircraft():
    return Aircraft(
        name="test",
        mass=11.0,
        inertia=[[1.1, -0.12, 0.21], [-0.12, 2.3, 0.09], [0.21, 0.09, 2.9]],
        wing_area=1.3,
        span=2.6,
        chord=0.55,
        thrust_line=ThrustLine(position=(-0.4, 0.05, -0.15), direction=(0.98, 0.03, -0.08)),
    )


def coefficients_at(t, airspeed, alpha, beta, rates, aircraft):
    """Coefficients (..., 6) of a stable aircraft whose surfaces never rest."""
    t = np.asarray(t, dtype=float)
    p, q, r = np.moveaxis(rates * aircraft.moment_lengths / (2 * airspeed[..., None]), -1, 0)
    elevator, aileron, rudder = (
        0.05 * np.sin(1.7 * t + 0.4),
        0.04 * np.cos(1.3 * t),
        0.05 * np.sin(2.1 * t + 1.0),
    )
    return np.stack(
        [
            -0.03 + 0.3 * alpha**2,
            -0.5 * beta + 0.1 * p + 0.2 * rudder,
            -0.1 - 4.0 * alpha - 0.2 * elevator,
            -0.03 * beta - 0.4 * p + 0.08 * r + 0.1 * aileron,
            0.03 - 0.5 * alpha - 8.0 * q - 0.6 * elevator,
            0.06 * beta - 0.03 * p - 0.15 * r - 0.05 * rudder,
        ],
        axis=-1,
    )


def thrust_at(t):
    return 14.0 + 3.0 * np.sin(0.9 * np.asarray(t, dtype=float))


def loads_at(t, state, aircraft):
    """Return force (..., 3), moment (..., 3), airspeed, alpha, beta at the states."""
    wind = ned_to_body(state[..., 6:10], WIND)
    airspeed, alpha, beta = air_data(state[..., 3:6] - wind)
    coefficients = coefficients_at(t, airspeed, alpha, beta, state[..., 10:], aircraft)
    force, moment = aerodynamic_loads(coefficients, airspeed, DENSITY, aircraft)
    push, twist = aircraft.thrust_line.loads(thrust_at(t))
    return force + push, moment + twist, airspeed, alpha, beta


@pytest.fixture(scope="session")
def simulated(aircraft):
    """One flight of 6 s at 100 Hz: every angle, rate and product of inertia in play, air not at rest."""
    time = np.arange(0, 6, 0.01)
    quaternion = euler_to_quaternion(0.3, 0.1, 2.0)
    ground = air_velocity(24.0, 0.07, -0.04) + ned_to_body(quaternion, WIND)
    start = np.concatenate([[5.0, -7.0, -120.0], ground, quaternion, [0.2, 0.05, -0.1]])

    def rate(t, state):
        force, moment, *_ = loads_at(t, state, aircraft)
        return rigid_body_derivative(state, force, moment, aircraft, GRAVITY)

    fine = np.linspace(time[0], time[-1], 4 * (len(time) - 1) + 1)
    states = rk4(rate, start, fine)[::4]
    force, moment, airspeed, alpha, beta = loads_at(time, states, aircraft)
    push, twist = aircraft.thrust_line.loads(thrust_at(time))
    derivative = rigid_body_derivative(states, force, moment, aircraft, GRAVITY)
    table = pd.DataFrame(
        {"time": time, "airspeed": airspeed, "alpha": alpha, "beta": beta, "density": DENSITY}
    )
    table[["north", "east", "down"]] = states[:, :3]
    table[["v_north", "v_east", "v_down"]] = body_to_ned(states[:, 6:10], states[:, 3:6])
    table[["phi", "theta", "psi"]] = quaternion_to_euler(states[:, 6:10])
    table[["p", "q", "r"]] = states[:, 10:]
    table[["p_dot", "q_dot", "r_dot"]] = derivative[:, 10:]
    table[["ax", "ay", "az"]] = force / aircraft.mass
    table[["thrust_x", "thrust_y", "thrust_z"]] = push
    table[["thrust_l", "thrust_m", "thrust_n"]] = twist
    return table


@pytest.fixture(scope="session")
def true_coefficients(simulated, aircraft):
    air = (simulated[name].to_numpy() for name in ("airspeed", "alpha", "beta"))
    return coefficients_at(simulated["time"], *air, simulated[["p", "q", "r"]].to_numpy(), aircraft)


@pytest.fixture(scope="session")
def gravity():
    return GRAVITY
