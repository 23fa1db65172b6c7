"""Flights for tests: channels that move about their means, and all that sensors read of a motion."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from flight_columns import AIR, EULER, FORCES, RATES, SURFACES, VELOCITY
from numpy.random import default_rng
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from skdgp.dynamics import Aerodynamics, Aircraft, Turbulence, air_data

GRAVITY = 9.80665
GLIDER = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
TURBULENCE = Turbulence(np.array([0.5, 0.5, 0.35]), np.array([150.0, 150.0, 60.0]))
SENSED = [*FORCES, *RATES, *EULER, *AIR, *VELOCITY]
STEP = 1e-4  # of the differences of a motion [s]
SPEED = 22.0  # of a flight in circles, through the air [m/s]


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


def circling(scale=0.0, heading_error=0.0, gust=0.0, turns=2.0, seed=3):
    """Return a level flight of some turns in wind and gusts, whose nose points into its motion through the air."""
    time = np.arange(0, 120, 0.1)
    psi = 2 * np.pi * turns * time / time[-1]
    gusts = gust * default_rng(seed).standard_normal((2, len(time)))
    return pd.DataFrame(
        {
            "time": time,
            "airspeed": (1 + scale) * SPEED,
            "alpha": 0.05,
            "beta": 0.0,
            "phi": 0.0,
            "theta": 0.05,
            "psi": psi + heading_error,
            "v_north": SPEED * np.cos(psi) + 6.0 + gusts[0],
            "v_east": SPEED * np.sin(psi) - 3.0 + gusts[1],
            "v_down": 0.0,
        }
    )


def rms(error):
    """Return the root mean square over the rows."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def wrapped(angle):
    """Return an angle between -pi and pi."""
    return np.angle(np.exp(1j * angle))


def lasting(rng, shape, memory):
    """Return noise of variance 1 whose correlation falls by e in ``memory`` rows."""
    keep = np.exp(-1 / memory)
    noise = rng.normal(size=shape)
    noise[1:] *= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], noise, axis=0)


class Glider(NamedTuple):
    """An aircraft whose coefficients are linear, (n, 6) at regressors (n, 8), and paths with slopes of 10 % scatter."""

    aircraft: Aircraft
    names: list[str]
    level: np.ndarray  # (6,) at regressors of zero
    slopes: np.ndarray  # (6, 8)

    def model(self, slopes=None, *, has_paths=True, **options):
        """Return its aerodynamics, with other slopes."""
        slopes = self.slopes if slopes is None else slopes

        def paths(n_paths, random_state):
            factors = default_rng(random_state).normal(1.0, 0.1, (n_paths, 6, 8))
            drawn = factors * slopes

            def values(X):
                return self.level + X @ drawn.swapaxes(1, 2)

            def slopes_of_paths(X):
                return np.repeat(drawn[:, None], X.shape[1], axis=1)

            return values, slopes_of_paths

        options["sampler"] = paths if has_paths else None
        return Aerodynamics(lambda X: self.level + X @ slopes.T, self.names, **options)


LINEAR_GLIDER = Glider(
    Aircraft(
        name="glider", mass=12, inertia=[[1.1, 0, -0.2], [0, 2.3, 0], [-0.2, 0, 3.1]],
        wing_area=1.3, span=2.6, chord=0.55,
    ),
    ["alpha", "beta", "p_hat", "q_hat", "r_hat", *SURFACES],
    np.array([-0.03, 0, -0.3, 0, 0.02, 0]),
    np.array([
        [0.35, 0, 0, 0, 0, 0.02, 0, 0],
        [0, -0.5, 0.05, 0, 0.2, 0, 0.03, 0.1],
        [-4.5, 0, 0, -3.0, 0, -0.4, 0, 0],
        [0, -0.05, -0.4, 0, 0.1, 0, 0.1, 0.01],
        [-0.6, 0, 0, -9.0, 0, -1.0, 0, 0],
        [0, 0.08, -0.03, 0, -0.1, 0, 0, -0.06],
    ]),
)  # fmt: skip
