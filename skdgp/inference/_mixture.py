"""Mixtures of posteriors with weights for each output; a single posterior is a mixture of one."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.typing import Matrix


class Single:
    """The words of an ``AveragePosterior`` for a posterior that is its only member."""

    kernel: Any
    measured: Any = None  # X (n, d), Y (n, P) where it has learned from other samples

    @property
    def members(self) -> list[Any]:
        """The posterior itself."""
        return [self]

    @property
    def wholes(self) -> list[Any]:
        """The posterior itself, which has all terms."""
        return [self]

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """The numbers of all terms of the kernel."""
        return [tuple(range(len(self.kernel.summands())))]

    @property
    def mixture(self) -> Matrix:
        """The weight one for each output, (1, P)."""
        return np.ones((1, self.kernel.n_outputs))


def moments(mixture: Matrix, found: Any, return_variance: bool = False) -> Any:
    r"""Return the mean and, with ``return_variance``, the variance of a mixture.

    With means :math:`m_k` and variances :math:`v_k` of members,
    :math:`m = \sum_k w_k m_k` and :math:`v = \sum_k w_k (v_k + (m_k - m)^2)`.

    Parameters
    ----------
    mixture : ndarray (K, P)
        Weights of members for each output.
    found : sequence of K
        The mean (n, P, ...) of each member; with ``return_variance`` a pair, mean and variance.
    return_variance : bool
    """
    means, variances = zip(*found, strict=True) if return_variance else (found, None)
    means = np.asarray(means)
    weights = mixture.reshape(len(means), 1, -1, *(1,) * (means.ndim - 3))
    mean = np.sum(weights * means, axis=0)
    if variances is None:
        return mean
    return mean, np.sum(weights * (np.asarray(variances) + (means - mean) ** 2), axis=0)
