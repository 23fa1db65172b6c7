"""The posterior mean, and functions drawn from the posterior, as sums of Gaussian functions, waves and a plane."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import Posterior
from skdgp.export._model import Block
from skdgp.export._pipeline import posterior_form
from skdgp.kernels._prior_paths import FeaturePaths, MixedPaths, SumPaths, TrendPaths
from skdgp.kernels._prior_paths import Waves as WavePaths


class Waves(NamedTuple):
    """Functions of a draw of the prior: sum_k w_ik cos(phase_k + omega_k . z)."""

    frequencies: Matrix
    """omega, (k, d)."""
    phases: Vector
    """(k,)."""
    weights: Matrix
    """w, (6, k)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussianSum:
    """The coefficients at z = (x - shift) / scale: constant + slopes . z + Gaussian functions + waves."""

    regressors: tuple[str, ...]
    lengths: tuple[float, float]
    limits: Matrix
    shift: Vector
    scale: Vector
    constants: Vector
    slopes: Matrix
    centres: Matrix
    blocks: list[list[tuple[Block, Vector]]]
    """Gaussian functions of each coefficient, and their weights."""
    waves: Waves
    loss: pd.DataFrame

    def renamed(self, names: Mapping[str, str]) -> GaussianSum:
        """Return the functions with other names of their regressors."""
        return replace(self, regressors=tuple(names[name] for name in self.regressors))

    def evaluate(self, X: Matrix) -> Matrix:
        """Return the coefficients (n, 6) at X (n, d)."""
        z = (np.asarray(X, dtype=float) - self.shift) / self.scale
        values = self.constants + z @ self.slopes.T
        values += np.cos(z @ self.waves.frequencies.T + self.waves.phases) @ self.waves.weights.T
        for i, blocks in enumerate(self.blocks):
            for block, weights in blocks:
                values[:, i] += block.functions(z, self.centres[block.rows]) @ weights
        return values


def gaussian_sums(
    model: Any, aircraft: Aircraft, *, X: Any = None, tolerance: float = 0.1, n_draws: int = 0, random_state: Seed = 0
) -> list[GaussianSum]:
    """Return the posterior mean of a model, then functions drawn from its posterior, those of ``sample_paths``.

    A model with exact inference is compacted with the tolerance first; its draws are those of the compact model.
    """
    posterior = Posterior(model, X)
    original = posterior.mean(posterior.tested)
    deviation = np.sqrt(np.mean(posterior.deviation(posterior.tested) ** 2, axis=0))
    if posterior.regressor.inference_ == "exact":
        posterior.regressor = posterior.regressor.compact(tolerance=tolerance)
    form, (shift, scale) = _form(posterior), posterior.affine()
    shares, d = form["mixture"].ravel(), len(posterior.names)
    weights = [share * readout.weights for share, readout in zip(shares, form["readouts"], strict=True)]
    trend = shares[:, None] * form["trend_weights"]
    mean = GaussianSum(
        regressors=tuple(posterior.names),
        lengths=posterior.lengths(aircraft),
        limits=posterior.limits,
        shift=shift,
        scale=scale,
        **_terms(posterior, form, weights, trend),
        waves=Waves(np.empty((0, d)), np.empty(0), np.empty((len(COEFFICIENTS), 0))),
        loss=pd.DataFrame(),
    )
    off = np.sqrt(np.mean((mean.evaluate(posterior.tested) - original) ** 2, axis=0))
    mean = replace(mean, loss=pd.DataFrame({"loss": off, "deviation": deviation}, index=list(COEFFICIENTS)))
    return [mean, *_drawn(mean, posterior, form, weights, trend, n_draws, random_state)]


def _form(posterior: Posterior) -> dict[str, Any]:
    try:
        form = posterior_form(posterior.regressor.posterior_)
    except ValueError as error:
        raise ValueError(f"{error} Or use form='tables' with max_loss=np.inf.") from error
    if any(block.root.ndim == 2 for block in form["blocks"]):
        raise ValueError(
            "Got filters of covariance_type='full', but expected 'diag': use form='tables' with max_loss=np.inf."
        )
    return form


