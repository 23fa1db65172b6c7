"""Flights for tests: channels that move about their means, and all that sensors read of a motion."""

import numpy as np
import pandas as pd
from numpy.random import default_rng
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from skdgp.dynamics import Aircraft, air_data

GRAVITY = 9.80665
GLIDER = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
SENSED = ["ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "airspeed", "alpha", "beta"]
SENSED += ["v_north", "v_east", "v_down"]
STEP = 1e-4  # of the differences of a motion [s]


def make_flight(channels, n=2400, step=0.025, *, width=20, seed=0):
    """Return a flight whose channels are random waves about a mean, with white noise.

    ``channels`` has mean, standard deviation of the wave and of the noise by names; waves are smoothed
    over ``width`` rows.
    """
    rng = default_rng(seed)
    columns = {"time": step * np.arange(n)}
    for names, (mean, spread, noise) in channels.items():
        for name in names.split():
            wave = gaussian_filter1d(rng.normal(size=n), width) if width else rng.normal(size=n)
            columns[name] = mean + spread * wave / wave.std() + rng.normal(0, noise, n)
    return pd.DataFrame(columns)


def flight_of_motion(time, attitude, velocity, wind=0.0, gravity=GRAVITY):
    """Return what perfect sensors read of a motion: rates and forces are its differences.

    ``attitude``, a rotation from body to NED, and ``velocity`` over the ground (n, 3) are functions of
    time; the wind is (n, 3).
    """
    before, now, after = (attitude(time + move) for move in (-STEP, 0.0, STEP))
    rates = (before.inv() * after).as_rotvec() / (2 * STEP)
    acceleration = (velocity(time + STEP) - velocity(time - STEP)) / (2 * STEP)
    force = now.inv().apply(acceleration - [0.0, 0.0, gravity])
    over_ground = velocity(time)
    air = air_data(now.inv().apply(over_ground - wind))
    sensed = np.column_stack([force, rates, now.as_euler("ZYX")[:, ::-1], *air, over_ground])
    return pd.DataFrame(sensed, columns=SENSED).assign(time=time)


def lasting(rng, shape, memory):
    """Return noise of variance 1 whose correlation falls by e in ``memory`` rows."""
    keep = np.exp(-1 / memory)
    noise = rng.normal(size=shape)
    noise[1:] *= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], noise, axis=0)
