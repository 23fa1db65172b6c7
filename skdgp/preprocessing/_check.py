"""FlightCheck and inspect_flight: faults of logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Real

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.sklearn_compat import Interval
from skdgp._compute.typing import Vector
from skdgp._flight.channels import CHANNELS
from skdgp._flight.checks import (
    WRAPPED,
    check_airspeed,
    check_columns,
    check_table,
    numeric,
    unwrapped,
)
from skdgp._flight.clock import check_clock, flight_segments
from skdgp._flight.faults import (
    Finding,
    FlightDataWarning,
    faults_message,
    find_faults,
    usual_spacing,
    without_faults,
)
from skdgp.preprocessing._table import TableTransformer, with_columns, wrapped_near

BRIDGED = [name for name in CHANNELS if name not in ("time", "flight")]


def inspect_flight(flight: pd.DataFrame, *, ignore: Iterable[str] = ()) -> pd.DataFrame:
    """Return the faults of a flight log, one per row.

    A run of equal values is a fault if the channel's noise and usual rate make it improbable (less
    than once in 10,000 such flights). Sensors slower than the table, quantised sensors, and
    controls held still are no faults.

    ============== ===========================================================================================
    ``gap``        time jumps forward by more than 2.5 steps
    ``missing``    no value where the channel usually has one
    ``stuck``      a sensor repeats its last value for 0.3 s or longer
    ``impossible`` a value that no aircraft has; in more than 5 % of the samples it is another unit,
    and no fault
    ``spike``      up to three samples that jump away from their neighbours
    ``constant``   a sensor that never changes while similar ones do
    ============== ===========================================================================================

    Raises ValueError if ``time`` is missing, not finite or not in order.

    Parameters
    ----------
    flight : DataFrame of shape (n, n_columns)
        Flight table, with ``time`` [s], and ``flight`` where it holds several.
    ignore : iterable of str, default=()
        Columns to skip.

    Returns
    -------
    DataFrame
        Columns flight, channel, kind, start and end [s], n_samples, message.

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
    return _as_table(_inspect(flight, ignore))


class FlightCheck(TableTransformer):
    """Remove the faults of a flight log, and interpolate short gaps: the first step of a pipeline.

    Stuck and impossible values and spikes (:func:`inspect_flight`) become NaN. Gaps up to
    ``bridge`` are interpolated linearly, in channels with a value in nearly every row; longer ones
    stay NaN, which :class:`RegressorSelector` refuses. Raises ValueError if ``time`` is missing, or
    does not increase within a flight; in ``transform`` if an airspeed is not positive.

    Parameters
    ----------
    bridge : float, default=0.25
        Longest gap to interpolate [s]; 0 for none.
    ignore : sequence of str, default=()
        Columns to skip.

    Attributes
    ----------
    findings_ : DataFrame
        :func:`inspect_flight` of the table of ``fit``.

    Warns
    -----
    FlightDataWarning
        In ``transform``, if the log has faults other than gaps in time; one warning of all.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time, rng = np.arange(0, 60, 0.025), np.random.default_rng(0)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + rng.normal(0, 0.005, time.size)})
    >>> flight.loc[[500, 501], "alpha"] = -999.0
    >>> FlightCheck().fit(flight).findings_.kind.tolist()
    ['impossible']
    """

    _parameter_constraints: dict = {
        "bridge": [Interval(Real, 0, None, closed="left")],
        "ignore": [list, tuple],
    }

    def __init__(self, *, bridge: float = 0.25, ignore: Sequence[str] = ()) -> None:
        self.bridge = bridge
        self.ignore = ignore

    def _has_known_column(self, X):
        return super()._has_known_column(X) and "time" in X

    def _fit_table(self, table):
        self.findings_ = _as_table(_inspect(table, self.ignore))

    def _transform_table(self, table):
        check_columns(table, ["time"])
        findings = _inspect(table, self.ignore)
        faults = [finding for finding in findings if finding.kind != "gap"]  # no error
        if faults:
            then = f", gaps up to {self.bridge:g} s are interpolated" if self.bridge else ""
            warn(
                faults_message(faults, f"Faulty values are NaN{then}."),
                FlightDataWarning,
                stacklevel=4,
            )
        table = without_faults(table, findings)
        check_airspeed(table)
        names = [
            name for name in BRIDGED if self.bridge and name in table and name not in self.ignore
        ]
        names = [
            name
            for name in names
            if pd.api.types.is_numeric_dtype(table[name]) and table[name].isna().any()
        ]
        time, flight, new = numeric(table, ["time"])[:, 0], table.get("flight"), {}
        for name in names:
            values = unwrapped(table, [name])[:, 0]
            for run in flight_segments(time, flight):
                values[run] = _interpolated(time[run], values[run], self.bridge)
            new[name] = (
                wrapped_near(values, table[name].ffill().bfill()) if name in WRAPPED else values
            )
        return with_columns(table, new)


def _inspect(table: pd.DataFrame, ignore: Iterable[str]) -> list[Finding]:
    """Return the findings of a table whose time increases within each flight."""
    check_clock(numeric(table, ["time"])[:, 0], table.get("flight"))
    return find_faults(table, ignore)


def _as_table(findings: list[Finding]) -> pd.DataFrame:
    rows = [(*finding[:5], len(finding.rows), finding.message) for finding in findings]
    return pd.DataFrame(rows, columns=[*Finding._fields[:5], "n_samples", "message"])


def _interpolated(time: Vector, values: Vector, longest: float) -> Vector:
    """Return values with gaps up to ``longest`` [s] interpolated, if nearly every row has a sample."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 2 or usual_spacing(values) > 1:
        return values
    filled = np.interp(time, time[known], values[known])
    after = np.searchsorted(
        known, np.arange(len(values))
    )  # the next sample of each row, in ``known``
    inside = (after > 0) & (after < len(known))
    gap = np.diff(time[known])[after[inside] - 1]
    values[inside] = np.where(gap <= longest + 1e-9, filled[inside], values[inside])
    return values
