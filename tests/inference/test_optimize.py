"""Maximisation: bounds are kept, the best point is never lost, whatever happens on the way."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.inference import Data, Likelihood, Objective, maximize
from skdgp.kernels import ConvolvedGaussian

BOUNDS = np.array([[-5.0, 5.0], [-5.0, 5.0]])


def hill(theta):
    """Highest, with value 3, at (1, -2)."""
    away = theta - [1.0, -2.0]
    return Likelihood(3.0 - away @ away, -2 * away, 2 * np.eye(2))


def ridge(theta):
    """Rosenbrock's valley upside down: highest, with value 0, at (1, 1)."""
    x, y = theta
    slope = np.array([-400 * x * (y - x**2) - 2 * (1 - x), 200 * (y - x**2)])
    # of two residuals, as Gauss and Newton have it
    jacobian = np.array([[-20 * x, 10.0], [-1.0, 0.0]])
    information = 2 * jacobian.T @ jacobian
    return Likelihood(-(100 * (y - x**2) ** 2 + (1 - x) ** 2), -slope, information)


def test_keeps_to_the_bounds():
    seen = []

    def watched(theta):
        seen.append(theta.copy())
        return hill(theta)

    bounds = np.array([[2.0, 3.0], [-1.0, 4.0]])
    best = maximize(watched, np.array([10.0, -10.0]), bounds, max_iter=100)
    assert_allclose(best.theta, [2.0, -1.0])
    seen = np.array(seen)
    assert (seen >= bounds[:, 0]).all()
    assert (seen <= bounds[:, 1]).all()


def test_a_step_to_a_bound_takes_the_others_along():
    """One step of a quadratic ends at the top inside the bounds, wherever it would end without them."""
    curvature = np.array([[2.0, 1.9], [1.9, 2.0]])

    def slope(theta):
        away = theta - [-3.0, 2.0]
        return Likelihood(-0.5 * away @ curvature @ away, -curvature @ away, curvature)

    bounds = np.array([[0.0, 5.0], [-5.0, 5.0]])
    best = maximize(slope, np.array([0.5, 0.0]), bounds, max_iter=8)
    assert best.converged
    assert_allclose(best.theta, [0.0, 2.0 - 0.95 * 3.0], atol=1e-3)


def test_a_climb_that_will_not_come_far_enough_is_given_up():
    start = np.array([-1.2, 1.0])
    reached = maximize(ridge, start, BOUNDS, max_iter=200, least=lambda theta: -1.0)
    given_up = maximize(ridge, start, BOUNDS, max_iter=200, least=lambda theta: 1e3)
    assert reached.converged
    assert not given_up.converged
    assert given_up.n_iter < reached.n_iter


def test_information_that_is_wrong_by_a_factor_takes_a_few_more_steps():
    """The changes of the gradient show what the information lacks."""

    def steep(theta):
        away = theta - [1.0, -2.0]
        curvature = np.array([[1e3, 9.0], [9.0, 1.0]])
        return Likelihood(-0.5 * away @ curvature @ away, -curvature @ away, np.diag([100.0, 3.0]))

    best = maximize(steep, np.array([4.0, 4.0]), BOUNDS, max_iter=30)
    assert best.converged
    assert_allclose(best.theta, [1.0, -2.0], atol=1e-3)


def test_what_rounding_alone_would_move_stays():
    rounding = default_rng(0)

    def flat(theta):
        value, slope, information = ridge(theta[:2])
        gradient = np.append(slope, 1e-5 * rounding.standard_normal())
        return Likelihood(value, gradient, np.pad(information, (0, 1)))

    bounds = np.tile([-5.0, 5.0], (3, 1))
    best = maximize(flat, np.array([-1.2, 1.0, 0.3]), bounds, max_iter=200)
    assert best.converged
    assert best.theta[2] == 0.3


def test_shifts_have_the_unit_of_their_length_scale():
    """A function of regressors in other units has the same steps: derivatives by log l, w and mu / l."""
    rng = default_rng(0)
    X = rng.normal(size=(30, 1))
    Y = np.column_stack([np.sin(X[:, 0]), np.sin(X[:, 0] - 0.3)])
    found = []
    for unit in (1.0, 1000.0):
        shift = np.array([[[0.0], [0.2]]]) * unit
        kernel = ConvolvedGaussian(
            1, private_latents=False, amplitude=[[1.0, 0.8]], length_scale=0.9 * unit, shift=shift,
            parameter_bounds={"shift": (-9 * unit, 9 * unit)},
        )  # fmt: skip
        objective = Objective(kernel, [Data.from_table(unit * X, Y)], n_noise=2)
        theta = np.append(kernel.theta, np.log([0.01, 0.01]))
        found.append(objective.in_units(theta / objective.unit))
    assert_allclose(found[1].gradient, found[0].gradient, rtol=1e-6)
    assert_allclose(found[1].information, found[0].information, rtol=1e-6)


def test_iterations_are_limited():
    few = maximize(ridge, np.array([-1.2, 1.0]), BOUNDS, max_iter=3)
    many = maximize(ridge, np.array([-1.2, 1.0]), BOUNDS, max_iter=200)
    assert few.n_iter == 3
    assert few.value < many.value
    assert_allclose(many.theta, 1.0, atol=1e-2)
    assert not few.converged
    assert many.converged


@pytest.mark.parametrize("failure", ["error", "nan", "nan gradient"])
def test_points_where_nothing_can_be_computed_are_walls(failure):
    def steep(theta):
        """Too steep: the first step lands behind the wall."""
        value, gradient, information = hill(theta)
        if theta[0] <= 3.0:
            return Likelihood(value, gradient * 40, information)
        if failure == "error":
            raise np.linalg.LinAlgError
        if failure == "nan":
            return Likelihood(np.nan, gradient, information)
        return Likelihood(1e9, np.nan * gradient, information)

    start = np.array([-4.0, 3.0])
    best = maximize(steep, start, BOUNDS, max_iter=100)
    assert np.isfinite(best.value)
    assert best.theta[0] <= 3.0
    assert best.value >= hill(start).value


def failing(error):
    """Return a function that cannot be evaluated."""

    def evaluate(theta):
        raise error

    return evaluate


def test_a_start_where_nothing_is_defined_is_an_error():
    with pytest.raises(np.linalg.LinAlgError):
        maximize(failing(np.linalg.LinAlgError), np.zeros(2), BOUNDS, max_iter=5)
