"""Errors of slopes that the standard deviations of a posterior do not contain, estimated from polynomials.

A posterior states the scatter of its slopes for the learned noise and widths, with independent errors. But errors of
neighbouring samples and of different outputs are correlated, and the widths may be wrong: gusts flatten slopes where
the motion is small, and functions that are too simple average the curvature. Three polynomials have other errors: of
first order of all samples, of first order of the half with the smallest motion, and of second order without the part of
the errors that past errors predict, which gusts do not flatten. Their differences show how large such errors are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Array, Matrix
from skdgp.inference._compact import observed_values
from skdgp.inference._unpredicted import unpredicted

BLOCKS = 60  # blocks of the log; errors of different blocks are taken as independent
BLOCK_ROWS = 10  # fewest samples in a block
FEWEST = 5  # smallest number of samples for each weight of a polynomial
QUIET = 0.5  # share of the samples, those nearest to the mean, of the quiet polynomial
LAGS = range(2, 9)  # samples to the past errors that predict an error; smoothing mixes the next one with it


class SlopeErrors(NamedTuple):
    """Errors of slopes at points (n, d): sums of the last axis times independent standard normal numbers."""

    random: Array
    """Errors by noise that is correlated between samples and between outputs, (n, P, d, n_blocks)."""
    method: Array
    """Differences of the posterior and each polynomial from their mean, (n, P, d, n_methods)."""
    white: Array
    """Standard deviation that ``random`` would have if errors of samples were independent, (n, P, d)."""
    n_samples: int

    def scaled(self, factor: Array) -> SlopeErrors:
        """Return the errors of slopes times ``factor``, which broadcasts to (n, P, d)."""
        factor = np.asarray(factor)
        random, method = (part * factor[..., None] for part in (self.random, self.method))
        return SlopeErrors(random, method, self.white * factor, self.n_samples)

    def take(self, outputs: Any) -> SlopeErrors:
        """Return the errors of some outputs."""
        return SlopeErrors(self.random[:, outputs], self.method[:, outputs], self.white[:, outputs], self.n_samples)


def slope_errors(posterior: Any, X: Matrix) -> SlopeErrors | None:
    r"""Return the errors of the slopes of a posterior at X (n, d), or None if there are too few samples.

    The polynomial of highest order has the weights :math:`w = G \sum_b Q_b^T y_b` with blocks b of consecutive samples
    and :math:`G = (\sum_b Q_b^T Q_b)^{-1}`. With residuals r its error is a sum over blocks of :math:`G Q_b^T r_b`,
    whatever the correlation within a block and between outputs (Liang & Zeger 1986). Copies of a
    sample, as of mirrored flights, err together.
    """
    if getattr(posterior, "shares", ()) is None:
        return None
    data = observed_values(posterior)
    parts = [_of_output(x, y, X) for x, y in zip(data.X, data.y, strict=True)]
    if any(part is None for part in parts):
        return None
    n_blocks = max(part[1].shape[-1] for part in parts)
    random = [np.pad(part[1], [(0, 0), (0, 0), (0, n_blocks - part[1].shape[-1])]) for part in parts]
    slopes = np.stack([posterior.gradient(X), *_common([part[0] for part in parts])], axis=-1)
    method = (slopes - slopes.mean(axis=-1, keepdims=True)) / np.sqrt(slopes.shape[-1] - 1)
    white, n_copies = np.stack([part[2] for part in parts], axis=1), getattr(posterior, "n_copies", 1)
    random, white = (np.sqrt(n_copies) * part for part in (np.stack(random, axis=1), white))
    return SlopeErrors(random, method, white, max(map(len, data.y)) // n_copies)


def _common(slopes):
    """Return the slopes of each polynomial that all outputs have, (n, P, d) each."""
    return [np.stack(of_outputs, axis=1) for of_outputs in zip(*slopes, strict=False)]


def _of_output(x, y, X):
    """Return the slopes (n, d) by each polynomial, the error (n, d, n_blocks) of the finest, and its white std."""
    n, d = x.shape
    if n < FEWEST * (d + 1) / QUIET:
        return None
    centre, scale = x.mean(axis=0), column_scale(x)
    z, at = (x - centre) / scale, (X - centre) / scale
    distance = np.einsum("ni,ij,nj->n", z, np.linalg.pinv(np.cov(z.T).reshape(d, d), hermitian=True), z)
    quiet = distance <= np.quantile(distance, QUIET)
    fits = [_Polynomial(_line, z[quiet], y[quiet]), _Polynomial(_line, z, y)]
    finest = fits[-1]
    if n >= FEWEST * (1 + d + d * (d + 1) // 2):
        finest, Q = _Polynomial(_parabola, z, y), np.linalg.qr(_parabola(z))[0]
        clean = unpredicted(Q, y[:, None], LAGS, [slice(n)], np.ones(n, bool))
        fits.append(_Polynomial(_parabola, z, clean[:, 0]))
    error, white = finest.error(at)
    return [fit.slopes(at) / scale for fit in fits], error / scale[:, None], white / scale


class _Polynomial:
    """Least squares in a basis, from sums over blocks of consecutive samples."""

    def __init__(self, basis: Any, z: Matrix, y: Array) -> None:
        self.basis, self.n = basis, len(y)
        blocks = np.array_split(np.arange(len(y)), int(np.clip(len(y) // BLOCK_ROWS, 2, BLOCKS)))
        sums = [(Q.T @ Q, Q.T @ y[rows], y[rows] @ y[rows]) for rows in blocks for Q in [basis(z[rows])]]
        self.outer, self.inner, square = (np.array(part) for part in zip(*sums, strict=True))
        self.inverse = np.linalg.pinv(self.outer.sum(axis=0), hermitian=True)
        self.weights = self.inverse @ self.inner.sum(axis=0)
        left = square.sum() - self.weights @ self.inner.sum(axis=0)
        self.variance = max(float(left), 0.0) / max(self.n - len(self.weights), 1)

    def slopes(self, at: Matrix) -> Array:
        """Return the slopes (n, d) at points (n, d)."""
        return _slopes_of(self.basis, at) @ self.weights

    def error(self, at: Matrix) -> tuple[Array, Array]:
        """Return the error of the slopes (n, d, n_blocks), and its deviation (n, d) if samples were independent."""
        D, n_blocks = _slopes_of(self.basis, at) @ self.inverse, len(self.inner)
        scores = self.inner - self.outer @ self.weights
        error = D @ scores.T * np.sqrt(n_blocks / (n_blocks - 1))
        return error, np.sqrt(self.variance * np.einsum("nkp,pq,nkq->nk", D, self.outer.sum(axis=0), D))


def _line(z):
    return np.column_stack([np.ones(len(z)), z])


def _parabola(z):
    first, second = np.triu_indices(z.shape[1])
    return np.column_stack([_line(z), z[:, first] * z[:, second]])


def _slopes_of(basis, at):
    """Return d basis / d z at points (n, d), (n, d, p): differences, which are exact up to second order."""
    d = at.shape[1]
    steps = np.eye(d)
    change = [basis(at + step) - basis(at - step) for step in steps]
    return 0.5 * np.stack(change, axis=1)
