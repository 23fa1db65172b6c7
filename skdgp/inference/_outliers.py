r"""Outliers: noise that is a mixture of two normal distributions, as a noise variance for each value.

An error e has the density :math:`(1 - \epsilon) N(e; 0, s^2) + \epsilon N(e; 0, S^2)` (the contaminated
normal distribution: Tukey 1960). Expectation maximisation alternates between a fit of the function
with the variances

.. math:: v_a = \left(\frac{1 - p_a}{s^2} + \frac{p_a}{S^2}\right)^{-1}

of the noise of each value and the probability :math:`p_a` that its error is of the second kind. With
outliers of 100 standard deviations in 1 % of the rows, errors of the function are as without them;
with Student's t distribution they are up to twice as large, as its weights differ between sound values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.stats import norm

from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._blocks import leaves


@dataclass(frozen=True)
class OutlierSettings:
    """How outliers are found."""

    #: Most rows of a leaf of a k-d tree, whose median is compared with its values before any fit
    leaf_rows: int = 16
    #: Distance from this median, in standard deviations by the median absolute one, of an outlier, and
    #: least ratio of the two standard deviations: near kinks and jumps errors are up to five times as large
    distance: float = 6.0
    #: Rise of the log likelihood of the errors above which they are not normal [nats]: of normal errors
    #: one set in some thousand
    least_rise: float = 6.0
    #: Steps of expectation maximisation between fits
    steps: int = 50
    #: Largest number of fits, and change of the logarithm of a variance below which one is the last
    fits: int = 8
    tolerance: float = 0.1


SETTINGS = OutlierSettings()


def gross_outliers(X: Matrix, y: Vector) -> Vector:
    """Return the squared distance (n,) of values far from the median of their leaf, zero for the others.

    X (n, d) are the regressors, y (n,) the values.
    """
    if len(y) <= SETTINGS.leaf_rows:
        return np.zeros(len(y))
    leaf = leaves(X, SETTINGS.leaf_rows)
    distance = y - ndimage.median(y, leaf, leaf)
    std = np.median(np.abs(distance)) / norm.ppf(0.75)
    is_far = np.abs(distance) > SETTINGS.distance * std
    return np.where(is_far & (std > 0), distance**2, 0.0)


def contaminated_variances(squares: Vector) -> Vector | None:
    """Return the noise variance of each value (n,) by the expected squares of the errors; None for normal ones."""
    error = np.sqrt(squares)
    small, large, fraction = np.median(squares), squares.max(), 1.0 / len(squares)
    if small <= 0.0:
        return None
    for _ in range(SETTINGS.steps):
        of_small = np.log1p(-fraction) + norm.logpdf(error, scale=np.sqrt(small))
        of_large = np.log(fraction) + norm.logpdf(error, scale=np.sqrt(large))
        likelihood = np.logaddexp(of_small, of_large)
        outlying = np.exp(of_large - likelihood)
        fraction = np.clip(outlying.mean(), 1e-9, 0.5)
        small = np.average(squares, weights=1.0 - outlying + 1e-12)
        large = max(np.average(squares, weights=outlying + 1e-300), small)
    if large < SETTINGS.distance**2 * small:
        return None  # errors where the function is rough
    of_normal = norm.logpdf(error, scale=np.sqrt(squares.mean()))
    if likelihood.sum() <= of_normal.sum() + SETTINGS.least_rise:
        return None
    return 1.0 / ((1.0 - outlying) / small + outlying / large)
