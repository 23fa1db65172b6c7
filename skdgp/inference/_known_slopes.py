"""Slopes that another source knows better than the samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import least_squares
from skdgp._compute.typing import Array, Matrix
from skdgp.inference._errors import FunctionErrors


class KnownSlopes(NamedTuple):
    """Slopes of P outputs by d regressors, NaN where they are learned from the samples.

    Samples whose regressors were estimated from their own targets, as an angle of attack from the
    force that it causes, are no evidence of slopes. Least squares is biased, and its bands are too
    narrow.
    """

    value: Matrix  # (P, d)
    # (P, d, k), sums of the last axis times independent standard normal numbers; of learned slopes beside other errors
    errors: Array

    @classmethod
    def of_samples(cls, X: Matrix, Y: Matrix, deviations: Matrix) -> KnownSlopes:
        """Return the slopes of least squares with standard ``deviations`` (P, d), where these are finite.

        Rows of X (n, d) and Y (n, P) with missing values are left out.
        """
        value = np.empty_like(deviations)
        complete = np.isfinite(X).all(axis=1)
        for y, slopes in zip(np.asarray(Y, dtype=float).T, value, strict=True):
            rows = np.isfinite(y) & complete
            slopes[:] = least_squares(X[rows] - X[rows].mean(axis=0), y[rows] - y[rows].mean())
        value[~np.isfinite(deviations)] = np.nan
        errors = np.zeros((*value.shape, value.size))
        np.einsum("pdpd->pd", errors.reshape(*value.shape, *value.shape))[:] = np.nan_to_num(
            deviations
        )
        return cls(value, errors)

    @classmethod
    def unknown(cls, X: Matrix, Y: Matrix, std: Matrix, most: float = 0.5) -> KnownSlopes:
        r"""Return slopes that are learned, with the errors by noise of the regressors of a known ``std`` (d,).

        Noise of variance :math:`s_k^2` of a regressor flattens its slope and moves those of correlated ones. With
        the covariance C of the regressors and slopes :math:`b_k` of least squares, they are off by

        .. math:: \frac{f_k}{1 - f_k} \frac{C^{-1} e_k}{e_k^T C^{-1} e_k} b_k, \quad
                  f_k = s_k^2\, e_k^T C^{-1} e_k

        (Fuller 1987, section 1.1). f is at most ``most``: an error is then the slope. Rows with missing values are
        left out.
        """
        P, d = Y.shape[1], X.shape[1]
        errors = np.zeros((P, d, d))
        complete = np.isfinite(X).all(axis=1)
        for y, of_output in zip(np.asarray(Y, dtype=float).T, errors, strict=True):
            rows = np.isfinite(y) & complete
            slopes = least_squares(X[rows] - X[rows].mean(axis=0), y[rows] - y[rows].mean())
            inverse = np.linalg.pinv(np.atleast_2d(np.cov(X[rows].T)), hermitian=True)
            size = np.maximum(np.diag(inverse), np.finfo(float).tiny)
            fraction = np.minimum(std**2 * size, most)
            of_output[:] = inverse / size * (fraction / (1.0 - fraction) * slopes)
        return cls(np.full((P, d), np.nan), errors)

    @classmethod
    def with_zeros(cls, slopes: KnownSlopes | None, is_zero: Matrix) -> KnownSlopes:
        """Return slopes, if any, of which those in ``is_zero`` (P, d) are zero where they are not known."""
        if slopes is None:
            nothing = np.zeros((*is_zero.shape, 1))
            slopes = cls(np.full(is_zero.shape, np.nan), nothing)
        learned = is_zero & np.isnan(slopes.value)
        value = np.where(learned, 0.0, slopes.value)
        return cls(value, np.where(learned[..., None], 0.0, slopes.errors))

    @property
    def known(self) -> Array:
        """Whether a slope is known, (P, d, 1)."""
        return np.isfinite(self.value)[..., None]

    def scaled(self, factor: Array) -> KnownSlopes:
        """Return the slopes times ``factor``, which broadcasts to (P, d)."""
        return KnownSlopes(self.value * factor, self.errors * np.asarray(factor)[..., None])

    def corrected(self, X: Matrix, Y: Matrix) -> Matrix:
        """Return Y (n, P) plus a linear function of X (n, d) that gives it the known slopes."""
        Y = Y.copy()
        Q = np.column_stack([np.ones(len(X)), X - X.mean(axis=0)])
        for y, value in zip(Y.T, self.value, strict=True):
            weights = np.append(0.0, np.nan_to_num(value))
            free = np.append(True, np.isnan(value))
            weights[free] = least_squares(Q[:, free], y - Q @ weights)
            y -= Q @ least_squares(Q, y - Q @ weights)
        return Y

    def replaced(self, errors: FunctionErrors) -> FunctionErrors:
        """Return the errors of a function whose known slopes have the errors of their source.

        Those of learned slopes are biases beside the others.
        """
        P, d, k = self.errors.shape
        slope_errors = np.zeros((k, d + 1, P))
        slope_errors[:, 1:] = np.transpose(self.errors, (2, 1, 0))
        unknown = np.ones((d + 1, P))
        unknown[1:] = np.logical_not(self.known[..., 0]).T
        random = np.concatenate([errors.random * unknown, slope_errors * (1.0 - unknown)])
        method = np.concatenate([errors.method * unknown, slope_errors * unknown])
        return errors._replace(random=random, method=method)
