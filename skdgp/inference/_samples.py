"""Sums over samples for sparse inference where the noise is correlated between outputs.

The noise of sample a has a covariance between outputs, diag(sigma^2) + G_a G_a^T (see ``_noise``), and with its inverse
Pi_a the bound is a sum over samples of products of all pairs of outputs. A width_factor is, as a share is, summed by a
thread, a process or another machine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import triangular_solve
from skdgp._compute.parallel import share_map
from skdgp.inference._likelihood import Data
from skdgp.inference._shares import ROWS, data_of_values, own_factor, row_slices, statistics, value_shares
from skdgp.inference._sums import Sums

STRETCHES = 16
DIAGONAL_ROWS = 32  # of a covariance of which the diagonal alone is needed


class Stretch(NamedTuple):
    """A width_factor of samples: X (n, d), Y (n, P) with NaN where not observed, reach G (n, P, r)."""

    X: np.ndarray
    Y: np.ndarray
    reach: np.ndarray


def shares_of(data: Data) -> list:
    """Cut the observed values into shares, or into stretches where the outputs are noisy together."""
    return value_shares(data) if data.scatter is None else _stretches_of(data)


def data_of(shares, n_outputs) -> Data:
    """Return the observed values that were cut."""
    if not isinstance(shares[0], Stretch):
        return data_of_values(shares, n_outputs)
    X, Y, reach = (np.concatenate(part) for part in zip(*shares, strict=True))
    return Data.from_table(X, Y, reach)


def sums_of(kernel, features, noise, Lu, shares):
    """Return what conditioning asks of all values, and its parts by output where these are noisy apart, else None."""
    if shares and isinstance(shares[0], Stretch):
        parts = share_map(_sample_sums, (kernel, features, noise, Lu), shares)
        return Sums(*map(sum, zip(*parts, strict=True))), None
    found = statistics(kernel, features, Lu, shares)
    return Sums.of(features, noise, found), found


def _stretches_of(data):
    table = _table_of(data)
    parts = min(STRETCHES, -(-len(table.X) // ROWS))
    return [Stretch(*part) for part in zip(*(np.array_split(a, parts) for a in table), strict=True)]


def _table_of(data):
    samples, first = np.unique(np.concatenate(data.scatter.sample), return_index=True)
    n, P = len(samples), len(data.y)
    Y, reach = np.full((n, P), np.nan), np.zeros((n, P, data.scatter.reach[0].shape[1]))
    for i, (y, sample, G) in enumerate(zip(data.y, *data.scatter, strict=True)):
        rows = np.searchsorted(samples, sample)
        Y[rows, i], reach[rows, i] = y, G
    return Stretch(np.concatenate(data.X)[first], Y, reach)


def _sample_sums(kernel, features, noise, Lu, width_factor):
    P = kernel.n_outputs
    columns = [features.columns(i) for i in range(P)]
    factors = [own_factor(Lu, c) for c in columns]
    outer, inner = np.zeros((features.size, features.size)), np.zeros(features.size)
    rest = 0.0
    for rows in row_slices(len(width_factor.X)):
        X, Y, reach = (part[rows] for part in width_factor)
        precision, log_determinants = precisions(Y, reach, noise)
        Y = np.nan_to_num(Y)
        pulled = np.einsum("nij,nj->ni", precision, Y)
        V = [triangular_solve(factors[i], features.Kfu(i, X).T) for i in range(P)]
        for i, j in _pairs(P):
            block = (V[i] * precision[:, i, j]) @ V[j].T
            outer[np.ix_(columns[i], columns[j])] += block
            if i != j:
                outer[np.ix_(columns[j], columns[i])] += block.T
            rest += (1 if i == j else 2) * precision[:, i, j] @ _variance(kernel, i, j, X)
        for i in range(P):
            inner[columns[i]] += V[i] @ pulled[:, i]
        rest += log_determinants.sum() + np.sum(Y * pulled)
    return outer, inner, rest - np.trace(outer)


def sample_slope(kernel, features, noise, weights, gap, stretches):
    """Return the bound's gradient that sums over samples: by [kernel, features], kernel (of variances), log noise."""
    parts = share_map(_sample_slope, (kernel, features, noise, weights, gap), stretches)
    return tuple(np.sum(part, axis=0) for part in zip(*parts, strict=True))


def _sample_slope(kernel, features, noise, weights, gap, width_factor):
    P = kernel.n_outputs
    columns = [features.columns(i) for i in range(P)]
    total, diagonal, d_noise = 0.0, np.zeros(kernel.n_dims), np.zeros(P)
    for rows in row_slices(len(width_factor.X)):
        X, Y, reach = (part[rows] for part in width_factor)
        precision, _ = precisions(Y, reach, noise)
        A = [features.Kfu(i, X) for i in range(P)]
        residual = np.nan_to_num(Y) - np.column_stack([A[i] @ weights[columns[i]] for i in range(P)])
        pulled = np.einsum("nij,nj->ni", precision, residual)
        taken = [[A[j] @ gap[np.ix_(columns[j], columns[i])] for j in range(P)] for i in range(P)]
        uncertain = np.empty_like(precision)
        for i, j in _pairs(P):
            left = _variance(kernel, i, j, X) - np.einsum("nc,nc->n", A[i], taken[i][j])
            uncertain[:, i, j] = uncertain[:, j, i] = left
            w = -0.5 * precision[:, i, j]
            if i == j:
                diagonal += kernel.diag_gradient(i, X, w)
            elif kernel.couples(i, j):
                diagonal += sum(
                    kernel.block_gradient(i, j, X[some], X[some], np.diag(2 * w[some])) for some in _few(len(X))
                )
        for i in range(P):
            W = np.multiply.outer(pulled[:, i], weights[columns[i]])
            W += sum(precision[:, i, j, None] * taken[i][j] for j in range(P))
            total = total + features.gradient_fu(i, X, W)
        spread = np.einsum("nij,njk,nki->ni", precision, uncertain, precision)
        d_noise += 0.5 * noise * np.sum(pulled**2 + spread - np.einsum("nii->ni", precision), axis=0)
    return total, diagonal, d_noise


def precisions(Y, reach, noise):
    """Return the inverse noise covariances of the observed outputs, (n, P, P), zero elsewhere, and log |2 pi noise|."""
    seen = np.isfinite(Y)
    reach = np.where(seen[..., None], reach, 0.0)
    covariance = reach @ reach.swapaxes(1, 2)
    np.einsum("nii->ni", covariance)[:] += np.where(seen, noise, 1.0)
    _, log_determinants = np.linalg.slogdet(covariance)
    precision = np.linalg.inv(covariance)
    np.einsum("nii->ni", precision)[:] *= seen
    return precision, log_determinants + seen.sum(axis=1) * np.log(2 * np.pi)


def _pairs(P):
    return [(i, j) for i in range(P) for j in range(i, P)]


def _variance(kernel, i, j, X):
    """Return cov(y_i(x), y_j(x)) at each of X, (n,)."""
    if i == j:
        return kernel.block_diag(i, X)
    if not kernel.couples(i, j):
        return np.zeros(len(X))
    return np.concatenate([np.diag(kernel.block(i, j, X[some], X[some])) for some in _few(len(X))])


def _few(n):
    return [slice(a, a + DIAGONAL_ROWS) for a in range(0, n, DIAGONAL_ROWS)]
