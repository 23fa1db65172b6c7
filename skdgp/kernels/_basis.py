"""Columns of any scikit-learn transformer as functions of the regressors, with their slopes."""

from __future__ import annotations

import joblib
import numpy as np
from scipy.sparse import issparse
from sklearn.base import clone

from skdgp._compute.linalg import column_scale

STEP = 1e-3  # of a regressor's spread, for differences of fourth order


def check_transformer(transformer) -> None:
    """Raise a TypeError for what cannot be fitted to regressors and transform them."""
    methods = all(callable(getattr(transformer, name, None)) for name in ("fit", "transform", "get_params"))
    if isinstance(transformer, type) or not methods:
        raise TypeError(
            f"Got {transformer!r} for a trend, but expected an instance of a scikit-learn transformer, such as "
            "PolynomialFeatures(2) or make_pipeline(StandardScaler(), SplineTransformer())."
        )


class FittedBasis:
    """A transformer fitted once: clones of a kernel share it, since hyperparameters do not change it.

    Parameters
    ----------
    transformer : scikit-learn transformer
        Fitted.
    step : ndarray (d,)
        In each regressor, for the slopes.
    n_columns : int
        Columns that it gives, K.
    """

    def __init__(self, transformer, step, n_columns):
        self.transformer = transformer
        self.step = step
        self.n_columns = n_columns

    @classmethod
    def to(cls, transformer, X) -> FittedBasis:
        """Return a clone of the transformer fitted to X (n, d)."""
        check_transformer(transformer)
        fitted = clone(transformer).fit(X)
        columns = as_columns(fitted.transform(X), len(X), fitted)
        return cls(fitted, STEP * column_scale(X), columns.shape[1])

    def __sklearn_clone__(self):
        return self

    def __eq__(self, other):
        return isinstance(other, FittedBasis) and joblib.hash(self) == joblib.hash(other)

    __hash__ = None

    def __repr__(self):
        return repr(self.transformer)

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return len(self.step)

    def columns(self, X) -> np.ndarray:
        """Return phi(X), (n, K)."""
        if len(X) == 0:
            return np.empty((0, self.n_columns))
        return as_columns(self.transformer.transform(X), len(X), self.transformer)

    def slopes(self, X) -> np.ndarray:
        """Return d phi / dX, (d, n, K), by central differences: exact for polynomials up to degree four."""
        X = np.asarray(X, dtype=float)
        unit = np.diag(self.step)[:, None, :]
        there = np.stack([X + times * unit for times in (-2, -1, 1, 2)])  # (4, d, n, d)
        phi = self.columns(there.reshape(-1, X.shape[1])).reshape(*there.shape[:3], self.n_columns)
        return np.tensordot([1.0, -8.0, 8.0, -1.0], phi, axes=1) / (12 * self.step[:, None, None])


def as_columns(phi, n: int, transformer) -> np.ndarray:
    """Return what a transformer gave as a finite (n, K) array."""
    phi = np.asarray(phi.toarray() if issparse(phi) else phi, dtype=float)
    if phi.ndim != 2 or len(phi) != n or phi.shape[1] == 0 or not np.isfinite(phi).all():
        raise ValueError(
            f"Got columns of shape {phi.shape} from {transformer!r} for {n} samples, but expected finite ones, "
            f"({n}, K) with K > 0: choose a transformer whose every column is a function of the regressors."
        )
    return phi
