"""Rows of a log from which a search learns hyperparameters, and blocks of rows that are held out."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.typing import Indices, Matrix, Seed

SEARCH_VALUES, OUTPUT_VALUES = (1000, 1800), 300  # least and most values that a search learns from; of each output
BLOCKS, HELD_OUT = 5, 0.2  # number of blocks that are held out, and their share of the log
GAP = 0.1  # rows left out on either side of a block, over its length: neighbours are correlated
HELD_OUT_ROWS = 300  # largest number of rows at which the error is measured
FEWEST_VALUES = 40  # values of each output below which nothing is held out: their error would be chance


def stratified(rows: Any, n, random_state: Any):
    """Return a stratified sample of n rows: one random row of each of n equal parts, since neighbours are redundant."""
    if n >= len(rows):
        return rows
    edges = np.linspace(0, len(rows), n + 1)
    return rows[(edges[:-1] + np.diff(edges) * random_state.uniform(size=n)).astype(int)]


def some_rows(Y: Matrix, random_state: Seed):
    """Return rows that a search learns from, with an equal number of values for each output where it has them."""
    observed, P = np.isfinite(Y), Y.shape[1]
    quota = -(-int(np.clip(P * OUTPUT_VALUES, *SEARCH_VALUES)) // P)
    rows = stratified(np.arange(len(Y)), max(2, P * quota * len(Y) // observed.sum()), random_state)
    for output in observed.T:
        n_missing = min(quota, output.sum()) - output[rows].sum()
        rest = np.setdiff1d(np.flatnonzero(output), rows, assume_unique=True)
        rows = np.concatenate([rows, stratified(rest, max(n_missing, 0), random_state)])
    return np.sort(rows)


def held_out_rows(Y: Matrix, random_state: Any) -> tuple[Indices, Indices | None]:
    """Return rows to learn from and rows to hold out, for early stopping.

    Held out is one block of rows at a random place in each of BLOCKS parts of the log, with a gap on either side. None
    is held out where an output would have too few values.
    """
    observed = np.flatnonzero(np.isfinite(Y).any(axis=1))
    edges = np.linspace(0, len(observed), BLOCKS + 1)
    length = HELD_OUT * len(observed) / BLOCKS
    gap = GAP * length
    starts = edges[:-1] + gap + (np.diff(edges) - length - 2 * gap) * random_state.uniform(size=BLOCKS)
    place = np.arange(len(observed))
    inside = (place >= starts[:, None]) & (place < starts[:, None] + length)
    near = (place >= starts[:, None] - gap) & (place < starts[:, None] + length + gap)
    held, rest = observed[inside.any(axis=0)], observed[~near.any(axis=0)]
    if min(np.isfinite(Y[held]).sum(axis=0).min(), np.isfinite(Y[rest]).sum(axis=0).min()) < FEWEST_VALUES:
        return some_rows(Y, random_state), None
    return rest[some_rows(Y[rest], random_state)], held