def _terms(posterior: Posterior, form: dict[str, Any], weights: list[Vector], trend: Matrix) -> dict[str, Any]:
    """Return what the parts add up to, for weights of their basis and trend."""
    order, scale, P = posterior.order, posterior.scale, form["mixture"].shape[1]
    blocks: list[list[tuple[Block, Vector]]] = [[] for _ in range(P)]
    for block in form["blocks"]:
        i, own = block.output % P, weights[block.output][block.columns]
        if own.any():
            blocks[i].append((replace(block, gain=posterior.regressor.scale_[i] * block.gain), own))
    trend = trend.reshape(-1, P, trend.shape[1]).sum(axis=0)
    constants = trend[:, 0] - trend[:, 1:] @ form["trend_center"]
    return {
        "constants": posterior.regressor.center_[order] + constants[order] * scale,
        "slopes": trend[order, 1:] * scale[:, None],
        "centres": form["centres"],
        "blocks": [blocks[i] for i in order],
    }


def _drawn(
    mean: GaussianSum,
    posterior: Posterior,
    form: dict[str, Any],
    weights: list[Vector],
    trend: Matrix,
    n_draws: int,
    random_state: Seed,
) -> Iterator[GaussianSum]:
    """Yield draws: waves of the prior, and the functions of the mean with weights of their own (Matheron's rule).

    Each output of a draw is that of one member of an average. A draw f of a calibrated model with the mean m is
    m + s (f - m), with s its factor of the deviation.
    """
    if n_draws == 0:
        return
    regressor, order, (K, P) = posterior.regressor, posterior.order, form["mixture"].shape
    bundle = regressor.sample_paths(n_draws, random_state).bundle
    if not isinstance(bundle, MixedPaths):
        bundle = MixedPaths.of_all([bundle], np.zeros((n_draws, P), dtype=int))
    s = posterior.factors / regressor.scale_
    kept = 1.0 - np.tile(s, K)
    for k in range(n_draws):
        lines = kept[:, None] * trend
        of_basis = [share * own for share, own in zip(kept, weights, strict=True)]
        waves = [mean.waves]
        for member, (paths, rows) in enumerate(zip(bundle.bundles, bundle.rows, strict=True)):
            taken, row = s * (bundle.member[k] == member), int(np.searchsorted(rows, k))
            if not taken.any():
                continue
            gaussians: list[Any] = [np.empty((P, 0))]
            for leaf in _leaves(paths):
                if isinstance(leaf, TrendPaths):
                    drawn = np.hstack([leaf._intercept[row].T, leaf._slope[row].T])
                    lines[member * P : (member + 1) * P] += taken[:, None] * drawn
                elif isinstance(leaf, FeaturePaths):
                    gaussians.append([own[row] for own in leaf._weights])
                else:
                    waves.append(_waves(leaf, row, (taken * regressor.scale_)[order], order))
            for i in np.flatnonzero(taken):
                of_basis[member * P + i] += taken[i] * np.concatenate([own[i] for own in gaussians])
        joined = Waves(
            *(np.concatenate(parts, axis) for parts, axis in zip(zip(*waves, strict=True), (0, 0, 1), strict=True))
        )
        yield replace(mean, **_terms(posterior, form, of_basis, lines), waves=joined)


def _leaves(bundle: Any) -> Iterator[Any]:
    """Yield the terms of a sum of paths."""
    if isinstance(bundle, SumPaths):
        yield from _leaves(bundle.first)
        yield from _leaves(bundle.second)
    else:
        yield bundle


def _waves(leaf: WavePaths, k: int, factors: Vector, order: list[int]) -> Waves:
    """Return the waves of path k, with the weights of the coefficients."""
    own: Array = leaf.own[k, 0][:, :, None] * leaf.fed[:, None]
    weights = np.concatenate([leaf.shared[k], own.reshape(-1, len(order))])
    return Waves(leaf.omega[k].T, leaf.phase[k, 0], factors[:, None] * weights[:, order].T)
