"""The largest correlation between outputs and its separation."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize
from sklearn.utils import Bunch


def output_correlation(kernel: Any) -> Bunch:
    """Return the largest correlation between outputs over all separations, and the separation of that maximum.

    For a stationary kernel the correlation of output i at s + delta with output j at s is K_ij(delta) / sqrt(K_ii(0)
    K_jj(0)). Its extremes are found by gradient ascent from the separations at which the terms of the kernel are
    largest. The result has ``correlation`` (P, P) and ``shift`` (P, P, d), antisymmetric in the outputs.
    """
    P, n_features = kernel.n_outputs, kernel.n_features
    correlation, shift = np.eye(P), np.zeros((P, P, n_features))
    scale = np.sqrt([kernel.block_diag(i, np.zeros((1, n_features)))[0] for i in range(P)])
    for i in range(P):
        for j in range(i):
            value, separation = _extreme(kernel, i, j, n_features)
            size = scale[i] * scale[j]
            correlation[i, j] = correlation[j, i] = np.clip(value / size, -1, 1) if size > 0 else 0.0
            shift[i, j], shift[j, i] = separation, -separation
    return Bunch(correlation=correlation, shift=shift)


def _extreme(kernel, i, j, d):
    """Return the value of K_ij that is largest in magnitude, and its separation (d,)."""
    origin = np.zeros((1, d))
    starts = np.unique(np.concatenate([origin, kernel.peaks(i, j)]), axis=0)
    candidates = [(kernel.block(i, j, s[None], origin)[0, 0], s) for s in starts]
    value, start = max(candidates, key=lambda pair: abs(pair[0]))
    if value == 0.0:
        return 0.0, np.zeros(d)

    def loss(separation):
        s = separation[None]
        ratio = kernel.block(i, j, s, origin)[0, 0] / value
        slope = kernel.block_derivative(i, j, s, origin)[:, 0, 0] / value
        return -ratio, -slope

    optimum = minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-8})
    return value * -optimum.fun, optimum.x
