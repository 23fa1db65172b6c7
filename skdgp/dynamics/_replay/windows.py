"""Restart windows: a flight cut into segments of one horizon, integrated as one batch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

__all__ = ["restart_windows", "runs_of"]


def runs_of(good: np.ndarray, segments: Iterable[slice]) -> list[slice]:
    """Return the longest stretches of ``segments`` in which every row is ``good`` (n,)."""
    runs = []
    for segment in segments:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good[segment].astype(int), [0]])))
        runs += [slice(segment.start + a, segment.start + b) for a, b in edges.reshape(-1, 2).tolist()]
    return runs


def restart_windows(
    time: np.ndarray, runs: Iterable[slice], horizon: float, known: np.ndarray | None = None
) -> np.ndarray:
    """Return the rows of each window, (n_windows, n_steps + 1), shorter windows padded with their last row.

    A window starts at a row of a run whose state is ``known`` (n,), by default any, and ends at the last such row no
    more than ``horizon`` [s] later, where the next one starts: neighbours share that row. Where no known row lies
    within the horizon, the window ends with the horizon and the next one starts at the next known row.

    Examples
    --------
    >>> import numpy as np
    >>> restart_windows(np.arange(6) * 0.5, [slice(0, 6)], horizon=1.0)
    array([[0, 1, 2],
           [2, 3, 4],
           [4, 5, 5]])
    """
    known = np.ones(len(time), dtype=bool) if known is None else known
    windows = [window for run in runs for window in _windows_of_run(time, run, horizon, np.flatnonzero(known))]
    if not windows:
        return np.empty((0, 1), dtype=int)
    length = max(map(len, windows))
    return np.stack([np.pad(rows, (0, length - len(rows)), mode="edge") for rows in windows])


def _windows_of_run(time: np.ndarray, run: slice, horizon: float, known: np.ndarray) -> Iterator[np.ndarray]:
    starts = known[(known >= run.start) & (known < run.stop - 1)]
    at = 0
    while at < len(starts):
        start = starts[at]
        # A millionth of the horizon forgives the rounding of stored times.
        end = time[start] + horizon * (1 + 1e-6) + 1e-9
        last = max(run.start + int(np.searchsorted(time[run], end, side="right")) - 1, start + 1)
        following = int(np.searchsorted(starts, last, side="right")) - 1
        if following > at and last < run.stop - 1:
            last, at = starts[following], following
        else:
            at = int(np.searchsorted(starts, last))
        yield np.arange(start, last + 1)
