"""Extended least squares: targets without what past errors predict of their errors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from skdgp._compute.typing import Matrix

ROUNDS, TOLERANCE = 100, 1e-3


def unpredicted(Q: Matrix, Y: Matrix, lags: Iterable[int], segments: Iterable[Any], known: Any) -> Matrix:
    r"""Return targets Y (n, P) without what past errors predict of their errors (Ljung 1999, section 10.4).

    .. math:: y^*_t = y_t - \sum_k a_k e_{t-k}, \quad e = y - f,

    with :math:`f` the projection of :math:`y^*` on the orthonormal basis Q, (n_known, m), and :math:`a` by least
    squares of :math:`e`, for each output, in turn until neither changes. Rows that are not ``known`` (n,) stay as they
    are; nothing is predicted from them, nor across ``segments`` of rows.
    """
    lags, segments = list(lags), list(segments)
    predicted, scale = np.zeros_like(Y), Y[known].std(axis=0)
    for _ in range(ROUNDS):
        before, clean, error = predicted, (Y - predicted)[known], np.zeros_like(Y)
        error[known] = Y[known] - Q @ (Q.T @ clean)
        predicted = _predicted(error, lags, segments, known)
        if (np.abs(predicted - before).max(axis=0) <= TOLERANCE * scale).all():
            break
    return Y - predicted


def _predicted(error, lags, segments, known):
    """Return what the errors at the lags predict of the errors, (n, P)."""
    past = np.zeros((len(lags), *error.shape))
    for rows in segments:
        part = error[rows]
        for k, lag in enumerate(lags):
            past[k, rows][lag:] = part[:-lag]
    predicted = np.zeros_like(error)
    for j, e in enumerate(error.T):
        weights = np.linalg.lstsq(past[:, known, j].T, e[known], rcond=None)[0]
        predicted[known, j] = weights @ past[:, known, j]
    return predicted
