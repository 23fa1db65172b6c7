r"""Unbiased variances of kernel and noise, after a fit by maximum likelihood.

Maximum-likelihood variances, :math:`y^T K^{-1} y / N` times the ones in K, are biased low, as
variances of residuals are. As for the noise variance of least squares they are multiplied by
:math:`n / (n - p)`, where the n values of an output have determined p hyperparameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._noise import KnownNoise
from skdgp.inference._posterior import ExactPosterior
from skdgp.inference._search import Hyperparameters
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class UnbiasedSettings:
    """Which variances are multiplied, and by how much at most."""

    #: Largest fraction of the values that hyperparameters count for (benchmark `bands`)
    largest_fraction: float = 0.5
    #: Factor of variances up to which nothing is changed: of more than 21 values for a hyperparameter
    least_factor: float = 1.05


SETTINGS = UnbiasedSettings()


def unbiased_factor(
    kernel: MultiOutputKernel, Y: Matrix, settings: UnbiasedSettings = SETTINGS
) -> Vector:
    """Return the factor (P,) of the variances learned from Y (n, P).

    Hyperparameters are the scales of the slopes and the noise, and of processes the widths and the
    amplitude.
    """
    n = np.isfinite(Y).sum(axis=0)
    n_learned = kernel.n_features + 1
    if kernel.n_processes:
        n_learned += kernel.n_features + 1
    return n / (n - np.minimum(n_learned, settings.largest_fraction * n))


def unbiased(
    learned: Hyperparameters,
    posterior: ExactPosterior,
    Y: Matrix,
    known: KnownNoise,
    settings: UnbiasedSettings = SETTINGS,
) -> Hyperparameters:
    """Return hyperparameters with unbiased variances, the same ones if these are fixed or would leave their bounds.

    ``posterior`` is the one of the hyperparameters.
    """
    kernel = learned.kernel
    factor = unbiased_factor(kernel, Y, settings)
    if learned.interrupted or factor.max() <= settings.least_factor:
        return learned
    if known.loading is not None or not np.all(known.is_learned):
        return learned
    factor = factor * posterior.quadratic_form / posterior.size
    noise = factor * learned.noise
    if known.bounds is not None and (noise != np.clip(noise, *known.bounds.T)).any():
        return learned
    scaled = kernel.rescaled(np.sqrt(factor))
    if not all(map(_is_learned, kernel.summands(), scaled.summands())):
        return learned
    lower, upper = kernel.bounds.T
    if not np.all((lower <= scaled.theta) & (scaled.theta <= upper)):
        return learned
    return learned._replace(kernel=scaled, noise=noise, is_unbiased=True)


def _is_learned(term: MultiOutputKernel, scaled: MultiOutputKernel) -> bool:
    """Return whether the scaled values of a term are learned; a wrapped kernel has none."""
    if type(scaled) is not type(term):
        return False
    before, after = term.values(), scaled.values()
    changed = [f for f in term.free_parameters() if np.any(before[f.name] != after[f.name])]
    return bool(changed) and not any(parameter.fixed for parameter in changed)
