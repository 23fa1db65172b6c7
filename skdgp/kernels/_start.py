"""Starting values of the convolved Gaussian from the data."""

from __future__ import annotations

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, constant_columns, output_scale

TIE_BREAK = 1e-9  # added to correlations, so that rounding does not choose the principal directions
SHARED_VARIANCE = 0.5
"""Part of an output's variance that starts in the shared latents, if it has a private latent.

From 0.1 the search of seven electrodes ends in private latents, at a likelihood of 146 with three shared ones, from 0.5
at 202. On pairs of flights it makes no difference (.840 and .841 of least squares; docs/results.md).
"""
WIDTHS = 0.05, 1e3  # bounds, over the standard deviation of the regressor
MOST_COUNTED = 400  # samples for the smallest width: searches learn from a few hundred, however long the log


def spacing(X, Y, matters):
    """Return the smallest width n^(-1/d) for samples X (rows, columns) and targets Y (rows, P), NaN allowed.

    n are the samples of the most observed output, at most ``MOST_COUNTED``, d the regressors that ``matters`` marks and
    that are not constant. n samples spread evenly over d regressors are 3.5 times as far apart, in their deviations.
    """
    n_axes = max(1, int(np.sum(matters & ~constant_columns(X))))
    n = np.clip(np.isfinite(Y).sum(axis=0).max(), 1, MOST_COUNTED)
    return float(n) ** (-1.0 / n_axes)


def starting_values(feeds, X, Y, random_state, width_factor=1.0):
    """Return amplitude, length_scale and their bounds for samples X (n, d) and targets Y (n, P), NaN allowed.

    ``feeds`` (M, P) is one where a latent contributes to an output. Shared latents start along the principal directions
    of the correlation matrix of the outputs, so correlated outputs share a latent from the start. Latents start with
    different widths: with equal widths they would have equal gradients and remain equal.
    """
    rng = check_random_state(random_state)
    M, P = feeds.shape
    d = X.shape[1]
    x_scale, y_scale = column_scale(X), output_scale(Y)
    shared = feeds.sum(axis=1) > 1
    n_shared = int(shared.sum())
    weight = np.where(shared[:, None], SHARED_VARIANCE, 1.0 - SHARED_VARIANCE) * np.ones((1, P)) * feeds
    directions = np.ones((M, P))
    directions[shared] = _directions(Y, n_shared, rng)
    weight *= directions**2
    amplitude = np.sign(directions) * np.sqrt(weight / weight.sum(axis=0)) * y_scale
    # The first latents explain most of the variance and start wide, the last ones narrow.
    spread = np.full(M, 1.2)
    spread[shared] = np.geomspace(2.0, 0.8, n_shared)
    varies = ~constant_columns(X)  # the others change nothing
    apart = np.zeros((M, 1, d))
    apart[..., varies] = 0.1 * shared[:, None, None] * rng.normal(size=(M, 1, varies.sum()))
    lengths = width_factor * np.sqrt(max(1, varies.sum())) * spread[:, None, None] * x_scale * np.exp(apart)
    bounds = np.multiply.outer(x_scale, WIDTHS)
    return {
        "amplitude": amplitude,
        "length_scale": np.broadcast_to(lengths, (M, P, d)).copy(),
        "amplitude_bounds": np.stack(np.broadcast_arrays(-30 * y_scale, 30 * y_scale * np.ones((M, 1))), axis=-1),
        "length_scale_bounds": np.broadcast_to(bounds, (M, P, d, 2)).copy(),
    }


def _directions(Y, n_latent, rng):
    """Return directions (n_latent, P), first principal ones, then random ones; squares sum to one over the latents."""
    P = Y.shape[1]
    observed = np.isfinite(Y)
    Z = np.where(observed, Y - np.nanmean(np.where(observed.any(axis=0), Y, 0.0), axis=0), 0.0) / column_scale(Y)
    counts = np.maximum(observed.T.astype(float) @ observed, 1.0)
    order = np.diag(TIE_BREAK * np.arange(P, 0, -1))
    values, vectors = np.linalg.eigh(Z.T @ Z / counts + order)
    side = np.sqrt(np.arange(2, P + 2)) @ vectors  # the sign of an eigenvector depends on LAPACK: choose one
    vectors = vectors * np.where(side < 0, -1.0, 1.0)
    principal = (vectors * np.sqrt(np.maximum(values, 0.05))).T[::-1]
    rows = principal[:n_latent]
    if n_latent > P:
        rows = np.concatenate([rows, 0.5 * rng.normal(size=(n_latent - P, P))])
    # A small perturbation, since an amplitude of exactly zero has no gradient. It takes the sign of the amplitude, so
    # that outputs of the other sign start, and end, as the same model.
    rows = rows + 0.05 * rng.normal(size=rows.shape) * np.where(rows < 0, -1.0, 1.0)
    return rows / np.sqrt((rows**2).sum(axis=0, keepdims=True)) if n_latent else rows
