"""A checked table of flights: a function that takes a FlightTable checks nothing again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.findings import Finding
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import WRAPPED
from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import Clock


@dataclass(frozen=True)
class FlightTable:
    """One flight, or several: a table whose columns, numbers and clock were checked.

    Attributes
    ----------
    table : DataFrame (n, ...)
        SI units and radians; the names, units and axes of its channels are `CHANNELS`.
    clock : Clock
        Time and flight of each row, and the segments without gaps.
    findings : tuple of Finding or None
        What was found in flights whose faults are removed; None of others.
    airspeed_scale : AirspeedScale or None
        Error of their airspeed, where it was estimated, as of `skdgp.estimation.airspeed_scale`.
    """

    table: pd.DataFrame
    clock: Clock
    findings: tuple[Finding, ...] | None = None
    airspeed_scale: Any = None

    @classmethod
    def of(cls, table: object, needed: Iterable[str] = (), *, what: str = "flight") -> FlightTable:
        """Return the flights of a table with ``time`` and the ``needed`` columns.

        Raises TypeError if it is no DataFrame, and ValueError if a column is missing or not
        numeric, time does not increase within a flight, or a row names no flight.
        """
        checked = check_table(table, what=what)
        columns = ["time", *needed]
        check_columns(checked, columns, what=what)
        time = numeric(checked, columns)[:, 0]
        return cls(checked, Clock.of(time, checked.get("flight")))

    @property
    def time(self) -> Vector:
        """Time of each row [s], increasing within each flight."""
        return self.clock.time

    @property
    def segments(self) -> list[slice]:
        """Rows of one flight without gaps, in order, every row once."""
        return self.clock.segments

    @property
    def flights(self) -> dict[str, FlightTable]:
        """Each flight by itself, by name."""
        return {name: self.part(rows) for name, rows in self.clock.rows.items()}

    def part(self, rows: Indices) -> FlightTable:
        """Return the flights of some rows, in their order."""
        return FlightTable(self.table.iloc[rows], self.clock.part(rows), self.findings)

    @classmethod
    def together(cls, flights: Iterable[FlightTable]) -> FlightTable:
        """Return several flights in one table."""
        flights = list(flights)
        joined = cls.of(pd.concat([flight.table for flight in flights], ignore_index=True))
        if any(flight.findings is None for flight in flights):
            return joined
        return replace(joined, findings=())

    def named(self, name: str) -> FlightTable:
        """Return a single flight by another name, its rows counted from 0."""
        table = self.table.reset_index(drop=True).assign(flight=name)
        return FlightTable(table, Clock.of(self.time, table["flight"]), self.findings)

    def column(self, name: str) -> Vector:
        """Return a column as floats, NaN where it is absent."""
        if name not in self.table:
            return np.full(len(self.table), np.nan)
        return self.table[name].to_numpy(float, na_value=np.nan)

    def numeric_channels(self, names: Iterable[str]) -> dict[str, Vector]:
        """Return those of the channels that are in the table and hold numbers, as copies."""
        channels = {}
        for name in names:
            if name in self.table and pd.api.types.is_numeric_dtype(self.table[name]):
                channels[name] = self.column(name).copy()
        return channels


def numeric(table: pd.DataFrame, columns: Iterable[str]) -> Matrix:
    """Return columns as floats (n, k); raise ValueError with the names of columns that are not numeric."""
    columns = list(columns)
    try:
        return table[columns].to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError):
        kinds = {}
        for name in columns:
            if not pd.api.types.is_numeric_dtype(table[name]):
                kinds[name] = str(table[name].dtype)
        raise ValueError(
            f"Got columns of type {kinds}, but expected numbers: convert or drop them."
        ) from None


def unwrapped(table: pd.DataFrame, names: Iterable[str]) -> Matrix:
    """Return columns as floats (n, k), roll and heading without their jumps of 2 pi."""
    names = list(names)
    values = numeric(table, names).copy()
    for j, name in enumerate(names):
        if name in WRAPPED:
            sampled = np.isfinite(values[:, j])
            values[sampled, j] = np.unwrap(values[sampled, j])
    return values


def by_name(names: Sequence[str], values: Array) -> dict[str, Array]:
    """Return the last axis of ``values`` (..., n) by name."""
    return {name: values[..., k] for k, name in enumerate(names)}


def has_values(table: pd.DataFrame, *names: str) -> bool:
    """Return whether the table has all these columns, each with a finite value."""
    if not {*names} <= {*table.columns}:
        return False
    is_sampled = np.isfinite(numeric(table, names))
    return bool(is_sampled.any(axis=0).all())


def interpolated(at: Vector, time: Vector, values: Matrix, beyond: float | None = None) -> Matrix:
    """Return columns (n, k) at other times, by straight lines, ``beyond`` the ends (by default the end's value)."""
    columns = [np.interp(at, time, column, left=beyond, right=beyond) for column in values.T]
    return np.column_stack(columns)


def interpolate_missing(time: Vector, values: Matrix) -> Matrix:
    """Return columns (n, k) with linear interpolation of values that are not finite."""
    sampled = np.where(np.isfinite(values), values, np.nan)
    table = pd.DataFrame(sampled, index=time)
    return np.array(table.interpolate("index", limit_direction="both"), order="C")
