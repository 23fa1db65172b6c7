"""Inspection of a log: its topics, the columns of its flight table, and their faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import plain
from skdgp._flight.checks import unknown_columns_message
from skdgp._flight.faults import find_faults, grouped_messages
from skdgp._flight.physics import find_contradictions
from skdgp.io._autopilot import flight_table, is_log, on_one_clock, read_log
from skdgp.io._read import UNKNOWN, PathLike, read_flight
from skdgp.io._tables import FlightReadError, reading

WIDTH = 110


@dataclass(frozen=True, kw_only=True)
class LogSummary:
    """Content of a log.

    Attributes
    ----------
    path, format, firmware, vehicle : str
        The file; ``vehicle`` is None where the log does not say.
    topics : DataFrame
        Every message type with a time: ``messages``, and their mean ``rate`` [Hz].
    columns : DataFrame
        Columns of the flight table: ``source`` and its ``rate`` [Hz].
    flights : DataFrame
        Flights in the air: ``begin`` and ``end`` [s], mean ``airspeed`` [m/s].
    remarks : tuple of str
        Why there is no flight, damage, faults of clock and channels, and channels that contradict
        each other by physics.
    """

    path: str
    format: str
    firmware: str
    vehicle: str | None = None
    topics: pd.DataFrame
    columns: pd.DataFrame
    flights: pd.DataFrame
    remarks: tuple[str, ...]

    def to_dict(self) -> dict:
        """Return everything as lists, dicts, texts and numbers, NaN as None, ready for JSON."""
        tables = {
            "topics": self.topics.reset_index(names="name"),
            "columns": self.columns.reset_index(names="name"),
            "flights": self.flights.reset_index(names="name"),
        }
        return plain(
            vars(self) | {name: frame.to_dict("records") for name, frame in tables.items()}
        )

    def __str__(self) -> str:
        vehicle = self.vehicle or "vehicle unknown"
        kinds = self.columns.groupby(["source", "rate"], sort=False, dropna=False)
        parts = [
            [f"{self.path}: {self.format}, {self.firmware}, {vehicle}"],
            [
                f"{row.Index} {row.messages} times, {row.rate:.3g} Hz"
                for row in self.topics.itertuples()
            ],
            [f"{rate:.3g} Hz: {' '.join(rows.index)} ({source})" for (source, rate), rows in kinds],
            [
                f"flight from {a:.1f} s to {b:.1f} s at {v:.1f} m/s"
                for a, b, v in self.flights.to_numpy()
            ],
            [f"! {remark}" for remark in self.remarks],
        ]
        return "\n\n".join(
            "\n".join(fill(line, WIDTH, subsequent_indent="    ") for line in lines)
            for lines in parts
            if lines
        )


def inspect_log(
    path: PathLike,
    *,
    servos: PathLike | Mapping[str, Any] | None = None,
    rename: Mapping[str, str] | None = None,
) -> LogSummary:
    r"""Return format, vehicle, topics, columns and their sources, flights, and faults of a log.

    ``path``, ``servos`` and ``rename`` are as of :func:`read_flight`. ``print`` shows the summary. Raises
    FlightReadError if the file cannot be read (a log without a flight can), FileNotFoundError if
    there is none.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "sortie.csv"
    >>> _ = path.write_text("time,airspeed,alpha\n0,20,0.1\n0.02,21,0.2\n0.04,20,0.1\n")
    >>> summary = inspect_log(path)
    >>> summary.format, summary.columns.index.tolist()
    ('table', ['airspeed', 'alpha'])
    """
    path = Path(path)
    if not is_log(path):
        return _of_table(path, read_flight(path, rename=rename))
    with reading(path):
        flown = on_one_clock(path, servos=servos)
    longest = max(flown.parts, key=lambda part: len(part.table))
    log = flown.log
    try:
        table = flight_table(flown, path.stem, airborne=True)
        faults = _faults(table)
    except FlightReadError as error:
        table, faults = longest.table[:0].assign(flight=""), [str(error)]
    topics = {
        name: (len(topic), (len(topic) - 1) / max(np.ptp(topic.time), 1e-9))
        for name, topic in longest.topics.items()
    }
    return LogSummary(
        path=str(path),
        format=log.kind,
        firmware=log.firmware,
        vehicle=log.vehicle,
        topics=pd.DataFrame.from_dict(topics, orient="index", columns=["messages", "rate"]),
        columns=pd.DataFrame.from_dict(flown.origin, orient="index", columns=["source", "rate"]),
        flights=_flights(table),
        remarks=(*flown.remarks, *faults),
    )


def names_servos(path: PathLike) -> bool:
    """Return whether the parameters of a log of an autopilot name servos; raise FlightReadError if it is none."""
    with reading(path):
        log = read_log(Path(path))
    return bool(log.servos or log.mixing)


def _of_table(path: Path, table: pd.DataFrame) -> LogSummary:
    """Return the summary of a file that is no log of an autopilot."""
    steps = table.groupby("flight", sort=False)["time"].diff().dropna()
    step = steps.median() if len(steps) else np.nan
    unknown = table.attrs[UNKNOWN]
    channels = table.drop(columns=["time", "flight", *unknown])
    columns = pd.DataFrame(
        {"source": "column", "rate": channels.notna().mean() / step}, index=channels.columns
    )
    unknown_names = unknown_columns_message(unknown, table.columns)
    return LogSummary(
        path=str(path),
        format="table",
        firmware=path.suffix.lstrip("."),
        topics=pd.DataFrame(),
        columns=columns,
        flights=_flights(table),
        remarks=(
            *([f"columns of unknown names: {unknown_names}"] if unknown_names else []),
            *_faults(table),
        ),
    )


def _flights(table: pd.DataFrame) -> pd.DataFrame:
    """Return begin and end [s] of each flight, and its mean airspeed."""
    flights = table.assign(airspeed=table.get("airspeed", np.nan)).groupby("flight", sort=False)
    return flights.agg(begin=("time", "first"), end=("time", "last"), airspeed=("airspeed", "mean"))


def _faults(table: pd.DataFrame) -> list[str]:
    """Return faults and contradictions of flights; no contradiction if their clocks are too irregular to filter."""
    faults = grouped_messages(find_faults(table))
    try:
        return faults + [str(contradiction) for contradiction in find_contradictions(table)]
    except ValueError:
        return faults
