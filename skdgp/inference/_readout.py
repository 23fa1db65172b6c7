"""Predictions from inducing features, by few matrix products."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skdgp._compute.linalg import semidefinite_root, triangular_solve, unexplained_variance
from skdgp.inference._shares import own_factor


class Readout:
    """Mean and variance of every output, from the features it feels.

    With whitened features V = Lu^-1 Kuf, the data took V^T (I - B^-1) V from the prior variance. With I - B^-1 = R R^T
    for the features of output i that is |Kfu Lu^-T R|^2, a product and a sum of squares.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    weights : ndarray (K,)
        Posterior mean of the features, coloured.
    """

    def __init__(self, kernel, features, weights):
        self.kernel, self.rows = kernel, features.rows()
        self.columns = [features.columns(i) for i in range(kernel.n_outputs)]
        edges = np.cumsum([0, *map(len, self.columns)])
        self.own = [slice(a, b) for a, b in pairwise(edges)]
        self.weights = np.zeros((edges[-1], kernel.n_outputs))
        for i, (own, columns) in enumerate(zip(self.own, self.columns, strict=True)):
            self.weights[own, i] = weights[columns]

    def roots(self, Lu, B_inverse) -> list[np.ndarray]:
        """Return Lu^-T R of the features of each output, (c, c)."""
        roots = []
        for columns in self.columns:
            learned = -B_inverse[np.ix_(columns, columns)]
            np.einsum("ii->i", learned)[:] += 1.0
            roots.append(triangular_solve(own_factor(Lu, columns), semidefinite_root(learned), transposed=True))
        return roots

    def mean(self, X) -> np.ndarray:
        """Return the mean at X (n, d), (n, P)."""
        return self.rows(X) @ self.weights

    def mean_and_variance(self, X, roots) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance at X (n, d), (n, P) each."""
        A = self.rows(X)
        variance = np.empty((len(X), len(self.own)))
        for i, (own, root) in enumerate(zip(self.own, roots, strict=True)):
            variance[:, i] = unexplained_variance(self.kernel.block_diag(i, X), learned_from(A[:, own], root))
        return A @ self.weights, variance


def learned_from(A, root):
    """Return what the data took from the variance of functions whose covariance with the features is A (n, c)."""
    half = A @ root
    return np.einsum("nc,nc->n", half, half)
