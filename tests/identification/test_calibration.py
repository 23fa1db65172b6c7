"""What the noise of the regressors takes from a function, as residuals show it."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.identification._calibration import RegressionCalibration


def test_linear_residuals_are_added_in_proportion_to_the_noise():
    """Up to the noise of the training flights; unknown residuals tell nothing."""
    rng = default_rng(0)
    X = rng.normal(size=(50, 3))
    intercept, slopes = rng.normal(size=2), rng.normal(size=(3, 2))
    residuals = intercept + X @ slopes
    residuals[5:20, 1] = np.nan
    calibration = RegressionCalibration.of_residuals(X, residuals)
    points = rng.normal(size=(4, 3))
    fraction = np.array([0.0, 0.5, 1.0, 1.0])[:, None]
    expected = fraction * (intercept + points @ slopes)
    found = calibration(points, np.array([0.0, 0.5, 1.0, 7.0]))
    assert_allclose(found, expected, atol=1e-12)


def test_an_attenuated_slope_is_restored_in_the_mean():
    """Of y = 2 z seen at x = z + e with Var e = Var z / 4, E[y | x] = 2 x / 1.25."""
    rng = default_rng(1)
    z = rng.normal(size=100_000)
    x = (z + 0.5 * rng.normal(size=100_000))[:, None]
    calibration = RegressionCalibration.of_residuals(x, 2 * z[:, None] - 2 * x)
    points = np.array([[-1.0], [2.0]])
    mean = 2 * points + calibration(points, np.ones(2))
    assert_allclose(mean, 1.6 * points, rtol=0.02, atol=0.02)


def test_regressors_without_effect_get_no_slope():
    rng = default_rng(2)
    X = rng.normal(size=(60, 2))
    residuals = np.column_stack([X @ [1.0, 2.0], X @ [3.0, 4.0]])
    without_effect = np.array([[False, True], [False, False]])
    calibration = RegressionCalibration.of_residuals(X, residuals, without_effect)
    assert calibration.slopes[1, 0] == 0.0
    assert_allclose(calibration.slopes[:, 1], [3.0, 4.0])
    alone = np.polynomial.Polynomial.fit(X[:, 0], residuals[:, 0], 1).convert().coef
    assert_allclose([calibration.intercept[0], calibration.slopes[0, 0]], alone)
