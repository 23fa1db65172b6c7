r"""Slope of a signal y over a signal x, with its error for dependent samples.

Other regressors, such as an intercept, a steady wind and further effects, are removed from both
signals first (Frisch & Waugh 1933). With the residual e, slope and standard deviation are

.. math:: s = \frac{x^T y}{x^T x}, \quad e = y - s x, \quad
          \sigma = \frac{\sqrt{\tau \sum_k (x_k e_k)^2}}{x^T x}.

Neighbouring samples are dependent: n samples count as :math:`n / \tau`, where :math:`\tau` is the
autocorrelation time of the products x e, :math:`1 + 2 \sum \rho_x \rho_e` (Bartlett 1946).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.physics._signals import PHYSICS


class Regression(NamedTuple):
    """A response y, the regressor x whose slope is judged, and the other regressors, (n,) each."""

    y: Vector
    x: Vector
    others: list[Vector]

    @classmethod
    def with_intercept(cls, y: Vector, x: Vector, *others: Vector) -> Regression:
        """Return the regression with an intercept and other regressors."""
        return cls(y, x, [np.ones(len(y)), *others])


class Slope(NamedTuple):
    """A slope of a regression, with its standard deviation and partial correlation."""

    value: float
    std: float
    correlation: float  # partial
    n_effective: float  # n / tau
    size: float  # root mean square of x without the other regressors

    @property
    def explained(self) -> float:
        """Ratio of explained to unexplained variance."""
        squared = self.correlation**2
        return squared / max(1 - squared, 1e-12)

    def t_over(self, others: Iterable[Slope]) -> float:
        """Return the t by which it explains y better than the best of other slopes, 0 if it does not.

        By the likelihood ratio: t^2 = n log of the ratio of unexplained variances.
        """
        explained = max((slope.explained for slope in others), default=0.0)
        ratio = (1 + self.explained) / (1 + explained)
        return float(np.sqrt(self.n_effective * np.log(max(ratio, 1.0))))

    def t(self, least: float, most: float) -> float:
        """Return how far the slope is outside of an interval, in standard deviations, 0 inside."""
        outside = self.value - np.clip(self.value, least, most)
        return outside / max(self.std, 1e-9 * abs(self.value))


def estimated_slope(regression: Regression) -> Slope | None:
    """Return the slope of y over x beside the other regressors, None if undetermined by the rows."""
    rows = np.column_stack([*regression.others, regression.x, regression.y])
    rows = rows[np.isfinite(rows).all(axis=1)]
    n = len(rows)
    if n < PHYSICS.least_rows:
        return None
    xy = _without(rows[:, :-2], rows[:, -2:])
    x, y = xy.T
    x_size, y_size = np.linalg.norm(xy, axis=0)
    is_determined = x_size > 1e-3 * np.linalg.norm(rows[:, -2])
    if not is_determined or not y_size > 0:
        return None
    slope = x @ y / x_size**2
    products = x * (y - slope * x)
    tau = autocorrelation_time(products)
    std = np.sqrt(tau) * np.linalg.norm(products) / x_size**2
    correlation = x @ y / (x_size * y_size)
    size = x_size / np.sqrt(n)
    return Slope(float(slope), float(std), float(correlation), n / tau, float(size))


def _without(others: Matrix, xy: Matrix) -> Matrix:
    """Return x and y (n, 2) without the other regressors (n, k)."""
    return xy - others @ np.linalg.lstsq(others, xy)[0]
