"""Maximisation: bounds are kept, the best point is never lost, whatever happens on the way."""

from threading import Event

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import listening
from skdgp.inference import Data, Objective, maximize
from skdgp.kernels import ConvolvedGaussian

BOUNDS = np.array([[-5.0, 5.0], [-5.0, 5.0]])


def hill(theta):
    """Highest, with value 3, at (1, -2)."""
    away = theta - [1.0, -2.0]
    return 3.0 - away @ away, -2 * away


def ridge(theta):
    """Rosenbrock's valley upside down: highest, with value 0, at (1, 1)."""
    x, y = theta
    slope = np.array([-400 * x * (y - x**2) - 2 * (1 - x), 200 * (y - x**2)])
    return -(100 * (y - x**2) ** 2 + (1 - x) ** 2), -slope


def test_finds_the_top():
    best = maximize(hill, np.array([4.0, 4.0]), BOUNDS, Event())
    assert_allclose(best.theta, [1, -2], atol=1e-4)
    assert best.value == pytest.approx(3.0)
    assert best.n_iter > 0


def test_keeps_to_the_bounds():
    seen = []

    def watched(theta):
        seen.append(theta.copy())
        return hill(theta)

    bounds = np.array([[2.0, 3.0], [-1.0, 4.0]])
    best = maximize(watched, np.array([10.0, -10.0]), bounds, Event())
    assert_allclose(best.theta, [2.0, -1.0])
    seen = np.array(seen)
    assert (seen >= bounds[:, 0]).all()
    assert (seen <= bounds[:, 1]).all()


def steep_and_flat(theta):
    """Highest at (1, -2), a million times steeper along the first parameter."""
    away = theta - [1.0, -2.0]
    steep = np.array([1e6, 1.0])
    return -0.5 * away @ (steep * away), -steep * away


def test_units_of_the_information_make_all_directions_alike():
    start = np.array([4.0, 4.0])
    exact = maximize(
        steep_and_flat, start, BOUNDS, Event(), max_iter=2, scale=lambda theta: np.array([1e-3, 1])
    )
    plain = maximize(steep_and_flat, start, BOUNDS, Event(), max_iter=2)
    assert_allclose(exact.theta, [1.0, -2.0], atol=1e-4)
    assert plain.value < exact.value - 1.0


def test_information_of_a_hyperparameter_is_the_variance_of_its_gradient():
    """That of log sigma^2 is n / 2 for white noise; an amplitude of nearly zero has none."""
    kernel = ConvolvedGaussian(0, amplitude=[[1e-6]], length_scale=[[[1.0]]])
    n = 200
    informations = []
    for seed in range(40):
        rng = default_rng(seed)
        data = Data.from_table(rng.normal(size=(n, 1)), rng.normal(size=(n, 1)))
        objective = Objective(kernel, data, n_noise=1)
        scale = objective.scale(np.append(kernel.theta, 0.0))
        informations.append(scale**-2 - 1)
    found = np.mean(informations, axis=0)
    assert found[-1] == pytest.approx(n / 2, rel=0.25)
    assert_allclose(found[:-1], 0.0, atol=1e-6)


def test_iterations_are_limited():
    few = maximize(ridge, np.array([-1.2, 1.0]), BOUNDS, Event(), max_iter=3)
    many = maximize(ridge, np.array([-1.2, 1.0]), BOUNDS, Event(), max_iter=200)
    assert few.n_iter == 3
    assert few.value < many.value
    assert_allclose(many.theta, 1.0, atol=1e-2)
    assert not few.converged
    assert 0.1 < few.remaining / (many.value - few.value) < 10
    assert many.converged
    assert many.remaining < 1e-3


@pytest.mark.parametrize("failure", ["error", "nan", "nan gradient"])
def test_points_where_nothing_can_be_computed_are_walls(failure):
    def steep(theta):
        """Too steep: the first step lands behind the wall."""
        value, gradient = hill(theta)
        if theta[0] <= 3.0:
            return value, gradient * 40
        if failure == "error":
            raise np.linalg.LinAlgError
        return (np.nan, gradient) if failure == "nan" else (1e9, np.nan * gradient)

    start = np.array([-4.0, 3.0])
    best = maximize(steep, start, BOUNDS, Event())
    assert np.isfinite(best.value)
    assert best.theta[0] <= 3.0
    assert best.value >= hill(start)[0]


def failing(error):
    """Return a function that cannot be evaluated."""

    def evaluate(theta):
        raise error

    return evaluate


def test_a_start_that_fails_says_so_by_its_value():
    best = maximize(failing(np.linalg.LinAlgError), np.zeros(2), BOUNDS, Event())
    assert best.value == -np.inf
    assert_array_equal(best.theta, 0.0)


class TestInterrupt:
    def test_leaves_the_search(self):
        with pytest.raises(KeyboardInterrupt):
            maximize(failing(KeyboardInterrupt), np.array([-1.2, 1.0]), BOUNDS, Event())

    def test_keeps_the_best_point_where_it_is_wanted(self):
        points = []

        def interrupted(theta):
            if len(points) == 9:
                raise KeyboardInterrupt
            points.append((ridge(theta)[0], theta.copy()))
            return ridge(theta)

        stop = Event()
        with listening(print, keep_best=True):
            best = maximize(interrupted, np.array([-1.2, 1.0]), BOUNDS, stop)
        assert stop.is_set()
        value, theta = max(points, key=lambda point: point[0])
        assert best.value == value
        assert_array_equal(best.theta, theta)
