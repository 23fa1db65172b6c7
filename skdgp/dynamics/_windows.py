"""Restart windows: a flight cut into stretches of one horizon, so that all can be integrated as one batch."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

__all__ = ["restart_windows", "runs_of"]


def runs_of(good: np.ndarray, segments: Iterable[slice]) -> list[slice]:
    """Return the longest stretches of ``segments`` in which every row is ``good`` (n,)."""
    runs = []
    for segment in segments:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good[segment].astype(int), [0]])))
        runs += [slice(segment.start + a, segment.start + b) for a, b in edges.reshape(-1, 2).tolist()]
    return runs


def restart_windows(time: np.ndarray, runs: Iterable[slice], horizon: float) -> np.ndarray:
    """Return the rows of each window, (n_windows, n_steps + 1), shorter windows padded with their last row.

    A window starts at a row of a run and ends at the last row no more than ``horizon`` [s] later, where the
    next one starts: neighbours share that row.

    Examples
    --------
    >>> import numpy as np
    >>> restart_windows(np.arange(6) * 0.5, [slice(0, 6)], horizon=1.0)
    array([[0, 1, 2],
           [2, 3, 4],
           [4, 5, 5]])
    """
    windows = []
    for run in runs:
        clock, start = time[run], 0
        # A millionth of the horizon forgives the rounding of stored times.
        while start < len(clock) - 1:
            last = int(np.searchsorted(clock, clock[start] + horizon * (1 + 1e-6) + 1e-9, side="right")) - 1
            last = max(last, start + 1)
            windows.append(np.arange(run.start + start, run.start + last + 1))
            start = last
    if not windows:
        return np.empty((0, 1), dtype=int)
    length = max(map(len, windows))
    return np.stack([np.pad(rows, (0, length - len(rows)), mode="edge") for rows in windows])
