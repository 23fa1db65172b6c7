"""Runge-Kutta: its order, and its independence of everything but the step."""

import numpy as np

from skdgp.dynamics import rk4


def pendulum(t, y):
    return np.stack([y[..., 1], -np.sin(y[..., 0]) + 0.3 * np.cos(2 * t)], axis=-1)


def test_rk4_converges_with_fourth_order():
    start, steps = np.array([1.0, 0.2]), 10 * 2 ** np.arange(5)
    exact = rk4(pendulum, start, np.linspace(0, 3, 20001))[-1]
    errors = [
        np.abs(rk4(pendulum, start, np.linspace(0, 3, n + 1))[-1] - exact).max() for n in steps
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders[-2:], 4.0, atol=0.15)
