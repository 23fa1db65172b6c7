"""This package flown beside JSBSim: its accelerations, then trajectories under JSBSim's own loads.

JSBSim's Earth is round and turns, this package's is flat and rests. To its loads is added what else
acts on a body seen from an Earth that turns: gravity's direction where the aircraft is, the
Coriolis force, and the Earth's share of what gyroscopes feel. What is left is arithmetic.
"""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import (
    body_to_ned,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_matrix,
    rigid_body_derivative,
    rk4,
)

POSITION, VELOCITY, ATTITUDE, RATES = slice(3), slice(3, 6), slice(6, 10), slice(10, 13)
FOOT, POUND_FORCE = 0.3048, 4.4482216152605
EARTH_RATE = 7.292115e-5  # rad/s
SECONDS, RATE = 2.5, 1200  # s, Hz
RESTART = 2.0  # s
# Integrators of JSBSim of fourth order; its default is Euler's method for rates and attitude
INTEGRATORS = {
    "rate/rotational": 5,
    "rate/translational": 5,
    "position/rotational": 7,
    "position/translational": 5,
}
# From [s], size; a second each way, smooth: a jump would cost any integrator an order
DOUBLETS = {"elevator": (1.0, -0.08), "aileron": (4.0, 0.25), "rudder": (7.0, 0.3)}


def columns():
    """Yield the name, JSBSim's property and the factor to SI of each column."""
    for k, axis in enumerate("xyz"):
        moment, velocity, rate = "lmn"[k], "uvw"[k], "pqr"[k]
        yield f"aero_{axis}", f"forces/fb{axis}-aero-lbs", POUND_FORCE
        yield f"thrust_{axis}", f"forces/fb{axis}-prop-lbs", POUND_FORCE
        yield f"weight_{axis}", f"forces/fb{axis}-weight-lbs", POUND_FORCE
        yield f"aero_{moment}", f"moments/{moment}-aero-lbsft", POUND_FORCE * FOOT
        yield f"thrust_{moment}", f"moments/{moment}-prop-lbsft", POUND_FORCE * FOOT
        yield velocity, f"velocities/{velocity}-fps", FOOT
        yield f"{velocity}_dot", f"accelerations/{velocity}dot-ft_sec2", FOOT
        yield rate, f"velocities/{rate}-rad_sec", 1.0
        yield f"{rate}_dot", f"accelerations/{rate}dot-rad_sec2", 1.0
        yield f"earth_{axis}", f"position/ecef-{axis}-ft", FOOT
    for angle in ("phi", "theta", "psi"):
        yield angle, f"attitude/{angle}-rad", 1.0
    yield "latitude", "position/lat-geod-rad", 1.0
    yield "longitude", "position/long-gc-rad", 1.0


@pytest.fixture(scope="module")
def flown(jsbsim_benchmark):
    """Return a flight of JSBSim's Cessna 172 with doublets of all surfaces, and the aircraft it was."""
    fdm = jsbsim_benchmark.started("c172p", RATE, 100.0)
    for name, method in INTEGRATORS.items():
        fdm[f"simulation/integrator/{name}"] = method
    names, sources, factors = zip(*columns(), strict=True)
    neutral = {surface: fdm[f"fcs/{surface}-cmd-norm"] for surface in DOUBLETS}
    rows = np.empty((round(SECONDS * RATE) + 1, len(names)))
    for k in range(len(rows)):
        for surface, (start, size) in DOUBLETS.items():
            phase = np.pi * min(max(k / RATE - start, 0.0), 2.0)
            fdm[f"fcs/{surface}-cmd-norm"] = neutral[surface] + size * np.sin(phase) ** 3
        fdm.run()
        rows[k] = [fdm[source] for source in sources]
    return pd.DataFrame(rows * factors, columns=names), jsbsim_benchmark.aircraft_of(fdm, "c172p")


def vectors(flight, start, axes="xyz"):
    return flight[[f"{start}{axis}" for axis in axes]].to_numpy()


def times(matrices, vectors):
    return np.einsum("nij,nj->ni", matrices, vectors)


