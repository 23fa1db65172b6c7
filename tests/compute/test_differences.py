"""Central differences against derivatives that are known."""

import numpy as np
import pytest

from skdgp._compute.differences import central_difference


def test_are_exact_for_polynomials_of_fourth_degree():
    def function(z):
        x, y = np.moveaxis(z, -1, 0)
        return np.stack([x**4 * y, x - 3.0 * y**3, x * y], axis=-1)

    x, y = z = np.array([1.3, -0.7])
    exact = [[4 * x**3 * y, x**4], [1.0, -9.0 * y**2], [y, x]]
    assert central_difference(function, z, np.array([0.5, 0.2])) == pytest.approx(np.array(exact))


def test_are_of_fourth_order_in_the_step():
    z = np.linspace(-1.0, 1.0, 6).reshape(2, 3)
    exact = np.exp(z)[..., None] * np.eye(3)
    errors = [
        np.abs(central_difference(np.exp, z, np.full(3, step)) - exact).max()
        for step in (0.02, 0.01)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.05)
