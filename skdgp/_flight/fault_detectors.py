"""Detectors of faults in one channel: holds, spikes, stops, lost samples. Arrays in, rows out.

A sensor with noise hardly ever repeats a value: where a share p of all runs of equal values is longer than usual, one
of k times the usual length has a chance of p^(k-1). The usual length is the channel's own, so that a sensor slower than
the table is not stuck. Where a channel has no noise, or moves quantum by quantum, runs say little: it is stuck only if
it then leaps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ENOUGH = 50
"""Fewer samples do not tell what is usual."""
IMPROBABLE = 1e-4
"""Expected number of such runs in a flight below which chance is ruled out."""
LEAST_HOLD = 0.3
"""Seconds below which a hold is not worth telling."""
LEAST_STOP = 0.5
"""Seconds at the extreme value from which a surface is at its stop."""
SPIKE = 8.0
"""A spike stands out from its neighbours by so many times what all but 0.5 % of samples do."""
WIDEST_SPIKE = 3
SMOOTH = 0.5
"""Steps that change by less than this share of themselves are those of a channel without noise (with noise: 1.7)."""
LOST = 1.5
"""A sample is lost where the next comes later than so many usual spacings."""


class Runs(NamedTuple):
    """Runs of equal values: where they begin, how long they are (rows), and in usual lengths."""

    start: np.ndarray
    length: np.ndarray
    k: np.ndarray
    chance: np.ndarray
    """Expected number of runs at least so long in the flight."""


def runs_of(values) -> Runs:
    """Return the runs of equal values and how probable they are."""
    start = np.flatnonzero(np.r_[True, np.diff(values) != 0])
    length = np.diff(np.r_[start, len(values)])
    k = np.floor(length / np.median(length))
    share = (1 + np.sum(length >= 1.5 * np.median(length))) / (1 + len(length))
    return Runs(start, length, k, len(length) * share ** (k - 1))


def holds(values, step: float) -> list[np.ndarray]:
    """Return the rows of each stretch in which a sensor repeats its last value, improbably often."""
    rows = np.flatnonzero(np.isfinite(values))
    seen = values[rows]
    if len(rows) < ENOUGH or np.ptp(seen) == 0:
        return []
    runs = runs_of(seen)
    leap = np.abs(np.diff(seen[runs.start], append=np.nan))
    steps = leap[:-1]
    quantum = np.quantile(steps, 0.01)
    bend = np.median(np.abs(np.diff(seen[runs.start], 2))) / np.median(steps) if len(steps) > 1 else np.inf
    stuck = (runs.chance < IMPROBABLE) & (runs.length * step >= LEAST_HOLD)
    if bend < SMOOTH or np.median(steps) <= LOST * quantum:
        stuck &= leap > max(3 * quantum, np.quantile(steps, 0.99))
    return [rows[first + 1 : first + n] for first, n in zip(runs.start[stuck], runs.length[stuck], strict=True)]


def spikes(values, *, angle: bool) -> np.ndarray:
    """Return the rows of a few samples that leap from their neighbours and back."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < ENOUGH:
        return np.empty(0, int)
    start = np.flatnonzero(np.r_[True, np.diff(values[known]) != 0])
    fresh = values[known[start]]
    seen = np.unwrap(fresh) if angle else fresh
    if len(seen) < ENOUGH:
        return np.empty(0, int)
    padded = np.pad(seen, 2, mode="reflect")
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    out = np.abs(seen - around)
    far = out > SPIKE * np.quantile(out, 0.995)
    found = [first + np.arange(n) for first, n in _true_runs(far) if n <= WIDEST_SPIKE]
    back = [part for part in found if _returns(seen, part, out[part].max())]
    edges = np.r_[start, len(known)]
    return np.concatenate([known[edges[part[0]] : edges[part[-1] + 1]] for part in back] or [known[:0]])


def stops(values, step: float) -> list[np.ndarray]:
    """Return the rows at the smallest and the largest value, each where a surface that else moves is held there."""
    rows = np.flatnonzero(np.isfinite(values))
    seen = values[rows]
    if len(rows) < ENOUGH or np.ptp(seen) == 0:
        return []
    runs = runs_of(seen)
    level = seen[runs.start]
    long = (runs.chance < IMPROBABLE) & (runs.length * step >= LEAST_STOP)
    ends = (level == seen.min()) | (level == seen.max())
    if np.sum(long & ~ends) * 2 > np.sum(long & ends):  # one who holds the stick elsewhere holds it there too
        return []
    found = []
    for extreme in (seen.min(), seen.max()):
        held = long & (level == extreme)
        if held.any():
            parts = zip(runs.start[held], runs.length[held], strict=True)
            found.append(np.concatenate([rows[first : first + n] for first, n in parts]))
    return found


def lost(values) -> list[np.ndarray]:
    """Return the rows of each stretch in which a channel has no values although it usually would."""
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        return [np.arange(len(values))]
    spacing = np.diff(np.r_[-1, known, len(values)])
    wide = np.flatnonzero(spacing > LOST * usual_spacing(values))
    before = np.r_[-1, known][wide]
    return [np.arange(first + 1, first + n) for first, n in zip(before, spacing[wide], strict=True)]


def usual_spacing(values) -> float:
    """Return how many rows lie between a sample and the next, but for a tenth of them."""
    known = np.flatnonzero(np.isfinite(values))
    return float(np.quantile(np.diff(known), 0.9)) if known.size > 1 else 1.0


def _returns(seen, part, size):
    before, after = max(part[0] - 1, 0), min(part[-1] + 1, len(seen) - 1)
    return abs(seen[after] - seen[before]) < size / 2


def _true_runs(flags):
    """Return (first, length) of each run of True."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(int)))
    return [(int(a), int(b - a)) for a, b in edges.reshape(-1, 2)]
