"""Errors that are expected of a posterior after further rows, whose regressors alone are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import column_scale
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.inference._errors import (
    SETTINGS,
    ErrorSettings,
    FunctionErrors,
    PosteriorWithErrors,
    bias_ratio,
    linear_basis,
    mean_noise,
    no_errors,
)
from skdgp.inference._misfit import Misfit
from skdgp.inference._posterior import Posterior

# Functions drawn for the covariance of slopes: standard deviations within 5 %
N_PATHS = 200


class ExpectedErrors(NamedTuple):
    r"""Errors that are expected of a posterior after further rows.

    Of an output with noise of variance :math:`s^2`, rows Q = (1, x - c) make the variance
    :math:`\Sigma` of value and slopes at the centre c

    .. math:: \Sigma' = (\Sigma^{-1} + Q^T Q / s^2)^{-1}

    (Bishop 2006, section 3.3). Of the other errors those that are correlated in time fall as of least
    squares, biases by gusts and by noise of the regressors as the inverse of the covariance of the
    regressors. More rows show more of the discrepancy, by `Misfit.expected`, with the width of all rows.
    """

    #: Standard deviations of the posterior's slopes over those without the rows, (P, d)
    narrowing: Matrix
    #: The errors that the posterior does not hold
    errors: FunctionErrors


@one_blas_thread()
def expected_errors(
    posterior: Posterior,
    added: Matrix,
    misfit: Misfit | None = None,
    settings: ErrorSettings = SETTINGS,
) -> ExpectedErrors:
    """Return the errors that are expected of a posterior that has learned from further rows too.

    With too few rows for a line nothing changes.

    Parameters
    ----------
    posterior : Posterior
    added : ndarray (k, d)
        Regressors of the further rows.
    misfit : Misfit or None
        That the present rows show, from which the discrepancy follows; None: it stays.
    settings : ErrorSettings

    Returns
    -------
    ExpectedErrors
    """
    errors = no_errors(posterior.data)
    if isinstance(posterior, PosteriorWithErrors):
        errors = posterior.errors
        posterior = posterior.posterior
    X = posterior.data.X
    longest = max(X, key=len)
    narrowing = np.ones((len(X), added.shape[1]))
    if min(map(len, X)) < settings.fewest * (1 + added.shape[1]):
        return ExpectedErrors(narrowing, errors)

    centre = longest.mean(axis=0)
    scale = column_scale(longest)
    Q_added = linear_basis((added - centre) / scale)
    lines = _drawn_lines(posterior, centre, scale)
    random = errors.random.copy()
    bias = errors.method.copy()
    for i, (x, noise) in enumerate(zip(X, mean_noise(posterior), strict=True)):
        narrowing[i] = _narrowing(np.cov(lines[:, i].T), Q_added, noise, settings)
        Q = linear_basis((x - centre) / scale)
        random[:, 1:, i] *= _least_squares_ratio(Q, Q_added, settings)
        slopes = bias[:, 1:, i]
        is_biased = np.any(slopes != 0, axis=0)
        ratio = bias_ratio(x, np.vstack([x, added]), settings)
        bias[:, 1:, i] = is_biased * (slopes @ ratio.T)
    discrepancy = errors.discrepancy
    if misfit is not None:
        discrepancy = np.maximum(discrepancy, misfit.expected(1.0 + len(added) / len(longest)))
    width = column_scale(np.vstack([longest, added]))
    later = errors._replace(random=random, method=bias, discrepancy=discrepancy, length_scale=width)
    return ExpectedErrors(narrowing, later)


def _drawn_lines(posterior: Posterior, centre: Vector, scale: Vector) -> Array:
    """Return value and slopes at the centre of drawn functions, (n_paths, P, 1 + d)."""
    paths = posterior.paths(N_PATHS, 0)
    values = paths.each(centre[None, None])[:, 0]
    slopes = paths.slopes(centre[None, None])[:, 0] * scale
    return np.concatenate([values[..., None], slopes], axis=-1)


def _narrowing(covariance: Matrix, Q: Matrix, noise: float, settings: ErrorSettings) -> Vector:
    """Return the ratios (d,) of standard deviations of slopes with and without rows Q (k, 1 + d)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    # of value and slopes in units of their standard deviations
    correlation = covariance / np.outer(scale, scale)
    Q = Q * scale
    information = settings.inverse(correlation) + Q.T @ Q / noise
    after = np.diag(settings.inverse(information))
    return np.sqrt(np.clip(after, 0.0, 1.0))[1:]


def _least_squares_ratio(Q: Matrix, added: Matrix, settings: ErrorSettings) -> Vector:
    """Return the ratios (d,) of standard deviations of slopes of least squares with and without added rows."""
    before = np.diag(settings.inverse(Q.T @ Q))
    after = np.diag(settings.inverse(Q.T @ Q + added.T @ added))
    ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
    return np.sqrt(np.minimum(ratio, 1.0))[1:]
