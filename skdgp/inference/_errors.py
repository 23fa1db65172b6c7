r"""Errors of the function that a posterior does not hold.

A posterior takes regressors and targets as they stand. Noise of the regressors flattens slopes, slopes that
another source knows have its errors, and errors of the log that its samples do not show, such as times of
channels, change slopes. Each is a linear function of the regressors x about their mean c that all outputs share,
times an independent number z,

.. math:: e_i(x) = \sum_k z_k\, (w_{k0i} + \sum_j w_{kji} (x_j - c_j)), \quad z_k \sim N(0, 1).

Their sum is added to the posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import least_squares
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.kernels import LinearPaths, PathBundle

LARGEST_ATTENUATION = 0.5
"""Largest fraction of a regressor's variance that counts as noise: the error is then the slope."""


class FunctionErrors(NamedTuple):
    """Random linear functions of d regressors, of P outputs."""

    #: w, (K, d + 1, P)
    weights: Array
    #: c, (d,)
    centre: Vector
    #: Weights of their mean, (d + 1, P), or zero
    mean: Any = 0.0

    def linear(self, X: Matrix) -> Array:
        """Return the linear functions at X (n, d), (K, n, P)."""
        return linear_basis(X - self.centre) @ self.weights

    def variance(self, X: Matrix) -> Matrix:
        """Return the variance at X (n, d), (n, P)."""
        return np.sum(self.linear(X) ** 2, axis=0)

    def covariance(self, X: Matrix) -> Matrix:
        """Return the joint covariance at X (n, d), (P n, P n), output-major."""
        n_errors, _, P = self.weights.shape
        terms = self.linear(X).swapaxes(1, 2).reshape(n_errors, P * len(X))
        return terms.T @ terms

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return draws of the errors."""
        z = check_random_state(random_state).standard_normal((n_paths, len(self.weights)))
        return LinearPaths(np.tensordot(z, self.weights, axes=1) + self.mean, self.centre)

    def mean_path(self) -> LinearPaths:
        """Return the mean, as a single path."""
        return LinearPaths(np.zeros((1, *self.weights.shape[1:])) + self.mean, self.centre)

    def slopes(self) -> Array:
        """Return the slopes, (P, d, K)."""
        return np.transpose(self.weights[:, 1:], (2, 1, 0))

    def joined(self, other: FunctionErrors) -> FunctionErrors:
        """Return these and other errors, about the centre of these."""
        weights, mean = (
            LinearPaths(each, other.centre).about(self.centre).weights
            for each in (other.weights, other.mean_path().weights)
        )
        return FunctionErrors(
            np.concatenate([self.weights, weights]), self.centre, self.mean + mean[0]
        )

    def in_units(self, shift: Vector, scale: Vector, output_scale: Vector) -> FunctionErrors:
        """Return the errors of outputs times ``output_scale``, as a function of shift + scale x."""
        factor = np.concatenate([[1.0], 1.0 / scale])[:, None] * output_scale
        return FunctionErrors(
            self.weights * factor, shift + scale * self.centre, self.mean * factor
        )

    def of_outputs(self, outputs: Any) -> FunctionErrors:
        """Return the errors of some outputs."""
        mean = self.mean_path().weights[0]
        return self._replace(weights=self.weights[..., outputs], mean=mean[..., outputs])


def linear_basis(x: Array) -> Array:
    """Return (1, x), (..., d + 1), for x (..., d)."""
    return np.concatenate([np.ones((*x.shape[:-1], 1)), x], axis=-1)


def errors_of_slopes(errors: Array, centre: Vector) -> FunctionErrors:
    """Return errors (P, d, K) of slopes as errors of a function about a centre (d,)."""
    P, d, n_errors = errors.shape
    weights = np.zeros((n_errors, d + 1, P))
    weights[:, 1:] = np.transpose(errors, (2, 1, 0))
    return FunctionErrors(weights, centre)


def attenuation(X: Matrix, covariance: Matrix, slopes: Vector) -> Matrix:
    r"""Return the errors (d, d) of slopes (d,) by noise of each regressor, whose ``covariance`` (d, d) is known.

    Its column k is the covariance :math:`c_k` of all regressors X (n, d) with the noise of the k-th, which
    is :math:`s_k^2 e_k` for independent noise of variance :math:`s_k^2`. With the covariance C of the
    regressors and slopes :math:`b_k`, all slopes are off by

    .. math:: \frac{C^{-1} c_k}{1 - f_k} b_k, \quad f_k = |e_k^T C^{-1} c_k|

    (Fuller 1987, section 1.1), :math:`c_k` at most as large as for f = `LARGEST_ATTENUATION`. Columns
    are by the noise of one regressor.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.inference import attenuation
    >>> rng = np.random.default_rng(0)
    >>> exact, noise = rng.normal(size=(2, 10000, 1))
    >>> X = exact + 0.5 * noise
    >>> slope = np.linalg.lstsq(X, 2 * exact[:, 0], rcond=None)[0]
    >>> bool(abs(slope + attenuation(X, np.array([[0.25]]), slope)[0] - 2) < 0.05)
    True
    """
    error = np.linalg.pinv(np.atleast_2d(np.cov(X.T)), hermitian=True) @ covariance
    fraction = np.abs(np.diag(error))
    limit = LARGEST_ATTENUATION / np.maximum(fraction, LARGEST_ATTENUATION)
    return error * limit / (1.0 - limit * fraction) * slopes


def errors_by_input_noise(
    X: Sequence[Matrix], function: PathBundle, std: Vector | None
) -> FunctionErrors:
    """Return the errors of a function by noise ``std`` (d,) of its regressors that was learned, if any.

    X (n_i, d) are the regressors of each output.
    """
    centre = max(X, key=len).mean(axis=0)
    if std is None:
        return errors_of_slopes(np.zeros((len(X), len(centre), 0)), centre)
    slopes = function.slopes(centre[None, None])[0, 0]
    of_outputs = [attenuation(x, np.diag(std**2), b) for x, b in zip(X, slopes, strict=True)]
    return errors_of_slopes(np.stack(of_outputs), centre)


class KnownSlopes(NamedTuple):
    """Slopes of P outputs by d regressors, NaN where they are learned from the samples.

    Samples whose regressors were estimated from their own targets, as an angle of attack from the
    force that it causes, are no evidence of slopes. Least squares is biased, and its bands are too
    narrow.
    """

    value: Matrix  # (P, d)
    errors: Array  # (P, d, k), sums of the last axis times independent standard normal numbers
    includes_noise: bool = True  #: Whether errors by noise of the regressors are among these

    @classmethod
    def of_samples(cls, X: Matrix, Y: Matrix, deviations: Matrix) -> KnownSlopes:
        """Return the slopes of least squares with standard ``deviations`` (P, d), where these are finite.

        Rows of X (n, d) and Y (n, P) with missing values are left out.
        """
        value = np.where(np.isfinite(deviations), linear_weights(X, Y)[1:].T, np.nan)
        own = np.eye(value.size).reshape(*value.shape, value.size)
        errors = np.nan_to_num(deviations)[..., None] * own
        return cls(value, errors)

    @property
    def known(self) -> Array:
        """Whether a slope is known, (P, d, 1)."""
        return np.isfinite(self.value)[..., None]

    def scaled(self, factor: Array) -> KnownSlopes:
        """Return the slopes times ``factor``, which broadcasts to (P, d)."""
        errors = self.errors * np.asarray(factor)[..., None]
        return self._replace(value=self.value * factor, errors=errors)

    def added(self, X: Matrix, Y: Matrix) -> Matrix:
        """Return the weights (d + 1, P) of the linear function of X (n, d), about its mean, that Y (n, P) lacks."""
        Q = linear_basis(X - X.mean(axis=0))
        columns = []
        for y, value in zip(Y.T, self.value, strict=True):
            weights = np.append(0.0, np.nan_to_num(value))
            free = np.append(True, np.isnan(value))
            weights[free] = least_squares(Q[:, free], y - Q @ weights)
            columns.append(weights - least_squares(Q, y))
        return np.column_stack(columns)

    def function_errors(self, X: Matrix, Y: Matrix) -> FunctionErrors:
        """Return the errors of slopes, and as their mean what a function lacks that is Y (n, P) at X (n, d)."""
        return errors_of_slopes(self.errors, X.mean(axis=0))._replace(mean=self.added(X, Y))

    def left_of(self, errors: FunctionErrors) -> FunctionErrors:
        """Return what these slopes leave of errors by noise of the regressors."""
        weights = errors.weights.copy()
        if self.includes_noise:
            weights[:, 1:] *= np.logical_not(self.known[..., 0]).T
        return errors._replace(weights=weights)


def linear_weights(X: Matrix, Y: Any) -> Matrix:
    """Return intercepts and slopes (d + 1, P) of Y (n, P) by X (n, d), by least squares of the rows that are known."""
    complete = np.isfinite(X).all(axis=1)
    weights = []
    for y in np.asarray(Y, dtype=float).T:
        rows = complete & np.isfinite(y)
        centre = X[rows].mean(axis=0)  # a constant regressor has no slope
        of_output = least_squares(linear_basis(X[rows] - centre), y[rows])
        of_output[0] -= centre @ of_output[1:]
        weights.append(of_output)
    return np.column_stack(weights)
