"""How strongly outputs depend on each other, and with what shift."""

from __future__ import annotations

import numpy as np
from sklearn.utils import Bunch


def output_correlation(kernel, n_features):
    """Return the largest correlation between outputs over all separations, and the separation where it is.

    For a stationary kernel the correlation of output i at s + delta with output j at s is
    K_ij(delta) / sqrt(K_ii(0) K_jj(0)). Its extremes are sought by gradient ascent of its logarithm from zero and
    from each shift between the outputs' filters.
    """
    P = kernel.n_outputs
    correlation, shift = np.eye(P), np.zeros((P, P, n_features))
    scale = np.sqrt(np.array([kernel.block_diag(i, np.zeros((1, n_features)))[0] for i in range(P)]))
    for i in range(P):
        for j in range(i):
            value, where = _extreme(kernel, i, j, n_features)
            size = scale[i] * scale[j]
            correlation[i, j] = correlation[j, i] = value / size if size > 0 else 0.0
            shift[i, j], shift[j, i] = where, -where
    return Bunch(correlation=np.clip(correlation, -1, 1), shift=shift)


def _extreme(kernel, i, j, d):
    """Return K_ij where it is largest in size, and where that is."""
    origin = np.zeros((1, d))
    mu = getattr(kernel, "mu", np.zeros((0, kernel.n_outputs, d)))
    starts = np.unique(np.concatenate([origin, mu[:, i] - mu[:, j]]), axis=0)
    values = kernel.block(i, j, starts, origin)[:, 0]
    best = int(np.argmax(np.abs(values)))
    return values[best], starts[best]
