"""Structures of kernels that a search compares: what each one costs, and its weight.

A kernel that contains another one as a special case always has the larger likelihood. So each pays
for the hyperparameters that matter (Akaike 1974, of few values Hurvich & Tsai 1989), and the weights
of structures are the exponentials of what remains (Burnham & Anderson 2002, section 2.9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax
from sklearn.base import clone

from skdgp._compute.linalg import column_scale, constant_columns
from skdgp._compute.typing import Matrix, Vector
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel, Sum


@dataclass(frozen=True)
class StructureSettings:
    """Which hyperparameters matter, and which structures are kept."""

    #: Smallest amplitude that counts, over the standard deviation of the process of its output
    amplitude: float = 0.01
    #: Largest length scale that counts, in standard deviations of the regressor
    length_scale: float = 10.0
    #: Smaller weights are set to zero, as those of an average
    least_weight: float = 0.05


SETTINGS = StructureSettings()


def with_shifts(kernel: MultiOutputKernel, shift: Matrix, X: Matrix) -> MultiOutputKernel:
    """Return a kernel without values whose shifts start at ``shift`` (P, d), free along regressors that have one."""
    if isinstance(kernel, Sum):
        return Sum(with_shifts(kernel.k1, shift, X), with_shifts(kernel.k2, shift, X))
    if not has_shared_latents(kernel):
        return kernel
    P, d = shift.shape
    M = kernel.n_latent + (P if kernel.private_latents else 0)
    limit = np.ptp(X, axis=0) * shift.any(axis=0)  # the range of the regressor
    bounds = np.broadcast_to(np.stack([-limit, limit], axis=-1), (M, P, d, 2))
    return clone(kernel).set_params(
        shift=np.array(np.broadcast_to(shift, (M, P, d))),
        parameter_bounds={**(kernel.parameter_bounds or {}), "shift": bounds},
    )


def has_shared_latents(kernel: MultiOutputKernel) -> bool:
    """Return whether a kernel without values has latents that several outputs share."""
    processes = [term for term in kernel.summands() if isinstance(term, ConvolvedGaussian)]
    return any(term.n_latent > 0 for term in processes)


def contains(kernel: MultiOutputKernel, simpler: MultiOutputKernel) -> bool:
    """Return whether a kernel without values has the latents of a simpler one, whose outputs share length scales.

    Both have the same terms for one output.
    """
    for term, other in zip(kernel.summands(), simpler.summands(), strict=True):
        if not isinstance(term, ConvolvedGaussian):
            continue
        is_alike = (other.n_latent, other.private_latents) == (term.n_latent, term.private_latents)
        if not is_alike or other.covariance_type != "tied":
            return False
    return True


def n_mattering(kernel: MultiOutputKernel, X: Matrix) -> int:
    """Return the number of hyperparameters that matter to the covariance of samples X (n, d).

    An amplitude that is nearly zero does not, nor does a length scale far beyond the samples or along
    a constant regressor, nor the shift of one output of a latent whose outputs all move, as only
    differences matter.
    """
    return sum(_n_mattering(term, X) for term in kernel.summands())


def _n_mattering(term, X):
    if isinstance(term, LinearTrend):  # a slope by a constant regressor is learned from nothing
        has_slopes = any(f.n_elements for f in term.free_parameters() if f.name == "slope_scale")
        n_constant = int(constant_columns(X).sum()) * term.n_outputs
        return term.n_dims - n_constant * has_slopes
    if not isinstance(term, ConvolvedGaussian):
        return term.n_dims
    scale = column_scale(X)
    filters = term.filters
    size = np.abs(filters.amplitude)
    total = np.sqrt(np.sum(size**2, axis=0))
    feeds = size > SETTINGS.amplitude * total
    wide = (filters.length_scale > SETTINGS.length_scale * scale) | constant_columns(X)
    matters = {
        "amplitude": feeds,
        "length_scale": feeds[..., None] & ~wide,
        "shift": np.broadcast_to(feeds[..., None], wide.shape),
    }
    n = 0
    for parameter in term.free_parameters():
        if parameter.fixed:
            continue
        numbers = np.broadcast_to(parameter.index, matters[parameter.name].shape)
        free = matters[parameter.name] & (numbers >= 0)
        if parameter.name == "shift":
            limits = np.broadcast_to(parameter.bounds, (*free.shape, 2))
            free = free & (limits[..., 0] < limits[..., 1])
            all_move = free.any(axis=1) & (free == feeds[..., None]).all(axis=1)
            n -= int(all_move.sum())
        n += len(np.unique(numbers[free]))
    return n


def price_of(n_hyperparameters: int, n_values: int) -> float:
    """Return what a likelihood of n values pays for p hyperparameters, p n / (n - p - 1) nats (Hurvich & Tsai 1989).

    At most half as many count as there are values.
    """
    p = min(n_hyperparameters, 0.5 * n_values - 1.0)
    return p * n_values / (n_values - p - 1.0)


def least_score(scores: Sequence[float]) -> float:
    """Return the score from which a structure beside others with these scores would have a weight."""
    return max(scores, default=-np.inf) + np.log(SETTINGS.least_weight)


def structure_weights(scores: Sequence[float]) -> Vector:
    """Return the weights (K,), which add up to one, of kernels with these scores, learned from the same values."""
    lowest = -np.finfo(float).max / 2  # of kernels without a likelihood
    weights = softmax(np.maximum(scores, lowest))
    weights[weights < SETTINGS.least_weight] = 0.0
    return weights / weights.sum()
