"""Training subsets and splits of flights.

Hold out whole flights with scikit-learn's ``LeaveOneGroupOut`` or ``GroupKFold`` on the column
``flight``. Neighbouring samples of one flight are nearly equal, so a random split inside a flight
gives scores that are too good. With a single flight, ``BlockSplit`` holds out its blocks, with a
gap in time.
"""

from __future__ import annotations

from collections.abc import Iterator
from numbers import Integral, Real
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import BaseCrossValidator

from skdgp._compute.files import column_names
from skdgp._compute.typing import ArrayLike, Indices, Vector
from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import check_clock, flight_rows

__all__ = ["BlockSplit", "thin_targets"]

MIN_BLOCK_ROWS = (
    3  # a hole of three rows is longer than 2.5 steps, so flight_segments splits the rest there
)


class BlockSplit(BaseCrossValidator):
    """Hold out one contiguous block of every flight at a time, with a gap in time around it.

    Each flight is cut into ``n_splits`` blocks of equally many rows. Split k tests on the k-th
    block of each flight. It trains on the other blocks, without the rows of the same flight within
    ``gap`` seconds of the block: these are nearly equal to test rows (Roberts et al. 2017,
    cross-validation for data with temporal structure). The transformers of this package treat the
    two sides of the hole as two segments.

    Blocks of a flight share its weather and its sensor errors. With several flights, hold out whole
    ones: ``LeaveOneGroupOut()`` or ``GroupKFold(5)`` of scikit-learn with
    ``groups=table["flight"]``.

    Parameters
    ----------
    n_splits : int, default=5
        Blocks of each flight, at least 2.
    gap : float, default=2.0
        Least time between training and test rows of one flight [s]: longer than the aircraft's
        motion is correlated, and than the smoother's window.

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

    # With metadata routing, split gets groups without a request.
    __metadata_request__split = {"groups": True}

    def __init__(self, n_splits: int = 5, *, gap: float = 2.0) -> None:
        self.n_splits = n_splits
        self.gap = gap

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Return the number of splits; arguments are ignored."""
        if (
            not isinstance(self.n_splits, Integral)
            or isinstance(self.n_splits, bool)
            or self.n_splits < 2
        ):
            raise ValueError(
                f"Got n_splits={self.n_splits!r}, but expected a number of blocks, at least 2."
            )
        return int(self.n_splits)

    def split(
        self, X: pd.DataFrame, y: object = None, groups: ArrayLike | None = None
    ) -> Iterator[tuple[Indices, Indices]]:
        """Yield the training rows and the test rows of each split, rising.

        X (n, ...) has the column ``time`` [s], which increases within a flight. ``groups`` (n,) are
        the flight of each row, where X has no column ``flight``; by default all rows are one
        flight. Raises TypeError if X is not a DataFrame, ValueError if a parameter is out of range,
        ``time`` is missing or does not increase within a flight, a flight has too few rows, or no
        training rows are left.
        """
        n_splits, gap = self.get_n_splits(), self.gap
        if not isinstance(gap, Real) or isinstance(gap, bool) or not 0 <= float(gap) < np.inf:
            raise ValueError(f"Got gap={gap!r}, but expected seconds, 0 or more.")
        check_columns(check_table(X), ["time"])
        time = X["time"].to_numpy(dtype=float, na_value=np.nan)
        ids = X["flight"] if "flight" in X else np.zeros(len(X), int) if groups is None else groups
        if len(ids) != len(X):
            raise ValueError(f"Got {len(ids)} groups for {len(X)} rows, but expected as many.")
        flights = flight_rows(ids)
        for name, rows in flights.items():
            check_clock(time[rows], None)
            if len(rows) < MIN_BLOCK_ROWS * n_splits:
                raise ValueError(
                    f"Got {len(rows)} rows of flight {name!r} for n_splits={n_splits} blocks, but "
                    f"expected at least "
                    f"{MIN_BLOCK_ROWS} rows in a block: lower n_splits, or leave the flight out."
                )
        for k in range(n_splits):
            parts = [_split_flight(rows, time[rows], n_splits, k, gap) for rows in flights.values()]
            train, test = (np.sort(np.concatenate(rows)) for rows in zip(*parts, strict=True))
            if not len(train):
                raise ValueError(
                    f"Got gap={gap:g} s, but no row of any flight is so far from its block {k}, "
                    f"so no training rows "
                    "are left: lower gap, or raise n_splits."
                )
            yield train, test


def _split_flight(
    rows: Indices, time: Vector, n_splits: int, k: int, gap: float
) -> tuple[Indices, Indices]:
    """Return the training rows and the test rows of one flight in split k."""
    edges = np.arange(n_splits + 1) * len(rows) // n_splits
    block = slice(edges[k], edges[k + 1])
    first, last = time[block][[0, -1]]
    distance = np.maximum(first - time, time - last)
    return rows[distance >= max(gap, np.finfo(float).tiny)], rows[block]


def thin_targets(Y: Any, n_samples: int) -> Any:
    """Return targets with ``n_samples`` evenly spread observed rows; the others are NaN, not observed.

    Smoothing and differentiation need the flight at its full rate, exact inference a few hundred
    samples. So the training subset is chosen in the targets: transformers get every row, the
    regressor learns from the observed ones.

    Rows that are NaN in every output do not count; where there are fewer than ``n_samples``, all
    stay. The result is a copy of ``Y``, (n,) or (n, P), as floats, of the same type, names and
    index. Raises ValueError if ``n_samples`` is not a positive integer.

    Examples
    --------
    >>> from skdgp.model_selection import thin_targets
    >>> thin_targets([1.0, 2.0, float("nan"), 4.0, 5.0], 2)
    array([nan,  2., nan, nan,  5.])
    """
    if not isinstance(n_samples, Integral) or isinstance(n_samples, bool) or n_samples < 1:
        raise ValueError(
            f"Got n_samples={n_samples!r}, but expected a positive number of rows to keep."
        )
    values = np.array(Y, dtype=float)
    if values.ndim not in (1, 2):
        raise ValueError(f"Got targets of shape {values.shape}, but expected (n,) or (n, P).")
    observed = np.flatnonzero(~np.isnan(values.reshape(len(values), -1)).all(axis=1))
    if n_samples < len(observed):  # the middles of equal parts stay
        chosen = observed[((np.arange(n_samples) + 0.5) * len(observed) / n_samples).astype(int)]
        values[np.setdiff1d(np.arange(len(values)), chosen)] = np.nan
    if isinstance(Y, pd.DataFrame):
        return pd.DataFrame(values, index=Y.index, columns=Y.columns)
    if isinstance(Y, pd.Series):
        return pd.Series(values, index=Y.index, name=Y.name)
    if column_names(Y):  # a table without an index, such as polars'
        return (
            type(Y)(dict(zip(Y.columns, values.T, strict=True)))
            if values.ndim == 2
            else type(Y)(Y.name, values)
        )
    return values
