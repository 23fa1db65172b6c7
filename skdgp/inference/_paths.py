"""Sample paths of the posterior by Matheron's rule.

A path is a sample of the prior plus a correction by the data. With f and u drawn jointly from the
prior, f + Kfu Kuu^-1 (u_post - u) has the mean and covariance of the posterior at all inputs
(Wilson et al. 2020, "Efficiently sampling functions from Gaussian process posteriors").
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Matrix, Vector
from skdgp.kernels import PathBundle

FREQUENCIES = 64  # waves of each latent process in each path


class Path:
    """One sample of the posterior: a function X (n, d) -> (n, P), or (n,) for one-dimensional targets."""

    def __init__(self, alone: Paths) -> None:
        self._alone = alone

    def __call__(self, X) -> np.ndarray:
        return self._alone(X)[0]

    def gradient(self, X: Matrix) -> np.ndarray:
        """Return d value / d regressor at X (n, d), (n, P, d), or (n, d) for one-dimensional targets."""
        return self._alone.gradient(X)[0]


class Paths(Sequence):
    """Sample paths of the posterior: a sequence of ``Path`` that are evaluated together.

    ``paths[k]`` is one path and ``paths[a:b]`` several. ``paths(X)`` evaluates all paths at the
    same points, ``paths.each(X)`` each path at its own points, and ``paths.gradient(X)`` their
    slopes. Paths can be pickled. A path is a function: its value at a point does not depend on the
    other points or paths of a call, up to rounding.

    Parameters
    ----------
    bundle : PathBundle
    n_paths, n_features : int
    center, scale : ndarray (P,)
        Values are ``center`` + ``scale`` times the values of the bundle.
    single : bool
        Whether the axis of outputs is dropped.
    feature_names : sequence of str or None
        Expected column names of a DataFrame.
    """

    def __init__(
        self,
        bundle: PathBundle,
        n_paths: int,
        n_features: int,
        center: Vector,
        scale: Vector,
        single: bool,
        feature_names: Sequence[str] | None,
    ) -> None:
        self.bundle, self.n_paths, self.n_features = bundle, n_paths, n_features
        self.center, self.scale, self.single, self.feature_names = (
            center,
            scale,
            single,
            feature_names,
        )

    def __len__(self):
        return self.n_paths

    def __getitem__(self, index):
        if not isinstance(index, slice):
            k = range(self.n_paths)[index]
            return Path(self[k : k + 1])
        subset = copy(self)
        subset.bundle, subset.n_paths = self.bundle.take(index), len(range(self.n_paths)[index])
        return subset

    def __call__(self, X) -> np.ndarray:
        """Return the values of all paths at X (n, d), (n_paths, n, P), or (n_paths, n) for one-dimensional targets."""
        return self._values(self._check_points(X, 2)[None])

    def each(self, X: Matrix) -> np.ndarray:
        """Return the values of each path at its own points X (n_paths, n, d), in the shape of a call."""
        return self._values(self._check_points(X, 3))

    def gradient(self, X: Matrix) -> np.ndarray:
        """Return the slopes of all paths at X (n, d), or of each path at its own points X (n_paths, n, d).

        The result is (n_paths, n, P, d), or (n_paths, n, d) for one-dimensional targets.
        """
        X = self._check_points(X, 3) if np.ndim(X) == 3 else self._check_points(X, 2)[None]
        with threads_for(X.shape[1]):
            return self._squeeze(self.bundle.slopes(X) * np.reshape(self.scale, (-1, 1)))

    def _values(self, X):
        with threads_for(X.shape[1]):
            values = self.bundle.values(X)
        values *= self.scale
        values += self.center
        return self._squeeze(values)

    def _check_points(self, X, ndim):
        columns = getattr(X, "columns", None)
        if (
            columns is not None
            and self.feature_names is not None
            and list(columns) != list(self.feature_names)
        ):
            raise ValueError(
                f"Got X with the columns {list(columns)}, but expected those of the fit, in their "
                f"order: "
                f"{list(self.feature_names)}."
            )
        X = np.asarray(X, dtype=float)
        if (
            X.ndim != ndim
            or X.shape[-1] != self.n_features
            or (ndim == 3 and len(X) != self.n_paths)
        ):
            expected = (
                f"(n, {self.n_features})"
                if ndim == 2
                else f"({self.n_paths}, n, {self.n_features})"
            )
            raise ValueError(
                f"Got X of shape {X.shape}, but expected {expected}: a column for each regressor "
                f"of the fit."
            )
        return X

    def _squeeze(self, values):
        return values[:, :, 0] if self.single else values
