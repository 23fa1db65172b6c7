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
from skdgp.export._pipeline import sparse_form
from skdgp.kernels._prior_paths import FeaturePaths, SumPaths, TrendPaths
from skdgp.kernels._prior_paths import Waves as WavePaths


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
    blocks: list[list[Gaussians]]
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
            for block in blocks:
                exponent = block.constants + z @ block.slopes.T - 0.5 * (z**2 @ block.curvature)[:, None]
                values[:, i] += np.exp(exponent) @ block.weights
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
    weights, d = [readout.weights for readout in form["readouts"]], len(posterior.names)
    mean = GaussianSum(
        regressors=tuple(posterior.names),
        lengths=posterior.lengths(aircraft),
        limits=posterior.limits,
        shift=shift,
        scale=scale,
        **_terms(posterior, form, weights, form["trend_weights"]),
        waves=Waves(np.empty((0, d)), np.empty(0), np.empty((len(COEFFICIENTS), 0))),
        loss=pd.DataFrame(),
    )
    off = np.sqrt(np.mean((mean.evaluate(posterior.tested) - original) ** 2, axis=0))
    mean = replace(mean, loss=pd.DataFrame({"loss": off, "deviation": deviation}, index=list(COEFFICIENTS)))
    return [mean, *_drawn(mean, posterior, form, n_draws, random_state)]


def _form(posterior: Posterior) -> dict[str, Any]:
    try:
        form = sparse_form(posterior.regressor.posterior_)
    except ValueError as error:
        raise ValueError(f"{error} Or use form='tables' with max_loss=np.inf.") from error
    if any(block.root.ndim == 2 for block in form["blocks"]):
        raise ValueError(
            "Got filters of covariance_type='full', but expected 'diag': use form='tables' with max_loss=np.inf."
        )
    return form


def _terms(posterior: Posterior, form: dict[str, Any], weights: list[Vector], trend: Matrix) -> dict[str, Any]:
    """Return constants (6,), slopes (6, d) and Gaussian functions, for weights of each output's basis and trend."""
    order, scale = posterior.order, posterior.scale
    blocks: list[list[Gaussians]] = [[] for _ in order]
    for block in form["blocks"]:
        used = np.isin(np.arange(len(block.root)), block.regressors)
        r, a = used * block.root**2, form["centres"][block.rows] + block.shift
        own = posterior.regressor._scale[block.output] * block.gain * weights[block.output][block.columns]
        blocks[block.output].append(Gaussians(own, -0.5 * a**2 @ r, a * r, r, used))
    constants = trend[:, 0] - trend[:, 1:] @ form["trend_center"]
    return {
        "constants": posterior.regressor._center[order] + constants[order] * scale,
        "slopes": trend[order, 1:] * scale[:, None],
        "blocks": [blocks[i] for i in order],
    }


def _drawn(
    mean: GaussianSum, posterior: Posterior, form: dict[str, Any], n_draws: int, random_state: Seed
) -> Iterator[GaussianSum]:
    """Yield draws: waves of the prior, and the functions of the mean with weights of their own (Matheron's rule).

    A draw f of a calibrated model with the mean m is m + s (f - m), with s its factor of the deviation.
    """
    if n_draws == 0:
        return
    regressor, order = posterior.regressor, posterior.order
    leaves = list(_leaves(regressor.sample_paths(n_draws, random_state).bundle))
    gaussians = [leaf._weights for leaf in leaves if isinstance(leaf, FeaturePaths)]
    waves = [leaf for leaf in leaves if isinstance(leaf, WavePaths)]
    trends = [leaf for leaf in leaves if isinstance(leaf, TrendPaths)]
    s = posterior.factors / regressor._scale
    for k in range(n_draws):
        trend = (1.0 - s)[:, None] * form["trend_weights"]
        for leaf in trends:
            trend += s[:, None] * np.hstack([leaf._intercept[k].T, leaf._slope[k].T])
        weights = [
            (1.0 - s[i]) * readout.weights + s[i] * np.concatenate([np.empty(0), *(own[i][k] for own in gaussians)])
            for i, readout in enumerate(form["readouts"])
        ]
        parts = [mean.waves, *(_waves(leaf, k, posterior.factors[order], order) for leaf in waves)]
        frequencies, phases, amplitudes = zip(*parts, strict=True)
        joined = Waves(np.concatenate(frequencies), np.concatenate(phases), np.hstack(amplitudes))
        yield replace(mean, **_terms(posterior, form, weights, trend), waves=joined)


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
