"""FlightCheck: faults of logs named and removed."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from numbers import Real

import numpy as np
import pandas as pd
from sklearn.utils._param_validation import Interval

from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import check_clock, flight_segments, part_restarts
from skdgp._flight.faults import (
    POSSIBLE,
    Finding,
    FlightDataWarning,
    faults_message,
    find_faults,
    usual_spacing,
    without_faults,
)
from skdgp.preprocessing._smoother import WRAPPED, _rewrapped, _unwrapped
from skdgp.preprocessing._table import TableTransformer, numeric, with_columns

COLUMNS = ("flight", "channel", "kind", "start", "end", "n_samples", "message")


def inspect_flight(flight: pd.DataFrame, *, ignore: Iterable[str] = ()) -> pd.DataFrame:
    """Return the faults of a flight log, one in a row.

    What is a fault, each channel says itself: a run of equal values is one where the channel's noise and its usual
    rate make it improbable (expected less than once in 10,000 such flights). Sensors slower than the table, quantised
    ones, and controls that a pilot holds still are none.

    ============== ===========================================================================================
    ``restart``    time goes back: the log of a computer that started again
    ``gap``        time jumps forward by more than 2.5 steps
    ``missing``    no value where the channel usually has one
    ``stuck``      a sensor repeats its last value for 0.3 s or longer
    ``impossible`` a value that no aircraft can have; in more than 5 % of samples it is another unit, and none
    ``spike``      up to three samples that leap from their neighbours and back
    ``constant``   a sensor that never changes while its siblings do
    ``saturated``  a surface that stands at its extreme value for 0.5 s or longer, as at a stop
    ============== ===========================================================================================

    Parameters
    ----------
    flight : DataFrame of shape (n, n_columns)
        Flight table, with ``time`` [s], and ``flight`` where it holds several.
    ignore : iterable of str, default=()
        Columns that are not looked at.

    Returns
    -------
    DataFrame
        Columns flight, channel, kind, start and end [s], n_samples, message.

    Raises
    ------
    ValueError
        If ``time`` is missing or not finite, or its rows are in disorder.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time, rng = np.arange(0, 60, 0.025), np.random.default_rng(0)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + rng.normal(0, 0.005, time.size)})
    >>> len(inspect_flight(flight))
    0
    >>> flight.loc[400:479, "alpha"] = flight.alpha[400]
    >>> inspect_flight(flight)[["channel", "kind", "start", "end", "n_samples"]].round(3).values.tolist()
    [['alpha', 'stuck', 10.025, 11.975, 79]]
    """
    check_columns(check_table(flight), ["time"])
    return _as_table(_inspected(flight, ignore)[1])


class FlightCheck(TableTransformer):
    """Take out of a flight log what was not measured, name it, and bridge short gaps.

    For the head of a pipeline. Values of sensors that are stuck, impossible or spikes become NaN. Gaps no longer than
    ``bridge``, of channels that have a value in nearly every row, are interpolated linearly; longer ones stay NaN, and
    :class:`RegressorSelector` refuses such rows of a regressor, naming them. A flight whose clock was restarted becomes
    several, ``name``, ``name#2``. Rows stay as many as they are. ``transform`` tells all in one
    :class:`FlightDataWarning`, except gaps in time, across which nothing is filtered anyway.

    Nothing is learned in ``fit``. See :func:`inspect_flight` for what is looked for.

    Parameters
    ----------
    bridge : float, default=0.25
        Longest gap that is interpolated [s]; 0 for none.
    ignore : sequence of str, default=()
        Columns that are not looked at.

    Attributes
    ----------
    findings_ : DataFrame
        Faults of the table seen in ``fit``, as of :func:`inspect_flight`.
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If ``time`` is missing; if it goes back and the rows are in disorder, or the table has no column ``flight`` to
        name the parts in.

    Warns
    -----
    FlightDataWarning
        In ``transform``, if the log has faults.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time, rng = np.arange(0, 60, 0.025), np.random.default_rng(0)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + rng.normal(0, 0.005, time.size)})
    >>> flight.loc[[500, 501], "alpha"] = -999.0
    >>> check = FlightCheck().fit(flight)
    >>> check.findings_.kind.tolist()
    ['impossible']
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as said:
    ...     warnings.simplefilter("always")
    ...     clean = check.transform(flight)
    >>> len(said), bool(abs(clean.alpha).max() < 0.2)
    (1, True)
    """

    _parameter_constraints: dict = {"bridge": [Interval(Real, 0, None, closed="left")], "ignore": [list, tuple]}

    def __init__(self, *, bridge=0.25, ignore=()):
        self.bridge = bridge
        self.ignore = ignore

    def _recognises(self, X):
        return super()._recognises(X) and "time" in X

    def _fit_table(self, table):
        self.findings_ = _as_table(_inspected(table, self.ignore)[1])

    def _transform_table(self, table):
        check_columns(table, ["time"])
        table, found = _inspected(table, self.ignore)
        faults = [each for each in found if each.kind != "gap"]
        if faults:
            then = f", gaps up to {self.bridge:g} s are interpolated" if self.bridge else ""
            warnings.warn(
                faults_message(faults, f"What was not measured is NaN{then}."), FlightDataWarning, stacklevel=4
            )
        return self._bridged(without_faults(table, found))

    def _columns_out(self, names):
        return names

    def _bridged(self, table):
        """Return the table with short gaps of its measured channels interpolated."""
        names = [name for name in POSSIBLE if name in table and name not in self.ignore]
        names = [name for name in names if pd.api.types.is_numeric_dtype(table[name]) and table[name].isna().any()]
        time, flight, new = numeric(table, ["time"])[:, 0], table.get("flight"), {}
        for name in names if self.bridge else []:
            values = _unwrapped(table, [name])[:, 0]
            for run in flight_segments(time, flight):
                values[run] = _interpolated(time[run], values[run], self.bridge)
            new[name] = _rewrapped(values, table[name].ffill().bfill()) if name in WRAPPED else values
        return with_columns(table, new)


def _inspected(table, ignore) -> tuple[pd.DataFrame, list[Finding]]:
    """Return the table with flights named apart, and its findings."""
    time = numeric(table, ["time"])[:, 0]
    flight = table["flight"] if "flight" in table else np.full(len(table), "flight")
    names, restarts = part_restarts(time, flight)
    if restarts.size and "flight" not in table:
        row = restarts[0]
        raise ValueError(
            f"Got time {time[row]:g} s after {time[row - 1]:g} s at row {row}, where a clock was restarted, but "
            "expected time to increase within a flight: add a column 'flight', in which the parts are named apart."
        )
    check_clock(time, names)
    table = table.assign(flight=names) if restarts.size else table
    found = [_restart(row, time, names) for row in restarts]
    return table, found + find_faults(table, ignore)


def _restart(row, time, names) -> Finding:
    words = f"goes back from {time[row - 1]:.6g} s, a restart: from there on the flight is named {names[row]!r}"
    return Finding(names[row - 1], "time", "restart", float(time[row]), float(time[row]), np.array([row]), words)


def _as_table(findings) -> pd.DataFrame:
    rows = [(*each[:5], len(each.rows), each.message) for each in findings]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _interpolated(time, values, longest):
    """Return values with gaps between samples no longer than that apart filled, if nearly every row has a sample."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 2 or usual_spacing(values) > 1:
        return values
    filled = np.interp(time, time[known], values[known])
    before = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    after = np.minimum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), len(values))[::-1])[::-1]
    inside = (before >= 0) & (after < len(values))
    short = np.zeros(len(values), bool)
    short[inside] = time[after[inside]] - time[before[inside]] <= longest + 1e-9
    return np.where(short, filled, values)
