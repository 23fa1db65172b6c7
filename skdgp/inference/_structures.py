"""Structures of kernels that a search compares: what each one costs, and its weight.

A kernel that contains another one as a special case always has the larger likelihood. So each pays
for the hyperparameters that the values determine (Akaike 1974, of few values Hurvich & Tsai 1989), and the weights
of structures are the exponentials of what remains (Burnham & Anderson 2002, section 2.9).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax
from sklearn.base import clone

from skdgp._compute.typing import Matrix, Vector
from skdgp.kernels import ConvolvedGaussian, MultiOutputKernel, Sum

#: Smaller weights are set to zero, as those of an average
LEAST_WEIGHT = 0.05


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


def excess_of(n_hyperparameters: int, n_values: int) -> float:
    """Return n / (n - p - 1) for n values and p hyperparameters, at most 2, for p beyond half of n."""
    p = min(n_hyperparameters, 0.5 * n_values - 1.0)
    return n_values / (n_values - p - 1.0)


def price_of(n_hyperparameters: int, n_values: int) -> float:
    """Return what a likelihood of n values pays for p hyperparameters, p n / (n - p - 1) nats (Hurvich & Tsai 1989).

    Each beyond half of n pays 4 nats, about the slope there.
    """
    p = min(n_hyperparameters, 0.5 * n_values - 1.0)
    return p * excess_of(n_hyperparameters, n_values) + 4.0 * (n_hyperparameters - p)


def least_score(scores: Sequence[float]) -> float:
    """Return the score from which a structure beside others with these scores would have a weight."""
    return max(scores, default=-np.inf) + np.log(LEAST_WEIGHT)


def structure_weights(scores: Sequence[float]) -> Vector:
    """Return the weights (K,), which add up to one, of kernels with these scores, learned from the same values."""
    lowest = -np.finfo(float).max / 2  # of kernels without a likelihood
    weights = softmax(np.maximum(scores, lowest))
    weights[weights < LEAST_WEIGHT] = 0.0
    return weights / weights.sum()
