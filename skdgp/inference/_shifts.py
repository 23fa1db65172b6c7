"""Shifts of outputs relative to each other, from the cross-correlation of their separate fits.

In equation 16 two outputs that are translated copies of one function have one latent, and the
shifts mu of its filters differ. A search finds mu from starts that are at most one width away, so
it starts where the separate fits correlate most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skdgp._compute.linalg import constant_columns
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._blocks import spread_rows
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import ExactPosterior, ExactTerm, SinglePosterior
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class ShiftSettings:
    """Where shifts are looked for, and when one is a start for the search."""

    #: Largest shift, over the range of a regressor
    largest: float = 0.5
    #: Shifts from the largest negative to the largest positive one
    n_lags: int = 61
    #: Most samples at which functions are compared
    rows: int = 60
    #: Most values of each separate fit
    values: int = 200
    #: Least part of the samples where both functions are known
    overlap: float = 0.3
    #: Largest squared correlation that counts
    highest: float = 0.999
    #: Least rise of the squared correlation by a shift
    rise: float = 0.2
    #: Width, over the range of a regressor, from which shifts along it hardly change a function
    widest: float = 3.0


SETTINGS = ShiftSettings()


@one_blas_thread()
def found_shifts(
    singles: Sequence[MultiOutputKernel],
    noise: Vector,
    X: Matrix,
    Y: Matrix,
) -> tuple[Matrix, Matrix] | None:
    """Return the shift (P, d) of each output relative to the least noisy one, None where no shift correlates more.

    Beside it are the outputs without their shifts at X, (n, P), as far as separate fits know them.

    Parameters
    ----------
    singles : sequence of MultiOutputKernel
        Learned from each output alone.
    noise : ndarray (P,)
        Of these fits.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    """
    functions = []
    for i, single in enumerate(singles):
        functions.append(_process(single, noise[i : i + 1], X, Y[:, i]))
    reference = functions[noise.argmin()]
    shifts = np.array([_shift(function, reference, X) for function in functions])
    if not shifts.any():
        return None
    aligned = [f.predict(X + shift)[:, 0] for f, shift in zip(functions, shifts, strict=True)]
    return shifts, np.column_stack(aligned)


def _shift(function, reference, X) -> Vector:
    """Return the shift (d,) at which a function correlates most with another one, zero where it hardly gains."""
    points = X[spread_rows(X, SETTINGS.rows)]
    ranges = np.ptp(X, axis=0)
    lags = np.linspace(-SETTINGS.largest, SETTINGS.largest, SETTINGS.n_lags)
    unmoved = len(lags) // 2
    widths = [f.kernel.value("length_scale")[0, 0] for f in (function, reference)]
    varies = np.all(widths < SETTINGS.widest * ranges, axis=0) & ~constant_columns(X)
    present = _moments(reference, points)
    best, highest = np.zeros(X.shape[1]), 0.0
    for k in np.flatnonzero(varies):
        moved = np.repeat(points[None], len(lags), axis=0)
        moved[:, :, k] += ranges[k] * lags[:, None]
        later = _moments(function, moved.reshape(-1, X.shape[1]))
        squared, explained = _correlations(later, present, len(lags))
        lag = explained.argmax()
        gain = explained[lag] - explained[unmoved]
        if squared[lag] - squared[unmoved] >= SETTINGS.rise and gain > highest:
            best, highest = np.zeros(X.shape[1]), gain
            best[k] = ranges[k] * lags[lag]
    return best


def _process(kernel, noise, X, y) -> SinglePosterior:
    """Return the posterior of the process of all regressors, the last term of a kernel of one output."""
    observed = np.flatnonzero(np.isfinite(y))
    rows = observed[spread_rows(X[observed], SETTINGS.values)]
    posterior = ExactPosterior(kernel, noise, Data.from_table(X[rows], y[rows, None]))
    processes = [term for term in kernel.summands() if term.n_processes]
    return ExactTerm(posterior, processes[-1])


def _moments(function: SinglePosterior, X: Matrix) -> tuple[Vector, Vector]:
    """Return the mean, and the part of the prior variance that the data explain, (n,) each."""
    mean, variance = function.predict(X, return_variance=True)
    prior = function.kernel.block_diag(0, X)
    unknown = np.divide(variance[:, 0], prior, out=np.ones(len(X)), where=prior > 0)
    return mean[:, 0], np.maximum(1.0 - unknown, 0.0)


def _correlations(
    later: tuple[Vector, Vector],
    present: tuple[Vector, Vector],
    n_lags: int,
) -> tuple[Vector, Vector]:
    """Return the squared correlation of two functions for each lag, and how much of the samples it explains.

    It is zero where both functions are known at few samples. A correlation r of n samples explains
    -n log(1 - r^2), twice the rise of the likelihood of a linear dependence: that of many samples
    counts more.
    """
    a = later[0].reshape(n_lags, -1)
    c = present[0]
    weight = later[1].reshape(n_lags, -1) * present[1]
    overlap = weight.sum(axis=1)
    total = np.maximum(overlap, np.finfo(float).tiny)[:, None]
    a = a - np.sum(weight * a, axis=1, keepdims=True) / total
    c = c - np.sum(weight * c, axis=1, keepdims=True) / total
    product = np.sum(weight * a * c, axis=1) ** 2
    norms = np.sum(weight * a**2, axis=1) * np.sum(weight * c**2, axis=1)
    squared = np.divide(product, norms, out=np.zeros(n_lags), where=norms > 0)
    squared[overlap < SETTINGS.overlap * overlap.max(initial=0.0)] = 0.0
    explained = -overlap * np.log1p(-np.minimum(squared, SETTINGS.highest))
    return squared, explained


def price_of_shifts(shift: Matrix) -> float:
    """Return what a likelihood pays for shifts (P, d), each chosen among several before the search [nats].

    Along a regressor the outputs that have another shift than most others pay.
    """
    n_alike = [np.unique(along, return_counts=True)[1].max() for along in shift.T]
    n_chosen = shift.size - sum(n_alike)
    return float(n_chosen * np.log(SETTINGS.n_lags))
