"""Runge-Kutta: its order, and its independence of everything but the step."""

import numpy as np

from skdgp.dynamics import rk4, rk4_step


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


def test_cases_along_leading_axes_do_not_see_each_other():
    starts = np.random.default_rng(0).normal(size=(3, 4, 2))
    times = np.linspace(0, 1, 11)
    together = rk4(pendulum, starts, times)
    assert together.shape == (11, 3, 4, 2)
    np.testing.assert_allclose(together[:, 1, 2], rk4(pendulum, starts[1, 2], times), atol=1e-14)


def test_each_case_may_have_its_own_step():
    starts, steps = np.ones((3, 1)), np.array([[0.1], [0.2], [0.0]])
    after = rk4_step(lambda t, y: -y, 0.0, starts, steps)
    np.testing.assert_allclose(after, np.exp(-steps), atol=3e-6)
    assert after[2] == 1.0
