"""The motion of the example aircraft: gusts, and the fixed point of alpha_dot and beta_dot."""

import numpy as np

from skdgp.datasets._example_flights import brumby_motion
from skdgp.dynamics import euler_to_quaternion, ned_to_body
from skdgp.dynamics._air import Gusts, GustyAir, LocalAir

STATE = np.r_[
    120.0, -40.0, -210.0, 34.0, -1.5, 3.4, euler_to_quaternion(0.5, 0.1, 2.0), 0.3, 0.12, -0.15
]
CONTROLS = {"elevator": -0.025, "aileron": 0.065, "rudder": 0.08, "propeller_speed": 640.0}
WIND = np.array([3.0, -2.0, 0.5])
GUST = Gusts(np.array([0.7, -0.9, 0.5]), np.array([1.0, 2.0, -1.5]), np.array([0.05, 0.04, -0.06]))
STILL = Gusts(*np.zeros((3, 3)))
MOTION = brumby_motion()


def at(state, wind=WIND, gust=GUST, slopes=(0.0, 0.0)):
    """One pass of the fixed point, from a guess of alpha_dot and beta_dot."""
    implicit = np.zeros((*state.shape[:-1], 8))
    implicit[..., :2] = slopes
    air = GustyAir(lambda stage, state: LocalAir(wind), Gusts(*(part[None] for part in gust)))
    return MOTION.at(state, CONTROLS, air(0, state), implicit)


def settled(state, wind=WIND, gust=GUST):
    slopes = (0.0, 0.0)
    for _ in range(12):
        now = at(state, wind, gust, slopes)
        slopes = now.implicit[..., :2]
    return now


def test_steady_gust_acts_like_wind():
    as_wind = settled(STATE, gust=STILL)
    steady = GUST._replace(
        velocity=ned_to_body(STATE[6:10], WIND), rates=np.zeros(3),
        # A body-fixed gust that follows a steady wind turns against the aircraft.
        acceleration=-np.cross(STATE[10:13], ned_to_body(STATE[6:10], WIND)),
    )  # fmt: skip
    as_gust = settled(STATE, wind=np.zeros(3), gust=steady)
    np.testing.assert_allclose(as_gust.derivative, as_wind.derivative, atol=1e-12)
    np.testing.assert_allclose(as_gust.implicit, as_wind.implicit, atol=1e-12)


def test_air_that_turns_with_the_aircraft_takes_its_damping_away():
    turning = GUST._replace(velocity=np.zeros(3), acceleration=np.zeros(3), rates=STATE[10:13])
    unturned = np.r_[STATE[:10], 0.0, 0.0, 0.0]
    with_air = at(STATE, gust=turning, slopes=(0.02, -0.03)).coefficients
    without = at(unturned, gust=STILL, slopes=(0.02, -0.03)).coefficients
    np.testing.assert_allclose(with_air, without, atol=1e-15)
