"""Features of all outputs at few samples: one matrix product, one exponential.

``sizes`` (P,) says how many columns are each output's.
"""

from __future__ import annotations

import numpy as np

from skdgp.kernels._strips import FAR


class ExponentialRows:
    """Covariances of outputs with further ones, or with values, of a convolved Gaussian, one column after another.

    Each latent that feeds both has columns of its own. Every column is gain * exp(-1/2 |F (x - mu - z)|^2). With x
    taken from a middle, the square is |F x|^2, the same for all columns of a pair and latent, plus what is linear in x.

    Parameters
    ----------
    joint : ConvolvedGaussian
    columns : list of lists of (j, Z)
        For each output: another output, and where it stands, (k, d).
    """

    def __init__(self, joint, columns):
        self.sizes = np.array(
            [sum(len(Z) * len(joint._pair(i, j)[1]) for j, Z in own) for i, own in enumerate(columns)]
        )
        self.joint = joint
        self.columns = columns = [(i, j, Z) for i, own in enumerate(columns) for j, Z in own if len(Z)]
        d = joint.n_features
        self.middle = np.concatenate([Z for *_, Z in columns]).mean(axis=0) if columns else np.zeros(d)
        roots, slopes, constants, counts = [], [], [], []
        for i, j, Z in columns:
            _, gains, _, F, shifts = joint._pair(i, j)
            for gain, root, mu in zip(gains, F, shifts, strict=True):
                root = np.diag(root) if root.ndim == 1 else root
                b = (Z - self.middle + mu) @ root
                roots.append(root)
                slopes.append(b @ root.T)
                constants.append(np.stack([-0.5 * np.einsum("kd,kd->k", b, b), np.full(len(b), gain)]))
                counts.append(len(b))
        self.diagonal = all(np.count_nonzero(F - np.diag(np.diag(F))) == 0 for F in roots)
        self.roots = np.array([np.diag(F) ** 2 for F in roots]).T if self.diagonal else np.hstack(roots)
        self.slopes = np.concatenate([np.zeros((0, d)), *slopes]).T.copy()
        self.constant, self.gain = np.hstack([np.zeros((2, 0)), *constants])
        self.counts = np.array(counts, dtype=int)
        self.far = -self.constant.min(initial=0.0) > FAR

    def __call__(self, X) -> np.ndarray:
        """Return all columns at X (n, d), (n, C)."""
        if self.far:
            return np.hstack([np.empty((len(X), 0)), *(self.joint.terms(i, j, X, Z) for i, j, Z in self.columns)])
        x = X - self.middle
        if self.diagonal:
            squares = (x * x) @ self.roots
        else:
            squares = ((x @ self.roots).reshape(len(x), len(self.counts), -1) ** 2).sum(axis=2)
        E = x @ self.slopes
        E += self.constant
        E -= np.repeat(0.5 * squares, self.counts, axis=1)
        np.exp(E, out=E)
        E *= self.gain
        return E


class TrendRows:
    """The basis functions of a trend of every output, (1, phi(x) - c) times their scales."""

    def __init__(self, kernel):
        self.columns = kernel.columns
        self.center = kernel._value("center")
        self.scales = np.column_stack([kernel._value("intercept_scale"), kernel._value("slope_scale")]).ravel()
        self.sizes = np.full(kernel.n_outputs, kernel.n_weights)

    def __call__(self, X) -> np.ndarray:
        """Return all columns at X (n, d), (n, C)."""
        basis = np.column_stack([np.ones(len(X)), self.columns(X) - self.center])
        return np.tile(basis, len(self.sizes)) * self.scales


class SumRows:
    """Of the features of a sum: for each output those of the first term, then those of the second."""

    def __init__(self, first, second):
        self.first, self.second = first, second
        self.sizes = first.sizes + second.sizes
        parts = [np.split(np.arange(rows.sizes.sum()), np.cumsum(rows.sizes)[:-1]) for rows in (first, second)]
        offset = first.sizes.sum()
        self.order = np.concatenate([np.concatenate([a, offset + b]) for a, b in zip(*parts, strict=True)])

    def __call__(self, X) -> np.ndarray:
        """Return all columns at X (n, d), (n, C)."""
        return np.take(np.hstack([self.first(X), self.second(X)]), self.order, axis=1)
