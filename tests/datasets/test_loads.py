"""The instant's loads: the air's motion, and the fixed point of alpha_dot and beta_dot."""

import numpy as np
import pytest

from skdgp.datasets._loads import loads
from skdgp.dynamics import euler_to_quaternion, ned_to_body, standard_density
from skdgp.dynamics._simulation.gusts import Gusts

STATE = np.r_[120.0, -40.0, -210.0, 34.0, -1.5, 3.4, euler_to_quaternion(0.5, 0.1, 2.0), 0.3, 0.12, -0.15]
CONTROLS = np.array([0.04, -0.09, 0.08, 640.0])
WIND = np.array([3.0, -2.0, 0.5])
GUST = Gusts(np.array([0.7, -0.9, 0.5]), np.array([1.0, 2.0, -1.5]), np.array([0.05, 0.04, -0.06]))
STILL = Gusts(*np.zeros((3, 3)))
ZERO = (np.float64(0.0), np.float64(0.0))


def settled(state, controls=CONTROLS, wind=WIND, gust=GUST):
    slopes = ZERO
    for _ in range(12):
        now = loads(state, controls, wind, gust, slopes)
        slopes = now.slopes
    return now


def test_fixed_point_contracts_seventyfold():
    truth = np.array(settled(STATE).slopes)
    first, second = (np.array(loads(STATE, CONTROLS, WIND, GUST, slopes).slopes) for slopes in (ZERO, truth + 0.5))
    assert (abs(first - truth) < abs(truth) / 70).all()
    assert (abs(second - truth) < 0.5 / 70).all()


def test_slopes_are_derivatives_of_air_data_along_the_motion():
    """A short flight ahead and back, the gust growing at its rate, the wind steady over the earth."""
    now, dt = settled(STATE), 1e-5
    ahead, back = (
        loads(
            STATE + h * now.derivative, CONTROLS, WIND,
            GUST._replace(velocity=GUST.velocity + h * GUST.acceleration), now.slopes,
        )
        for h in (dt, -dt)
    )  # fmt: skip
    assert (ahead.alpha - back.alpha) / (2 * dt) == pytest.approx(now.slopes[0], abs=1e-7)
    assert (ahead.beta - back.beta) / (2 * dt) == pytest.approx(now.slopes[1], abs=1e-7)


def test_steady_gust_acts_like_wind():
    as_wind = settled(STATE, gust=STILL)
    steady = GUST._replace(
        velocity=ned_to_body(STATE[6:10], WIND), rates=np.zeros(3),
        # A body-fixed gust that follows a steady wind turns against the aircraft.
        acceleration=-np.cross(STATE[10:13], ned_to_body(STATE[6:10], WIND)),
    )  # fmt: skip
    as_gust = settled(STATE, wind=np.zeros(3), gust=steady)
    np.testing.assert_allclose(as_gust.derivative, as_wind.derivative, atol=1e-12)
    np.testing.assert_allclose(as_gust.slopes, as_wind.slopes, atol=1e-12)


def test_air_that_turns_with_the_aircraft_takes_its_damping_away():
    turning = GUST._replace(velocity=np.zeros(3), acceleration=np.zeros(3), rates=STATE[10:13])
    unturned = np.r_[STATE[:10], 0.0, 0.0, 0.0]
    slopes = (0.02, -0.03)
    with_air = loads(STATE, CONTROLS, WIND, turning, slopes).coefficients
    np.testing.assert_allclose(with_air, loads(unturned, CONTROLS, WIND, STILL, slopes).coefficients, atol=1e-15)


def test_batch_equals_one_by_one():
    states = np.stack([STATE, STATE + 0.01])
    batch = loads(states, np.stack([CONTROLS, CONTROLS]), np.stack([WIND, WIND]), GUST, (np.zeros(2), np.zeros(2)))
    for k in range(2):
        alone = loads(states[k], CONTROLS, WIND, GUST, ZERO)
        np.testing.assert_allclose(batch.derivative[k], alone.derivative, atol=1e-12)


def test_density_is_the_standard_atmospheres():
    """Thrust at the same speeds goes with the density at the altitude flown."""
    now, high = settled(STATE), settled(STATE - [0, 0, 2000.0, *np.zeros(10)])
    ratio = standard_density(2210.0) / standard_density(210.0)
    np.testing.assert_allclose(high.thrust_force, ratio * now.thrust_force, rtol=1e-12)
