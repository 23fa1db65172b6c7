"""Covariance of the parameters of the filter-error method, in named steps."""

from __future__ import annotations

import numpy as np

from skdgp._compute.typing import Matrix, Vector


def sandwich(information: Matrix, scatter: Matrix) -> Matrix:
    """Return A^-1 B A^-T, with the information A and the covariance B of the score (Huber 1967)."""
    inverse = np.linalg.inv(information)
    return inverse @ scatter @ inverse.T


def correlated_scatter(blocks: Matrix) -> Matrix:
    """Return the covariance of the score by its sums over blocks (b, p), neighbours correlated (Newey & West 1987)."""
    later = blocks[1:].T @ blocks[:-1]
    return blocks.T @ blocks + 0.5 * (later + later.T)


def widen(covariance: Matrix, other: Matrix) -> Matrix:
    """Return the covariance with the variances of the other where these are larger, and its own correlations."""
    ratio = np.diag(other) / np.diag(covariance)
    scale = np.sqrt(np.maximum(ratio, 1.0))
    return scale[:, None] * covariance * scale


def without_estimate(offset: Vector, prior_std: Vector) -> Matrix:
    """Return the covariance where the search did not converge: the prior's, and the distance from its mean."""
    return np.diag(prior_std**2) + np.outer(offset, offset)


def misfit_of(offset: Vector, prior_std: Vector) -> float:
    """Return the root mean square of constants over their prior standard deviations, at least one.

    Effects that the model lacks shift constants whose priors hold for any flight; by this ratio all
    standard deviations are too small (Birge 1932).
    """
    return max(1.0, float(np.sqrt(np.mean((offset / prior_std) ** 2))))


def inflate_for_misfit(covariance: Matrix, misfit: float) -> Matrix:
    """Return the covariance times the square of the misfit (Birge 1932)."""
    return covariance * misfit**2


def add_model_error(covariance: Matrix, derivatives: Vector, fraction: float) -> Matrix:
    """Return the covariance with independent errors of the derivatives, the first parameters, by a linear model."""
    n = len(derivatives)
    total = covariance.copy()
    total[:n, :n] += np.diag((fraction * derivatives) ** 2)
    return total


def add_scale_error(covariance: Matrix, slopes: Vector, fraction: float) -> Matrix:
    """Return the covariance with a relative error that all slopes by one angle share."""
    n = len(slopes)
    total = covariance.copy()
    error = fraction * slopes
    total[:n, :n] += np.outer(error, error)
    return total


def mix_with_prior(covariance: Matrix, prior_std: Vector, fraction: Vector) -> Matrix:
    """Return the covariance where a ``fraction`` (p,) of each parameter's evidence is error of the sensors.

    Variances are means of estimate and prior, weighted by one less the squared fraction, and by it.
    """
    weight = np.sqrt(1 - fraction**2)
    return weight[:, None] * covariance * weight + np.diag((fraction * prior_std) ** 2)
