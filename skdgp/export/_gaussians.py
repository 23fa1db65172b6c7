"""The posterior mean as a sum of Gaussian functions and a plane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import Posterior
from skdgp.export._pipeline import sparse_form


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
    original = posterior.mean(posterior.tested)
    deviation = np.sqrt(np.mean(posterior.deviation(posterior.tested) ** 2, axis=0))
    if posterior.regressor.inference_ == "exact":
        posterior.regressor = posterior.regressor.compact(tolerance=tolerance)
    d, center = len(posterior.names), posterior.regressor._center[posterior.order]
    shift, scale = posterior.affine()
    constants, slopes, blocks = _read(posterior)
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


def _read(posterior: Posterior) -> tuple[Vector, Matrix, list[list[Gaussians]]]:
    """Return constants (6,), slopes (6, d) and Gaussian functions of the posterior mean."""
    try:
        form = sparse_form(posterior.regressor.posterior_)
    except ValueError as error:
        raise ValueError(f"{error} Or use form='tables'.") from error
    order, scale, trend = posterior.order, posterior.scale, form["trend_weights"]
    blocks: list[list[Gaussians]] = [[] for _ in order]
    for block in form["blocks"]:
        if block.root.ndim == 2:
            raise ValueError("Got filters of covariance_type='full', but expected 'diag': use form='tables'.")
        used = np.isin(np.arange(len(block.root)), block.regressors)
        r, a = used * block.root**2, form["centres"][block.rows] + block.shift
        weights = block.gain * form["readouts"][block.output].weights[block.columns]
        blocks[block.output].append(Gaussians(weights, -0.5 * a**2 @ r, a * r, r, used))
    scaled = [[b._replace(weights=s * b.weights) for b in blocks[i]] for i, s in zip(order, scale, strict=True)]
    constants = trend[:, 0] - trend[:, 1:] @ form["trend_center"]
    return constants[order] * scale, trend[order, 1:] * scale[:, None], scaled
