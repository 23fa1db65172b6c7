"""Conformal quantiles of scores grouped by flight: every flight has the same weight."""

from __future__ import annotations

import numpy as np

ROUNDING = 1e-9
"""Levels nearer than this are the same."""


def units_of(tests, flights) -> tuple[str, np.ndarray]:
    """Return what is exchangeable, and which one each held-out row belongs to: flights, where no split cuts one.

    Parameters
    ----------
    tests : list of ndarray of int
        Held-out rows, one array per split.
    flights : ndarray (n,) of int
        The flight of every row, from 0 on.
    """
    sizes = np.bincount(flights)
    counts = np.array([np.bincount(flights[test], minlength=len(sizes)) for test in tests])
    whole = len(sizes) > 1 and ((counts == 0) | (counts == sizes)).all()
    units = [flights[test] + (0 if whole else k * len(sizes)) for k, test in enumerate(tests)]
    return "flight" if whole else "block", np.concatenate(units)


def unit_weights(units) -> np.ndarray:
    """Return weights of samples that sum to one, the same for every unit."""
    counts = np.bincount(units)
    return 1.0 / (counts[units] * np.count_nonzero(counts))


def weighted_quantile(scores, weights, level) -> float:
    """Return the least score that, with all below it, weighs ``level``; infinite, if all together do not."""
    order = np.argsort(scores)
    reached = np.searchsorted(np.cumsum(weights[order]), level - ROUNDING)
    return float(scores[order][reached]) if reached < len(scores) else np.inf


def units_needed(level) -> int:
    """Return K, the least number of units with K / (K + 1) >= level."""
    return int(np.ceil(level / (1 - level) - ROUNDING))