class Earth:
    """JSBSim's Earth at each sample of a flight, in north, east, down of the place, and the loads there."""

    def __init__(self, flight, aircraft):
        self.aircraft = aircraft
        latitude, longitude = flight["latitude"].to_numpy(), flight["longitude"].to_numpy()
        (s, c), (sl, cl) = ((np.sin(x), np.cos(x)) for x in (latitude, longitude))
        axes = [[-s * cl, -s * sl, c], [-sl, cl, 0 * s], [-c * cl, -c * sl, -s]]
        self.axes = np.moveaxis(np.array(axes), -1, 0)  # from axes fixed in the Earth
        self.rate = EARTH_RATE * np.stack([c, 0 * s, -s], axis=-1)
        attitude = euler_to_quaternion(*flight[["phi", "theta", "psi"]].to_numpy().T)
        velocity, rates = (flight[[*axes]].to_numpy() for axes in ("uvw", "pqr"))
        self.state = np.hstack([np.zeros((len(flight), 3)), velocity, attitude, rates])
        self.place = vectors(flight, "earth_")
        self.loads = vectors(flight, "aero_", "xyzlmn") + vectors(flight, "thrust_", "xyzlmn")
        weight = body_to_ned(attitude, vectors(flight, "weight_")) / aircraft.mass
        radius = times(self.axes, self.place)
        self.gravity = weight - np.cross(self.rate, np.cross(self.rate, radius))

    def turn(self, start, now):
        """Return the rotations (n, 3, 3) from north, east, down at the samples ``now`` to those at ``start``."""
        return np.einsum("nij,nkj->nik", self.axes[start], self.axes[now])

    def derivative(self, state, loads, gravity, earth_rate):
        """Return d state / dt under the aerodynamic and propulsive loads (..., 6), gravity and the turning Earth."""
        turning = ned_to_body(state[..., ATTITUDE], earth_rate)
        coriolis = -2.0 * np.cross(turning, state[..., VELOCITY])
        force = self.aircraft.mass * (ned_to_body(state[..., ATTITUDE], gravity) + coriolis)
        rates = state[..., RATES]
        inertial = rates + turning
        inertia = self.aircraft.inertia
        moment = np.cross(rates, rates @ inertia) - np.cross(inertial, inertial @ inertia)
        moment += np.cross(inertial, turning) @ inertia
        total = loads[..., :3] + force, loads[..., 3:] + moment
        return rigid_body_derivative(state, *total, self.aircraft, 0.0)


def test_accelerations_are_jsbsims_where_its_earth_is_accounted_for(flown):
    flight, aircraft = flown
    earth = Earth(flight, aircraft)
    found = earth.derivative(earth.state, earth.loads, earth.gravity, earth.rate)
    for part, names in ((VELOCITY, "uvw"), (RATES, "pqr")):
        expected = flight[[f"{name}_dot" for name in names]]
        assert_allclose(found[:, part], expected, rtol=0, atol=1e-9)


def test_trajectories_are_jsbsims_from_restarts_at_its_state(flown):
    flight, aircraft = flown
    earth, steps = Earth(flight, aircraft), round(RESTART * RATE)
    starts = np.arange(0, len(flight) - steps, steps)

    def derivative(t, state):
        now = starts + round(t * RATE)
        gravity = times(earth.turn(starts, now), earth.gravity[now])
        return earth.derivative(state, earth.loads[now], gravity, earth.rate[starts])

    samples = np.arange(0, steps + 1, 2)  # a step of two: RK4 asks for the loads between as well
    for k, ours in zip(samples, rk4(derivative, earth.state[starts], samples / RATE), strict=True):
        now = starts + k
        theirs = earth.state[now]
        rotation = earth.turn(starts, now) @ quaternion_to_matrix(theirs[:, ATTITUDE])
        moved = times(earth.axes[starts], earth.place[now] - earth.place[starts])
        velocity = body_to_ned(ours[:, ATTITUDE], ours[:, VELOCITY])
        turned = (rotation - quaternion_to_matrix(ours[:, ATTITUDE])).reshape(-1, 9) / np.sqrt(2.0)
        errors = [
            ours[:, POSITION] - moved,  # m
            velocity - times(rotation, theirs[:, VELOCITY]),  # m/s
            turned,  # rad
            ours[:, RATES] - theirs[:, RATES],  # rad/s
        ]
        assert max(np.linalg.norm(error, axis=1).max() for error in errors) < 1e-5
