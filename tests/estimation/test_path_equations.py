"""Equations of a path: their slopes, and the solution of their normal equations."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from skdgp.estimation import FlightPath, FlightSensors
from skdgp.estimation._least_squares import Equations, GaussianPrior, solve
from skdgp.estimation._path_equations import PLACE, path_equations

EPS = 1e-6
BIASES = ("ax_bias", "ay_bias", "az_bias", "p_bias", "q_bias", "r_bias")


@pytest.fixture
def near_path():
    """Sensors of a turning flight, and a path near it that is no solution."""
    rng = default_rng(4)
    n = 12
    time = 0.04 * np.arange(n)
    angles = np.column_stack([0.3 * time, 0.1 + 0.2 * time, 0.3 * np.sin(time)])
    readings = rng.normal([0.5, -0.3, -9.0, 0.1, 0.2, 0.3, 25.0, 0.1, 0.05], 0.1, (n, 9))
    sensors = FlightSensors(
        time=time,
        segment=np.zeros(n, dtype=int),
        readings=readings,
        velocity=rng.normal([24.0, 5.0, 1.0], 0.1, (n, 3)),
        attitude=Rotation.from_euler("ZYX", angles),
        attitude_sampled=np.ones(n, dtype=bool),
        position=np.zeros((n, 3)),
        lever_acceleration=np.zeros((n, 3)),
    )
    constants = np.zeros(len(PLACE))
    constants[PLACE["p_bias"]] = 0.01
    constants[PLACE["wind_east"]] = 4.0
    path = FlightPath.initial(sensors).moved(0.1 * rng.standard_normal((n, 9)), constants)
    return sensors, path


def equations(path, sensors):
    correlation = np.full(len(sensors.time) - 1, 0.9)
    return path_equations(path, sensors, correlation, np.zeros(2, dtype=int), least_airspeed=3.0)


def test_slopes_by_states_are_those_of_the_residuals(near_path):
    sensors, path = near_path
    base = equations(path, sensors)
    for place in range(9):
        for first in (0, 1):  # every other sample moves: each equation feels one of its two
            states = np.zeros((len(sensors.time), 9))
            states[first::2, place] = EPS
            slope = (equations(path.moved(states, 0.0), sensors).residual - base.residual) / EPS
            assert_allclose(slope[first::2], base.d_state[first::2, :, place], atol=2e-3, rtol=2e-3)
            assert_allclose(
                slope[1 - first :: 2, :9],
                base.d_next[1 - first :: 2, :9, place],
                atol=2e-3,
                rtol=2e-3,
            )


@pytest.mark.parametrize("name", [name for name in PLACE if not name.endswith("_lag")])
def test_slopes_by_constants_are_those_of_the_residuals(name, near_path):
    """Those by lags are of first order only: see the recovery of lags."""
    sensors, path = near_path
    base = equations(path, sensors)
    constants = np.zeros(len(PLACE))
    constants[PLACE[name]] = EPS
    moved = equations(path.moved(np.zeros((len(sensors.time), 9)), constants), sensors)
    slope = (moved.residual - base.residual) / EPS
    assert_allclose(slope, base.d_constants[:, :, PLACE[name]], atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("delay", [0, 3])
def test_a_turn_of_late_sensors_in_wind_and_gusts_solves_them(delay):
    """Pitched and banked, in a circle over moving air: rates and forces by their formulas."""
    n, step, rate, speed, phi, theta = 40, 0.01, 0.4, 25.0, 0.5, 0.1
    wind, biases = np.array([3.0, -2.0, 0.0]), 0.02 * np.arange(1, 7)
    lags = {"velocity_lag": 0.032 if delay else 0.004, "attitude_lag": 0.027 if delay else -0.003}
    time = step * np.arange(n)
    correlation = np.exp(-step / 2.0)
    gust = np.multiply.outer(correlation ** np.arange(n), [0.5, -0.4, 0.3])

    def attitude(t):
        return Rotation.from_euler("ZYX", np.array([rate * t + 0.7, theta + 0 * t, phi + 0 * t]).T)

    def velocity(t):
        circle = np.array([np.cos(rate * t), np.sin(rate * t), 0.1 + 0 * t])
        return speed * circle.T + wind

    centripetal = speed * rate * np.array([-np.sin(rate * time), np.cos(rate * time), 0 * time]).T
    force = attitude(time).inv().apply(centripetal - [0.0, 0.0, 9.80665])
    turning = rate * np.array(
        [-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)]
    )
    u, v, w = attitude(time).inv().apply(velocity(time) - wind - gust).T
    airspeed = np.sqrt(u**2 + v**2 + w**2)
    air_data = np.column_stack([airspeed, np.arctan2(w, u), np.arcsin(v / airspeed)])
    inertial = np.column_stack([force, np.tile(turning, (n, 1))]) + biases
    sensors = FlightSensors(
        time=time,
        segment=np.zeros(n, dtype=int),
        readings=np.column_stack([inertial, air_data]),
        velocity=velocity(time - lags["velocity_lag"]),
        attitude=attitude(time - lags["attitude_lag"]),
        attitude_sampled=np.ones(n, dtype=bool),
        position=np.zeros((n, 3)),
        lever_acceleration=np.zeros((n, 3)),
    )
    values = dict(zip(BIASES, biases, strict=True)) | lags
    values |= {"wind_north": wind[0], "wind_east": wind[1]}
    constants = np.zeros(len(PLACE))
    for name, value in values.items():
        constants[PLACE[name]] = value
    path = FlightPath(velocity(time), attitude(time), gust, constants)
    delays = np.full(2, delay)
    found = path_equations(path, sensors, np.full(n - 1, correlation), delays, 3.0)
    residual = found.residual[: n - 1 - delay]
    assert np.isfinite(residual).all()
    assert_allclose(residual, 0.0, atol=2e-4)


def test_the_bordered_solution_is_that_of_the_dense_problem():
    rng = default_rng(0)
    n, s, c, k = 6, 3, 2, 40_000
    equations = Equations(rng.normal(size=(n, 6, 2 * s + c + 1)), s)
    equations.d_next[-1] = 0.0
    prior = GaussianPrior(
        np.full((n, s), 0.3), rng.normal(size=(n, s)), np.full(c, 0.5), rng.normal(size=c)
    )
    root = np.sqrt(np.r_[prior.states.ravel(), prior.constants])

    def linear(z):
        """Return what states and constants add to the residuals, and their own deviations."""
        states, constants = z[: n * s].reshape(n, s, 1), z[n * s :, None]
        after = np.roll(states, -1, axis=0)  # the last equation has none
        of_path = equations.d_state @ states + equations.d_next @ after
        return np.r_[(of_path + equations.d_constants @ constants).ravel(), root * z]

    J = np.transpose([linear(unit) for unit in np.eye(len(root))])
    offset = np.r_[prior.states_offset.ravel(), prior.constants_offset]
    r = np.r_[equations.residual.ravel(), root * offset]
    covariance = np.linalg.inv(J.T @ J)
    solution = -covariance @ J.T @ r
    found = solve(equations, prior, np.arange(c), rng.standard_normal((n * s + c, k)))
    assert_allclose(np.r_[found.states.ravel(), found.constants], solution, atol=1e-10)
    assert_allclose(found.covariance, covariance[n * s :, n * s :], atol=1e-10)
    draws = np.vstack([found.state_draws.reshape(n * s, k), found.constant_draws])
    std = np.sqrt(np.diag(covariance))
    assert_allclose(np.cov(draws) / np.outer(std, std), covariance / np.outer(std, std), atol=0.03)
