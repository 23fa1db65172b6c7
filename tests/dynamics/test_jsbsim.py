"""This package beside JSBSim: accelerations under JSBSim's own loads.

JSBSim's Earth is round and turns, this package's is flat and rests. To its loads is added what else
acts on a body seen from an Earth that turns: gravity's direction where the aircraft is, the
Coriolis force, and the Earth's share of what gyroscopes feel. What is left is arithmetic.
"""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import body_to_ned, euler_to_quaternion, ned_to_body, rigid_body_derivative

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
EARTH_RATE = 7.292115e-5  # rad/s
SECONDS, RATE = 2.5, 1200  # s, Hz
# Integrators of JSBSim of fourth order; its default is Euler's method for rates and attitude
INTEGRATORS = {
    "rate/rotational": 5,
    "rate/translational": 5,
    "position/rotational": 7,
    "position/translational": 5,
}
# Sizes; from 0.5 s on, a second each way, smooth: a jump would cost any integrator an order
DOUBLETS = {"elevator": -0.08, "aileron": 0.25, "rudder": 0.3}


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
def flown(jsbsim_maker):
    """Return a flight of JSBSim's Cessna 172 with doublets of all surfaces, and the aircraft it was."""
    fdm = jsbsim_maker.started("c172p", RATE, 100.0)
    for name, method in INTEGRATORS.items():
        fdm[f"simulation/integrator/{name}"] = method
    names, sources, factors = zip(*columns(), strict=True)
    neutral = {surface: fdm[f"fcs/{surface}-cmd-norm"] for surface in DOUBLETS}
    rows = np.empty((round(SECONDS * RATE) + 1, len(names)))
    for k in range(len(rows)):
        doublet = np.sin(np.pi * np.clip(k / RATE - 0.5, 0.0, 2.0)) ** 3
        for surface, size in DOUBLETS.items():
            fdm[f"fcs/{surface}-cmd-norm"] = neutral[surface] + size * doublet
        fdm.run()
        rows[k] = [fdm[source] for source in sources]
    return pd.DataFrame(rows * factors, columns=names), jsbsim_maker.aircraft_of(fdm, "c172p")


def vectors(flight, start, axes="xyz"):
    return flight[[f"{start}{axis}" for axis in axes]].to_numpy()


def times(matrices, vectors):
    return np.einsum("nij,nj->ni", matrices, vectors)


def accelerations(flight, aircraft):
    """Return u_dot v_dot w_dot and p_dot q_dot r_dot, (n, 3) each, of a body over JSBSim's Earth at each sample."""
    latitude, longitude = flight["latitude"].to_numpy(), flight["longitude"].to_numpy()
    (s, c), (sl, cl) = ((np.sin(x), np.cos(x)) for x in (latitude, longitude))
    axes = [[-s * cl, -s * sl, c], [-sl, cl, 0 * s], [-c * cl, -c * sl, -s]]
    from_earth = np.moveaxis(np.array(axes), -1, 0)  # to north, east, down of the place
    earth_rate = EARTH_RATE * np.stack([c, 0 * s, -s], axis=-1)
    attitude = euler_to_quaternion(*flight[["phi", "theta", "psi"]].to_numpy().T)
    velocity, rates = (flight[[*axes]].to_numpy() for axes in ("uvw", "pqr"))
    state = np.hstack([np.zeros((len(flight), 3)), velocity, attitude, rates])
    radius = times(from_earth, vectors(flight, "earth_"))
    gravity = body_to_ned(attitude, vectors(flight, "weight_")) / aircraft.mass
    gravity -= np.cross(earth_rate, np.cross(earth_rate, radius))
    turning = ned_to_body(attitude, earth_rate)
    coriolis = -2.0 * np.cross(turning, velocity)
    force = vectors(flight, "aero_") + vectors(flight, "thrust_")
    force += aircraft.mass * (ned_to_body(attitude, gravity) + coriolis)
    inertial, inertia = rates + turning, aircraft.inertia
    moment = vectors(flight, "aero_", "lmn") + vectors(flight, "thrust_", "lmn")
    moment += np.cross(rates, rates @ inertia) - np.cross(inertial, inertial @ inertia)
    moment += np.cross(inertial, turning) @ inertia
    derivative = rigid_body_derivative(state, force, moment, aircraft, 0.0)
    return derivative[:, 3:6], derivative[:, 10:]


def test_accelerations_are_jsbsims_where_its_earth_is_accounted_for(flown):
    flight, aircraft = flown
    for found, names in zip(accelerations(flight, aircraft), ("uvw", "pqr"), strict=True):
        expected = flight[[f"{name}_dot" for name in names]]
        assert_allclose(found, expected, rtol=0, atol=1e-9)
