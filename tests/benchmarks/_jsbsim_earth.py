"""This package flown beside JSBSim: its accelerations, then trajectories under JSBSim's own loads.

JSBSim's Earth is round and turns, this package's is flat and rests. To its loads is added what else
acts on a body seen from an Earth that turns: gravity's direction where the aircraft is, the
Coriolis force, and the Earth's share of what gyroscopes feel. What is left is arithmetic.
"""

import numpy as np
from _jsbsim_flight import EARTH_RATE, earth_to_ned

from skdgp.dynamics import (
    body_to_ned,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_matrix,
    rigid_body_derivative,
    rk4,
)
from skdgp.dynamics._rigid_body import ATTITUDE, POSITION, RATES, VELOCITY, gyroscopic_moment

CHANNELS = ("u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot")


class Earth:
    """What JSBSim's Earth does at each sample of a flight, in north, east, down of the place."""

    def __init__(self, flight, aircraft):
        latitude = flight["latitude"].to_numpy()
        self.axes = earth_to_ned(latitude, flight["longitude"].to_numpy())
        self.rate = EARTH_RATE * np.stack(
            [np.cos(latitude), 0 * latitude, -np.sin(latitude)], axis=-1
        )
        self.attitude = euler_to_quaternion(*flight[["phi", "theta", "psi"]].to_numpy().T)
        self.place = _vector(flight, "earth_", "xyz")
        radius = _times(self.axes, self.place)
        weight = body_to_ned(self.attitude, _vector(flight, "weight_", "xyz")) / aircraft.mass
        self.gravity = weight - np.cross(self.rate, np.cross(self.rate, radius))

    def turn(self, start, now):
        """Return the rotations (n, 3, 3) from north, east, down at the samples ``now`` to those at ``start``."""
        return np.einsum("nij,nkj->nik", self.axes[start], self.axes[now])


def apparent_loads(state, gravity, earth_rate, aircraft):
    """Return force and moment of gravity, (..., 3) in NED, and of the turning of the Earth."""
    turning = ned_to_body(state[..., ATTITUDE], earth_rate)
    rates = state[..., RATES]
    force = ned_to_body(state[..., ATTITUDE], gravity) - 2.0 * np.cross(
        turning, state[..., VELOCITY]
    )
    inertial = rates + turning
    moment = gyroscopic_moment(rates, aircraft) - gyroscopic_moment(inertial, aircraft)
    return aircraft.mass * force, moment + np.cross(inertial, turning) @ aircraft.inertia


def derivative_of(state, loads, gravity, earth_rate, aircraft):
    """Return d state / dt under the aerodynamic and propulsive loads (..., 6)."""
    force, moment = loads[..., :3], loads[..., 3:]
    more_force, more_moment = apparent_loads(state, gravity, earth_rate, aircraft)
    return rigid_body_derivative(state, force + more_force, moment + more_moment, aircraft, 0.0)


def acceleration_errors(flight, aircraft):
    """Return the errors (n, 6) of this package's accelerations against JSBSim's."""
    earth, loads = Earth(flight, aircraft), _loads(flight)
    state = np.hstack(
        [
            np.zeros((len(flight), 3)),
            flight[["u", "v", "w"]],
            earth.attitude,
            flight[["p", "q", "r"]],
        ]
    )
    found = derivative_of(state, loads, earth.gravity, earth.rate, aircraft)
    return np.hstack([found[:, VELOCITY], found[:, RATES]]) - flight[list(CHANNELS)].to_numpy()


def trajectory(flight, aircraft, horizon):
    """Return the largest errors within ``horizon`` [s] of restarts at JSBSim's own state."""
    earth, loads = Earth(flight, aircraft), _loads(flight)
    rate = round(1.0 / flight["time"][1])
    steps = round(horizon * rate)
    starts = np.arange(0, len(flight) - steps, steps)
    velocity, rates = flight[["u", "v", "w"]].to_numpy(), flight[["p", "q", "r"]].to_numpy()
    state = np.hstack(
        [np.zeros((len(starts), 3)), velocity[starts], earth.attitude[starts], rates[starts]]
    )

    def derivative(t, state):
        now = starts + round(t * rate)
        gravity = _times(earth.turn(starts, now), earth.gravity[now])
        return derivative_of(state, loads[now], gravity, earth.rate[starts], aircraft)

    def missed(k, ours):
        now = starts + k
        rotation = earth.turn(starts, now) @ quaternion_to_matrix(earth.attitude[now])
        turned = rotation - quaternion_to_matrix(ours[:, ATTITUDE])
        return {
            "position [m]": ours[:, POSITION]
            - _times(earth.axes[starts], earth.place[now] - earth.place[starts]),
            "velocity [m/s]": body_to_ned(ours[:, ATTITUDE], ours[:, VELOCITY])
            - _times(rotation, velocity[now]),
            "attitude [rad]": turned.reshape(-1, 9) / np.sqrt(2.0),
            "rates [rad/s]": ours[:, RATES] - rates[now],
        }

    samples = np.arange(0, steps + 1, 2)  # a step of two: RK4 asks for the loads between as well
    flown = rk4(derivative, state, samples / rate)
    errors = [missed(k, ours) for k, ours in zip(samples, flown, strict=True)]
    return {
        name: float(max(np.linalg.norm(each[name], axis=1).max() for each in errors))
        for name in errors[0]
    }


def _vector(flight, start, axes):
    return flight[[f"{start}{axis}" for axis in axes]].to_numpy()


def _loads(flight):
    return _vector(flight, "aero_", "xyzlmn") + _vector(flight, "thrust_", "xyzlmn")


def _times(matrices, vectors):
    return np.einsum("nij,nj->ni", matrices, vectors)
