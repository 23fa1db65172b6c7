"""BlockSplit: blocks of flights held out, with a gap in time."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from numbers import Integral, Real

import numpy as np
import pandas as pd
from sklearn.model_selection import BaseCrossValidator

from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import check_clock, flight_rows

FEWEST = 3
"""Rows of a block at least: so wide a hole is seen as one by the clock of what is left (:mod:`skdgp._flight.clock`)."""


class BlockSplit(BaseCrossValidator):
    """Hold out one contiguous block of every flight at a time, with a gap in time around it.

    Each flight is cut into ``n_splits`` blocks of as many rows. Split k tests on the k-th block of each flight and
    trains on the others, less those rows of the same flight that are nearer than ``gap`` seconds to the block: the
    air and the aircraft move slowly, so a neighbour of a training sample is no test (Roberts et al. 2017,
    cross-validation for data with temporal structure). What is left of a flight lies on both sides of a hole, and the
    transformers of this package treat it as two stretches.

    Blocks of a flight share its day, its wind, its sensors' errors. Where there are several flights, hold out whole
    ones: ``LeaveOneGroupOut()`` or ``GroupKFold(5)`` of scikit-learn with ``groups=table["flight"]``.

    Parameters
    ----------
    n_splits : int, default=5
        Blocks of each flight, at least 2.
    gap : float, default=2.0
        Distance in time between training and test rows of one flight [s]. Longer than the aircraft's motion remembers,
        and than the smoother's reach.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.model_selection import BlockSplit
    >>> flight = pd.DataFrame({"time": np.arange(0.0, 10.0, 0.5)})
    >>> for train, test in BlockSplit(n_splits=4, gap=1.0).split(flight):
    ...     print(test[[0, -1]], len(train))
    [0 4] 14
    [5 9] 13
    [10 14] 13
    [15 19] 14
    """

    # With metadata routing, groups reach split without being asked for.
    __metadata_request__split = {"groups": True}

    def __init__(self, n_splits=5, *, gap=2.0):
        self.n_splits = n_splits
        self.gap = gap

    def get_n_splits(self, X=None, y=None, groups=None) -> int:
        """Return the number of splits; arguments are ignored."""
        if not isinstance(self.n_splits, Integral) or isinstance(self.n_splits, bool) or self.n_splits < 2:
            raise ValueError(f"Got n_splits={self.n_splits!r}, but expected a number of blocks, at least 2.")
        return int(self.n_splits)

    def split(self, X, y=None, groups=None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the rows to train on and those to test on, rising.

        Parameters
        ----------
        X : DataFrame (n, ...)
            With the column ``time`` [s], which increases within a flight.
        y : ignored
        groups : array-like (n,), optional
            The flight of each row where X has no column ``flight``; without both, X is one flight.

        Yields
        ------
        train, test : ndarray of int

        Raises
        ------
        TypeError
            If X is not a DataFrame.
        ValueError
            If parameters make no sense, there is no column ``time``, it does not increase within a flight, a flight has
            too few rows, or nothing is left to train on.
        """
        n_splits, gap = self.get_n_splits(), self.gap
        if not isinstance(gap, Real) or isinstance(gap, bool) or not 0 <= gap < np.inf:
            raise ValueError(f"Got gap={gap!r}, but expected seconds, 0 or more.")
        check_columns(check_table(X), ["time"])
        time = X["time"].to_numpy(dtype=float, na_value=np.nan)
        flights = rows_by_flight(X, groups)
        for name, rows in flights.items():
            check_clock(time[rows], None)
            if len(rows) < FEWEST * n_splits:
                raise ValueError(
                    f"Got {len(rows)} rows of flight {name!r} for n_splits={n_splits} blocks, but expected at least "
                    f"{FEWEST} rows in a block: lower n_splits, or leave the flight out."
                )
        for k in range(n_splits):
            parts = [_cut(rows, time[rows], n_splits, k, gap) for rows in flights.values()]
            train, test = (np.sort(np.concatenate(rows)) for rows in zip(*parts, strict=True))
            if not len(train):
                raise ValueError(
                    f"Got gap={gap:g} s, but no row of any flight is so far from its block {k}, so nothing is left to "
                    "train on: lower gap, or raise n_splits."
                )
            yield train, test


def held_out(cv, table: pd.DataFrame, groups) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the pairs of rows of a splitter, whether or not it asks for groups, or of an iterable."""
    if not hasattr(cv, "split"):
        return list(cv)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The groups parameter is ignored")
        return list(cv.split(table, groups=groups))


def rows_by_flight(X: pd.DataFrame, groups=None) -> dict:
    """Return the rows of each flight, by the column ``flight``, else by ``groups``, else of all as one."""
    ids = X["flight"] if "flight" in X else np.zeros(len(X), int) if groups is None else groups
    if len(ids) != len(X):
        raise ValueError(f"Got {len(ids)} groups for {len(X)} rows, but expected as many.")
    return flight_rows(ids)


def _cut(rows, time, n_splits, k, gap):
    """Return the training and the test rows of one flight."""
    edges = np.arange(n_splits + 1) * len(rows) // n_splits
    block = slice(edges[k], edges[k + 1])
    first, last = time[block][[0, -1]]
    apart = np.maximum(first - time, time - last)
    train = apart >= max(gap, np.finfo(float).tiny)
    return rows[train], rows[block]
