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
    """Return the shift (P, d) of each output relative to one of them, or None where no shift correlates more.

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
    P, d = len(functions), X.shape[1]
    points = X[spread_rows(X, SETTINGS.rows)]
    lags = np.linspace(-SETTINGS.largest, SETTINGS.largest, SETTINGS.n_lags)
    gain = np.zeros((P, P))
    shift = np.zeros((P, P, d))
    ranges = np.ptp(X, axis=0)
    widths = np.array([function.kernel.value("length_scale")[0, 0] for function in functions])
    varies = np.sum(widths < SETTINGS.widest * ranges, axis=0) > 1
    for k in np.flatnonzero(varies & ~constant_columns(X)):
        higher, best = _gains(functions, points, k, ranges[k] * lags)
        better = higher > gain
        gain[better] = higher[better]
        shift[better] = 0.0
        shift[better, k] = best[better]
    # of two that only each other's shift explains, the one that is better known, in any order of the outputs
    reference = int(np.lexsort((-noise, gain.sum(axis=1).round(6)))[-1])
    relative = shift[reference]
    if not relative.any():
        return None
    aligned = [
        f.predict(X + of_output)[:, 0] for f, of_output in zip(functions, relative, strict=True)
    ]
    return relative, np.column_stack(aligned)


def _gains(functions, points, k, lags) -> tuple[Matrix, Matrix]:
    """Return what shifts of one output along regressor k explain of another one, and the best shifts, (P, P) each.

    Output i is compared at x - shift with output j at x. A gain is zero where the squared
    correlation hardly rises.
    """
    P, d = len(functions), points.shape[1]
    moved = np.repeat(points[None], len(lags), axis=0)
    moved[:, :, k] -= lags[:, None]
    present = [_moments(function, points) for function in functions]
    both = np.zeros((2, P, P, len(lags)))  # squared correlations, and what they explain
    for i, function in enumerate(functions):
        earlier = _moments(function, moved.reshape(-1, d))
        for j in range(P):
            both[:, i, j] = _correlations(earlier, present[j], len(lags))
    # j relative to i by a lag is i relative to j by minus the lag
    both = 0.5 * (both + both.swapaxes(1, 2)[..., ::-1])

    highest = both[1].argmax(axis=2)[..., None]
    unmoved = len(lags) // 2
    rise, gain = np.take_along_axis(both, highest[None], axis=3)[..., 0] - both[..., unmoved]
    return np.where(rise >= SETTINGS.rise, gain, 0.0), lags[highest[..., 0]]


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
    earlier: tuple[Vector, Vector],
    present: tuple[Vector, Vector],
    n_lags: int,
) -> tuple[Vector, Vector]:
    """Return the squared correlation of two functions for each lag, and how much of the samples it explains.

    It is zero where both functions are known at few samples. A correlation r of n samples explains
    -n log(1 - r^2), twice the rise of the likelihood of a linear dependence: that of many samples
    counts more.
    """
    a = earlier[0].reshape(n_lags, -1)
    c = present[0]
    weight = earlier[1].reshape(n_lags, -1) * present[1]
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
