"""Noise covariance: each output's own noise, and the noise that regressors carry into all outputs of a sample.

To first order a regressor that is off by e, e ~ N(0, S), moves the outputs of sample a by J_a e, with the slopes J_a of
the posterior mean: their noise has the covariance diag(sigma^2) + J_a S J_a^T (McHutchon & Rasmussen 2011), the same e
in every output. With G = J R, S = R diag(s) R^T, this is diag(sigma^2) + G_a diag(s) G_a^T.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np


class SampleNoise(NamedTuple):
    """Of each output: which sample each value is of, (n_i,), and where noisy regressors carry it, G (n_i, r)."""

    sample: list[np.ndarray]
    loading: list[np.ndarray]

    @classmethod
    def from_table(cls, seen, loading) -> SampleNoise:
        """Return what belongs to the observed values, ``seen`` (n, P), of ``loading`` (n, P, r)."""
        return cls([np.flatnonzero(s) for s in seen.T], [loading[s, i] for i, s in enumerate(seen.T)])

    def joined(self, other: SampleNoise) -> SampleNoise:
        """Return these values, then the other's, which are of other samples."""
        first = 1 + max((s.max() for s in self.sample if len(s)), default=-1)
        sample = [np.concatenate([a, b + first]) for a, b in zip(self.sample, other.sample, strict=True)]
        return SampleNoise(sample, [np.concatenate(pair) for pair in zip(self.loading, other.loading, strict=True)])

    def pairs(self):
        """Yield the places, rows and columns among the stacked values, of two values of one sample, and their loading.

        Rows are not below columns, and every pair of outputs comes once: (i, j, rows, columns, G_i, G_j).
        """
        start = np.cumsum([0, *map(len, self.sample)])
        for i, j in combinations_with_replacement(range(len(self.sample)), 2):
            _, a, b = np.intersect1d(self.sample[i], self.sample[j], assume_unique=True, return_indices=True)
            yield i, j, start[i] + a, start[j] + b, self.loading[i][a], self.loading[j][b]


Scatter = SampleNoise  # its name in model files of version 0.1


def add_noise(K, noise, data) -> None:
    """Add the noise to the upper triangle of a covariance matrix of the values, (N, N) in C order.

    Parameters
    ----------
    K : ndarray (N, N)
    noise : ndarray (P,) or (P + r,)
        Variance of each output, then s where that is not one.
    data : Data
    """
    P = len(data.y)
    np.einsum("ii->i", K)[:] += np.repeat(noise[:P], [len(y) for y in data.y])
    if data.sample_noise is not None:
        scale = noise[P:] if len(noise) > P else 1.0
        for _, _, rows, columns, first, second in data.sample_noise.pairs():
            K[rows, columns] += np.einsum("nr,nr->n", first * scale, second)


def draw_noise(noise, data, n_draws, random_state) -> np.ndarray:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) is the outputs' own."""
    own = np.repeat(np.sqrt(noise), [len(y) for y in data.y])
    drawn = own * random_state.standard_normal((n_draws, len(own)))
    if data.sample_noise is not None:
        n_samples = 1 + max(s.max() for s in data.sample_noise.sample if len(s))
        off = random_state.standard_normal((n_draws, n_samples, data.sample_noise.loading[0].shape[1]))
        carried = [np.einsum("snr,nr->sn", off[:, s], G) for s, G in zip(*data.sample_noise, strict=True)]
        drawn += np.hstack(carried)
    return drawn


def noise_gradient(W, noise, data) -> np.ndarray:
    """Return 1/2 sum(W * dK / d log noise), (P,) or (P + r,), of a W whose upper triangle is read."""
    P = len(data.y)
    outputs = np.repeat(np.arange(P), [len(y) for y in data.y])  # an output without values has no share
    own = 0.5 * noise[:P] * np.bincount(outputs, np.einsum("ii->i", W), minlength=P)
    if len(noise) == P:
        return own
    carried = np.zeros(len(noise) - P)
    for i, j, rows, columns, first, second in data.sample_noise.pairs():
        carried += (0.5 if i == j else 1.0) * np.einsum("n,nr,nr->r", W[rows, columns], first, second)
    return np.concatenate([own, noise[P:] * carried])
