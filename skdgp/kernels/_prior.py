"""The log-normal prior on length scales."""

from __future__ import annotations

import numpy as np

from skdgp._compute.linalg import column_scale


def prior_of(prior, X) -> np.ndarray | None:
    """Return medians and spreads (d, 2) for regressors X (n, d), or None.

    "auto" is the prior of Hvarfner, Hellsten & Nardi (2024), LogNormal(sqrt(2) + log(d) / 2, sqrt(3)) for regressors
    that are uniform on [0, 1], whose standard deviation is 1 / sqrt(12).
    """
    if prior is None:
        return None
    d = np.shape(X)[1]
    if isinstance(prior, str) and prior == "auto":
        return np.column_stack([np.exp(np.sqrt(2)) * np.sqrt(12 * d) * column_scale(X), np.full(d, np.sqrt(3))])
    try:
        values = np.asarray(prior, dtype=float)
        if values.shape in ((2,), (d, 2)) and (values > 0).all() and np.isfinite(values).all():
            return np.array(np.broadcast_to(values, (d, 2)))
    except ValueError:
        pass
    raise ValueError(
        f"Got length_scale_prior={prior!r}, but expected None, 'auto', or the median of the length scales and the "
        f"standard deviation of their logarithms, both positive: one pair, or an array ({d}, 2) with one for each "
        "regressor."
    )


def log_normal(index, lengths, prior):
    """Return the log density of the logarithms of free length scales, and its derivative by entry.

    Parameters
    ----------
    index : ndarray (M, P, d)
        As in ``Free``: entries of one number are one hyperparameter. It counts once, and what falls on it is shared by
        its entries.
    lengths : ndarray (M, P, d)
    prior : ndarray (d, 2)
        Medians and spreads.
    """
    median, spread = np.moveaxis(np.broadcast_to(prior, (*index.shape, 2)), -1, 0)
    chosen = index >= 0
    number, spread = index[chosen], spread[chosen]
    counts = np.bincount(number)

    def mean(values):
        return np.bincount(number, weights=values) / counts

    z = mean(np.log(lengths / median)[chosen] / spread)
    value = -0.5 * z @ z - mean(np.log(spread)).sum() - 0.5 * len(z) * np.log(2 * np.pi)
    slope = np.zeros(index.shape)
    slope[chosen] = -(z / counts)[number] / spread
    return value, slope
