"""The largest correlation between outputs, and the shift at which it is."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize
from sklearn.utils import Bunch


def output_correlation(kernel):
    """Return the largest correlation between outputs over all separations, and the separation where it is.

    For a stationary kernel the correlation of output i at s + delta with output j at s is
    K_ij(delta) / sqrt(K_ii(0) K_jj(0)). Its extremes are sought by gradient ascent from the separations where the
    kernel's own terms peak.

    Parameters
    ----------
    kernel : MultiOutputKernel
        Stationary.

    Returns
    -------
    Bunch
        ``correlation`` (P, P) and ``shift`` (P, P, d), which is antisymmetric in its outputs.
    """
    P, n_features = kernel.n_outputs, kernel.n_features
    correlation, shift = np.eye(P), np.zeros((P, P, n_features))
    scale = np.sqrt([kernel.block_diag(i, np.zeros((1, n_features)))[0] for i in range(P)])
    for i in range(P):
        for j in range(i):
            value, where = _extreme(kernel, i, j, n_features)
            size = scale[i] * scale[j]
            correlation[i, j] = correlation[j, i] = np.clip(value / size, -1, 1) if size > 0 else 0.0
            shift[i, j], shift[j, i] = where, -where
    return Bunch(correlation=correlation, shift=shift)


def _extreme(kernel, i, j, d):
    """Return K_ij where it is largest in size, and where that is."""
    origin = np.zeros((1, d))
    starts = np.unique(np.concatenate([origin, kernel.peaks(i, j)]), axis=0)
    found = [(kernel.block(i, j, s[None], origin)[0, 0], s) for s in starts]
    value, where = max(found, key=lambda pair: abs(pair[0]))
    if value == 0.0:
        return 0.0, np.zeros(d)

    def descend(separation):
        s = separation[None]
        ratio = kernel.block(i, j, s, origin)[0, 0] / value
        slope = kernel.block_derivative(i, j, s, origin)[:, 0, 0] / value
        return -ratio, -slope

    end = minimize(descend, where, jac=True, method="BFGS", options={"gtol": 1e-8})
    return value * -end.fun, end.x
