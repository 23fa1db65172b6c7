"""Missing outputs of a row from the other outputs of the same row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, minimize
from scipy.spatial.distance import cdist

from skdgp._compute.linalg import (
    check_memory,
    cholesky_solve,
    column_scale,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix, Vector


@dataclass(frozen=True)
class ImputeSettings:
    """The process of a missing measurement, given other outputs of the row."""

    #: Of the means over near rows, in standard deviations of the regressors
    bandwidths: tuple[float, ...] = (0.02, 0.05, 0.1)
    #: Most rows for hyperparameters
    search_rows: int = 300
    #: Most rows for the posterior of one output
    rows: int = 3000
    #: Most iterations of the search
    iterations: int = 40
    #: Fewest rows with the output observed
    least_rows: int = 10
    #: Starting values of a, l, b, c, w and the noise variance (``covariance``)
    start: tuple[float, ...] = (1.0, 1.0, 0.3, 0.1, 4.0, 0.1)
    #: Their lower bounds
    lower: tuple[float, ...] = (1e-5, 1e-2, 1e-6, 1e-6, 1e-1, 1e-6)
    #: Their upper bounds
    upper: tuple[float, ...] = (1e5, 1e3, 1e3, 1e3, 1e3, 1e2)


SETTINGS = ImputeSettings()
REMEDY = "Give fewer rows at a time, the ones with missing values and their neighbours."


def imputed(X: Matrix, Y: Matrix, mean: Matrix, std: Matrix) -> tuple[Matrix, Matrix]:
    """Return Y (n, P) with missing values replaced, and their standard deviations, zero where observed.

    For the equations see ``DependentGPRegressor.impute``. ``mean`` and ``std`` (n, P) are
    predictions from the regressors alone. They stand for other outputs that are missing too, and
    for values whose row has no output that is mostly known where theirs is missing.
    """
    check_memory(len(X), "Imputation in", REMEDY, n_matrices=3)
    missing = np.isnan(Y)
    value = np.where(missing, mean, Y)
    deviation = np.where(missing, std, 0.0)
    table = value.copy()
    takes_logarithm = []
    for p, rows in enumerate(missing.T):
        takes_logarithm.append(closer_to_normal(Y[~rows, p], value[:, p], SETTINGS.least_rows))
        if takes_logarithm[p]:
            table[:, p] = np.log(value[:, p])
    scaled = (table - table.mean(axis=0)) / column_scale(table)
    x = (X - X.mean(axis=0)) / column_scale(X)
    for p, rows in enumerate(missing.T):
        if not rows.any() or np.sum(~rows) < SETTINGS.least_rows:
            continue
        informative = missing[rows].mean(axis=0) < 0.5
        asked = rows & ~missing[:, informative].all(axis=1)
        if asked.any():
            learned = np.flatnonzero(~rows)
            y = table[learned, p]
            moments = conditional(x, scaled[:, informative], y, learned, asked)
            if takes_logarithm[p]:
                moments = log_normal(*moments)
            value[asked, p], deviation[asked, p] = moments
    return value, deviation


def closer_to_normal(y: Vector, filled: Vector, least_rows: int) -> bool:
    """Return whether log y has a larger normal likelihood than y, both as densities of y."""
    if np.min(filled) <= 0 or len(y) < least_rows or np.ptp(y) == 0:
        return False
    logarithm = np.log(y)
    return bool(np.log(np.std(logarithm)) + logarithm.mean() < np.log(np.std(y)))


def log_normal(mean: Vector, std: Vector) -> tuple[Vector, Vector]:
    """Return median and standard deviation of exp(z), where z is normal."""
    median, variance = np.exp(mean), std**2
    return median, median * np.sqrt(np.exp(variance) * np.expm1(variance))


@one_blas_thread()
def conditional(
    x: Matrix,
    others: Matrix,
    y: Vector,
    learned: Indices,
    asked: Matrix,
) -> tuple[Vector, Vector]:
    """Return mean and standard deviation of a measurement in the rows ``asked``, from y (m,) in ``learned``.

    They are of the mixture, with equal weights, of the processes for each bandwidth.
    """
    selected = evenly(len(y), SETTINGS.search_rows)
    most = evenly(len(y), SETTINGS.rows)
    predictions = []
    for bandwidth in SETTINGS.bandwidths:
        table = inputs(x, others, bandwidth)
        searched = [part[learned[selected]] for part in table]
        theta = likeliest(searched, y[selected])
        rows = [part[learned[most]] for part in table]
        wanted = [part[asked] for part in table]
        predictions.append(predicted(theta, rows, y[most], wanted))
    means, stds = np.array(predictions).swapaxes(0, 1)
    mean = means.mean(axis=0)
    return mean, np.sqrt(np.mean(stds**2 + (means - mean) ** 2, axis=0))


def evenly(n: int, most: int) -> Indices:
    """Return at most so many of n places, evenly spread."""
    return np.linspace(0, n - 1, min(n, most)).astype(int)


def inputs(x: Matrix, others: Matrix, bandwidth: float) -> list[Matrix]:
    """Return x, the means of the others over near rows beside deviations from these, and the others."""
    weights = np.exp(-0.5 * cdist(x, x, "sqeuclidean") / bandwidth**2)
    smooth = weights @ others / weights.sum(axis=1, keepdims=True)
    return [x, np.hstack([smooth, others - smooth]), others]


def relations(first: list[Matrix], second: list[Matrix]) -> list[Matrix]:
    """Return the distances in x, the products, and the squared distances of the others between rows, (n, m) each."""
    return [
        cdist(first[0], second[0]),
        first[1] @ second[1].T,
        cdist(first[2], second[2], "sqeuclidean"),
    ]


def covariance(theta: Vector, between: list[Matrix]) -> tuple[Matrix, list[Matrix]]:
    r"""Return the covariance of rows with these relations r, p, q, and its slopes by theta but the noise.

    .. math:: k = a e^{-r / l} + b p + c\, e^{-q / 2 w^2} + 1, \quad \theta = \log(a, l, b, c, w, \sigma^2).
    """
    distance, product, square = between
    a, length, b, c, width, _ = np.exp(theta)
    rough = a * np.exp(-distance / length)
    smooth = c * np.exp(-0.5 * square / width**2)
    slopes = [rough, rough * distance / length, b * product, smooth, smooth * square / width**2]
    return rough + b * product + smooth + 1.0, slopes


def factor(K: Matrix, theta: Vector) -> Matrix:
    """Return the lower Cholesky factor of the covariance of measurements."""
    return jittered_cholesky(lambda: np.asfortranarray(K + np.exp(theta[-1]) * np.eye(len(K))))


def likeliest(rows: list[Matrix], y: Vector) -> Vector:
    """Return the hyperparameters of the largest marginal likelihood of the standardised y."""
    between = relations(rows, rows)
    z = (y - y.mean()) / column_scale(y[:, None])[0]

    def loss(theta):
        K, slopes = covariance(theta, between)
        L = factor(K, theta)
        inverse = cholesky_solve(L, np.eye(len(z)))
        weights = inverse @ z
        W = inverse - np.outer(weights, weights)  # Rasmussen & Williams 2006, equation 5.9
        slopes.append(np.exp(theta[-1]) * np.eye(len(z)))
        value = 0.5 * (z @ weights + log_determinant(L))
        return value, np.array([0.5 * np.sum(W * slope) for slope in slopes])

    start = np.log(SETTINGS.start)
    bounds = Bounds(np.log(SETTINGS.lower), np.log(SETTINGS.upper))
    options: Any = {"maxiter": SETTINGS.iterations}
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x


def predicted(
    theta: Vector, rows: list[Matrix], y: Vector, wanted: list[Matrix]
) -> tuple[Vector, Vector]:
    """Return mean and standard deviation of a measurement in the wanted rows."""
    scale = column_scale(y[:, None])[0]
    L = factor(covariance(theta, relations(rows, rows))[0], theta)
    cross = covariance(theta, relations(rows, wanted))[0]
    a, _, b, c, _, noise = np.exp(theta)
    prior = a + b * np.sum(wanted[1] ** 2, axis=1) + c + 1.0 + noise
    mean = y.mean() + scale * (cross.T @ cholesky_solve(L, (y - y.mean()) / scale))
    explained = np.sum(triangular_solve(L, np.asfortranarray(cross)) ** 2, axis=0)
    return mean, scale * np.sqrt(prior - explained)
