"""Samples of the posterior, rescaled by the calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skdgp.inference._paths import Path, Paths


class ScaledPaths(Sequence):
    """Paths f of a posterior with mean m as m + scale (f - m): its mean, and its covariance times the scales.

    They are asked as :class:`skdgp.inference.Paths` are.

    Parameters
    ----------
    paths : Paths
    regressor : estimator
        Its ``predict`` is m, its ``predict_gradient`` the slopes of it.
    scale : ndarray (P,), or float where y was (n,)
    """

    def __init__(self, paths: Paths, regressor, scale):
        self.paths, self.regressor, self.scale = paths, regressor, scale

    def __len__(self):
        return len(self.paths)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return ScaledPaths(self.paths[index], self.regressor, self.scale)
        k = range(len(self))[index]
        return Path(self[k : k + 1])

    def __call__(self, X) -> np.ndarray:
        """Return the values of all paths at X (n, d), (n_paths, n, P), or (n_paths, n) where y was (n,)."""
        return self._spread(self.paths(X), self.regressor.predict(X), self.scale)

    def each(self, X) -> np.ndarray:
        """Return the values of each path at its own points, X (n_paths, n, d), shaped as by a call."""
        values = self.paths.each(X)
        mean = self.regressor.predict(np.reshape(X, (-1, np.shape(X)[-1])))
        return self._spread(values, mean.reshape(values.shape), self.scale)

    def gradient(self, X) -> np.ndarray:
        """Return the slopes of all paths at X (n, d), or of each at its own, (n_paths, n, d)."""
        values = self.paths.gradient(X)
        mean = self.regressor.predict_gradient(np.reshape(X, (-1, np.shape(X)[-1])))
        mean = mean.reshape(values.shape if np.ndim(X) == 3 else values.shape[1:])
        return self._spread(values, mean, np.asarray(self.scale)[..., None])

    @staticmethod
    def _spread(values, mean, scale):
        return mean + scale * (values - mean)
