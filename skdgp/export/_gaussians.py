"""The posterior mean as a sum of Gaussian functions and a plane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import Posterior
from skdgp.kernels import LinearTrend

NO_EFFECT = 1e-14  # of a regressor on an exponent, over 1


class Gaussians(NamedTuple):
    r"""Functions of one width: sum_k w_k exp(c_k + s_k . z - 1/2 sum_j r_j z_j^2)."""

    weights: Vector
    """w, (k,)."""
    constants: Vector
    """c, (k,)."""
    slopes: Matrix
    """s, (k, d)."""
    curvature: Vector
    """r, (d,)."""
    used: np.ndarray
    """Whether the functions depend on each regressor, (d,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianSum:
    """The coefficients at z = (x - shift) / scale: constant + slopes . z + Gaussian functions."""

    regressors: tuple[str, ...]
    lengths: tuple[float, float]
    limits: Matrix
    shift: Vector
    scale: Vector
    constants: Vector
    slopes: Matrix
    blocks: list[list[Gaussians]]
    loss: pd.DataFrame

    def evaluate(self, X: Matrix) -> Matrix:
        """Return the coefficients (n, 6) at X (n, d)."""
        z = (np.asarray(X, dtype=float) - self.shift) / self.scale
        values = self.constants + z @ self.slopes.T
        for i, blocks in enumerate(self.blocks):
            for block in blocks:
                exponent = block.constants + z @ block.slopes.T - 0.5 * (z**2 @ block.curvature)[:, None]
                values[:, i] += np.exp(exponent) @ block.weights
        return values


def gaussian_sum(model: Any, aircraft: Aircraft, *, X: Any = None, tolerance: float = 0.1) -> GaussianSum:
    """Return the posterior mean of a model; one with exact inference is compacted with the tolerance first."""
    posterior = Posterior(model, X)
    original, deviation = posterior.mean(posterior.tested), posterior.deviation(posterior.tested)
    if posterior.regressor.inference_ == "exact":
        posterior.regressor = posterior.regressor.compact(tolerance=tolerance)
    d, center = len(posterior.names), posterior.regressor._center[posterior.order]
    shift, scale = posterior.affine()
    constants, slopes, blocks = _read(posterior, posterior.regressor.posterior_.weights)
    found = GaussianSum(
        regressors=tuple(posterior.names),
        lengths=posterior.lengths(aircraft),
        limits=posterior.limits,
        shift=shift,
        scale=scale,
        constants=center + constants,
        slopes=slopes.reshape(-1, d),
        blocks=blocks,
        loss=pd.DataFrame(),
    )
    off = np.sqrt(np.mean((found.evaluate(posterior.tested) - original) ** 2, axis=0))
    return replace(found, loss=pd.DataFrame({"loss": off, "deviation": deviation}, index=list(COEFFICIENTS)))


def _read(posterior: Posterior, weights: Vector) -> tuple[Vector, Matrix, list[list[Gaussians]]]:
    """Return constants (6,), slopes (6, d) and Gaussian functions of a mean with other weights of the features."""
    sparse = posterior.regressor.posterior_
    readout = sparse.readout
    d, P = len(posterior.names), sparse.kernel.n_outputs
    columns = np.zeros((len(readout.weights), P))
    for i, (rows, features) in enumerate(zip(readout.slices, readout.columns, strict=True)):
        columns[rows, i] = weights[features]
    constants, slopes = np.zeros(P), np.zeros((P, d))
    blocks: list[list[Gaussians]] = [[] for _ in range(P)]
    for rows, w in _leaves(readout.rows, columns):
        if hasattr(rows, "scales"):  # of a trend
            if not isinstance(getattr(rows.columns, "__self__", None), LinearTrend):
                raise _unknown("a trend that is not linear")
            w = (rows.scales[:, None] * w).reshape(P, d + 1, P).sum(axis=0)
            constants += w[0] - rows.center @ w[1:]
            slopes += w[1:].T
        elif hasattr(rows, "slopes") and rows.diagonal and not rows.far:
            for place, block in _blocks(rows):
                for i in range(P):
                    if np.any(w[place, i]):
                        blocks[i].append(block._replace(weights=block.weights * w[place, i]))
        elif len(w):
            raise _unknown("processes that are not Gaussian functions of single regressors")
    scale = posterior.scale
    order = posterior.order
    scaled = [[b._replace(weights=b.weights * s) for b in blocks[i]] for i, s in zip(order, scale, strict=True)]
    return constants[order] * scale, slopes[order] * scale[:, None], scaled


def _leaves(rows: Any, weights: Matrix) -> list[tuple[Any, Matrix]]:
    """Return the terms of a sum of features, and the weights (c, P) of their columns."""
    if not hasattr(rows, "first"):
        return [(rows, weights)]
    apart = np.empty_like(weights)
    apart[rows.order] = weights
    n = int(rows.first.sizes.sum())
    return [*_leaves(rows.first, apart[:n]), *_leaves(rows.second, apart[n:])]


def _blocks(rows: Any) -> list[tuple[slice, Gaussians]]:
    """Return the columns of each block, and its functions with the gains as weights, about the origin."""
    found, edges = [], np.cumsum([0, *rows.counts])
    for k, (a, b) in enumerate(pairwise(edges)):
        place, r, m = slice(a, b), rows.roots[:, k], rows.middle
        slopes = rows.slopes[:, place].T
        constants = rows.constant[place] - slopes @ m - 0.5 * r @ m**2
        slopes = slopes + r * m
        used = (r > NO_EFFECT) | (np.abs(slopes).max(axis=0, initial=0.0) > NO_EFFECT)
        found.append((place, Gaussians(rows.gain[place], constants, slopes, r, used)))
    return found


def _unknown(what: str) -> ValueError:
    return ValueError(
        f"Got a model with {what}, but expected Gaussian processes and a linear trend: use form='tables'."
    )
