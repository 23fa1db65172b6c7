"""The gradient of the sparse bound, a second sum over samples."""

from __future__ import annotations

import numpy as np

from skdgp._compute.linalg import triangular_solve
from skdgp.inference._samples import sample_slope
from skdgp.inference._shares import bound_slope


def bound_gradient(posterior) -> np.ndarray:
    """Return the gradient of the bound by [kernel theta, log noise, features theta]."""
    a, kernel, features = posterior.weights, posterior.kernel, posterior.features
    Lu, one = posterior.Lu, np.eye(features.size)
    gap = _coloured(Lu, one - posterior.B_inverse)  # Kuu^-1 - (Kuu + sum Kuf Kfu / noise)^-1
    Wuu = 0.5 * (_coloured(Lu, 2 * one - posterior.B_inverse - posterior.B) - np.outer(a, a))
    slopes = kernel, features, posterior.noise, a, gap, posterior.shares
    if posterior.statistics is None:
        total, diagonal, d_noise = sample_slope(*slopes)
    else:
        total, diagonal = bound_slope(*slopes)
        n_values = np.array([s.n for s in posterior.statistics])
        d_noise = 0.5 * n_values * (posterior.noise_seen() / posterior.noise - 1)
    total += features.gradient_uu(Wuu)
    n = kernel.n_dims
    return np.concatenate([total[:n] + diagonal, d_noise, total[n:]])


def _coloured(Lu, M):
    """Return Lu^-T M Lu^-1 of a symmetric M, (K, K)."""
    half = triangular_solve(Lu, np.asfortranarray(M), transposed=True)
    return triangular_solve(Lu, np.asfortranarray(half.T), transposed=True)
