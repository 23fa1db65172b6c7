"""Sufficient sums of sparse inference: they are added to, and kept in compact models."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Sums(NamedTuple):
    """Over all values, with V = Lu^-1 Kuf and the noise of each: V V^T / noise (K, K), V y / noise (K,), and the rest.

    ``rest`` is the sum of log(2 pi noise) + (y^2 + var(y) - V^T V) / noise: what else the bound needs.
    """

    outer: np.ndarray
    inner: np.ndarray
    rest: float

    @classmethod
    def of(cls, features, noise, statistics) -> Sums:
        """Return the sums over the outputs."""
        outer, inner, rest = np.zeros((features.size, features.size)), np.zeros(features.size), 0.0
        for i, s in enumerate(statistics):
            columns = features.columns(i)
            outer[np.ix_(columns, columns)] += s.outer / noise[i]
            inner[columns] += s.inner / noise[i]
            rest += s.n * np.log(2 * np.pi * noise[i]) + (s.square + s.missing) / noise[i]
        return cls(outer, inner, rest)

    def plus(self, other: Sums) -> Sums:
        """Return the sums over the values of both."""
        return Sums(self.outer + other.outer, self.inner + other.inner, self.rest + other.rest)

    def packed(self, features, n_outputs) -> Sums:
        """Return the sums with those entries of ``outer`` alone that can differ from zero, of its lower triangle."""
        return self._replace(outer=self.outer[_together(features, n_outputs)])

    def unpacked(self, features, n_outputs) -> Sums:
        """Return the sums that were packed."""
        lower = np.zeros((features.size, features.size))
        lower[_together(features, n_outputs)] = self.outer
        return self._replace(outer=lower + np.tril(lower, -1).T)


def _together(features, n_outputs):
    """Return which pairs of features some output feels both of, in the lower triangle."""
    together = np.zeros((features.size, features.size), dtype=bool)
    for i in range(n_outputs):
        columns = features.columns(i)
        together[np.ix_(columns, columns)] = True
    return np.tril(together)
