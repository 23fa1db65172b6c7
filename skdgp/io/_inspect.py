"""Inspection of a log: its content, and the missing columns of each step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import plain
from skdgp._flight.channels import EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, SURFACES
from skdgp._flight.checks import unknown_columns_message
from skdgp._flight.clock import flight_rows
from skdgp._flight.faults import SENSORS, find_faults, grouped_messages
from skdgp._flight.physics import find_contradictions
from skdgp.io._autopilot import (
    AUTOPILOTS,
    gaps,
    is_log,
    no_flight_because,
    on_one_clock,
    read_log,
    sampling_rate,
)
from skdgp.io._log import Topic
from skdgp.io._read import PathLike, read_flight
from skdgp.io._servos import template
from skdgp.io._tables import FlightReadError, reading

# Columns that each step reads; alternatives are joined by "or", among them steps that compute the
# column
NEEDS = {
    "coefficients": ("airspeed", "density", *SPECIFIC_FORCE, *RATES, "thrust_x or propeller_speed"),
    "reconstruction": (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, "airspeed"),
    "regressors": (
        *("airspeed", *RATES, "alpha or reconstruction", "beta or reconstruction", "throttle"),
        *("elevator or elevon_left", "aileron or elevon_right", "rudder"),
    ),
    "replay": (*EULER, "v_north or u", "v_east or v", "v_down or w"),
}
ADVICE = {
    "servos": "angles of the surfaces: a servo file gives them (--servo-template FILE writes one "
    "to fill in)",
    "thrust_x or propeller_speed": "propeller_speed: log RPM or ESC telemetry, add thrust "
    "columns, or take no thrust",
    "airspeed": "airspeed: a pitot tube, calibrated and enabled, or ground velocity less an "
    "estimated wind",
    "alpha or reconstruction": "alpha, beta: vanes, or the columns of the reconstruction",
}
COLUMN = ["source", "rate", "constant"]  # facts of a column of the flight table
STEADY = 0.5  # with fewer messages than this fraction of rate times duration a topic has no rate
SHORT = 1.0  # nor with messages over fewer seconds
MOST_FLIGHTS = 6  # more flights are summed up in one line
WIDTH = 110


@dataclass(frozen=True, kw_only=True)
class LogSummary:
    """Content of a log, and the missing columns of each step.

    Attributes
    ----------
    path, format, firmware, vehicle : str
        The file; ``vehicle`` is None where the log does not say.
    duration : float
        From the first to the last row of the table [s].
    topics : DataFrame
        Every message type with a time: ``messages``, their ``rate`` [Hz] (NaN for events),
        ``gaps`` and the ``longest_gap`` [s].
    columns : DataFrame
        Columns of the flight table: ``source``, its ``rate`` [Hz], and whether they are
        ``constant``.
    missing : dict of str to tuple of str
        By step (coefficients, reconstruction, regressors, replay): columns that it lacks.
    flights : DataFrame
        Flights in the air: ``begin`` and ``end`` [s], mean ``airspeed`` [m/s].
    no_flight : str
        Why there are none; empty if there are some.
    remarks : tuple of str
        Damage, gaps, faults of clock and channels, and channels that contradict each other by
        physics.
    """

    path: str
    format: str
    firmware: str
    vehicle: str | None = None
    duration: float
    topics: pd.DataFrame = field(default_factory=pd.DataFrame)
    columns: pd.DataFrame
    missing: dict[str, tuple[str, ...]]
    flights: pd.DataFrame
    no_flight: str = ""
    remarks: tuple[str, ...]

    def to_dict(self) -> dict:
        """Return everything as lists, dicts, texts and numbers, NaN as None, ready for JSON."""
        tables = {
            "topics": self.topics.reset_index(names="name"),
            "columns": self.columns.reset_index(names="name"),
            "flights": self.flights,
        }
        return plain(
            vars(self) | {name: frame.to_dict("records") for name, frame in tables.items()}
        )

    def __str__(self) -> str:
        vehicle = self.vehicle or "vehicle unknown"
        title = f"{self.path}: {self.format}, {self.firmware}, {vehicle}, {self.duration:.1f} s"
        lines = [title, "", *(f"  {line}" for line in self._flight_lines()), ""]
        kinds = self.columns.groupby(["source", "rate", "constant"], sort=False, dropna=False)
        lines += [
            _hanging(
                f"{rate:>8.3g} Hz  {' '.join(rows.index)}: {source}"
                f"{' (never changes)' * bool(constant)}",
                15,
            )
            for (source, rate, constant), rows in kinds
        ]
        lines.append("")
        lines += [
            _hanging(
                f"{step:<18}{'lacks ' * bool(names)}{', '.join(names) or 'nothing missing'}", 20
            )
            for step, names in self.missing.items()
        ]
        lacking = {name for names in self.missing.values() for name in names}
        if any(name.startswith(SURFACES) for name in lacking):
            lacking.add("servos")
        lines += [f"{'':20}- {advice}" for name, advice in ADVICE.items() if name in lacking]
        lines += ["", *(_hanging(f"! {remark}", 4) for remark in self.remarks)]
        topics = ", ".join(f"{name} {_often(row)}" for name, row in self.topics.iterrows())
        return "\n".join([*lines, *(["", _hanging(f"topics: {topics}", 4)] if topics else [])])

    def _flight_lines(self) -> list[str]:
        """Return a line for each flight, or one for many."""
        seconds = self.flights["end"] - self.flights["begin"]
        speeds = self.flights["airspeed"]
        if len(self.flights) > MOST_FLIGHTS:
            speed = f" at {speeds.min():.1f} to {speeds.max():.1f} m/s" * bool(speeds.notna().any())
            return [
                f"{len(seconds)} flights of {seconds.min():.1f} to {seconds.max():.1f} s{speed}"
            ]
        lines = [
            f"flight from {begin:.1f} s to {end:.1f} s"
            + f" at {airspeed:.1f} m/s" * bool(np.isfinite(airspeed))
            for begin, end, airspeed in self.flights.to_numpy(float)
        ]
        return lines or [f"no flight: {self.no_flight}"]


def _often(topic: pd.Series) -> str:
    """Return how often a topic was logged, in words."""
    if np.isnan(topic["rate"]):
        return f"{topic['messages']:.0f} times"
    return f"{topic['rate']:.3g} Hz" + f" ({topic['gaps']:.0f} gaps)" * bool(topic["gaps"])


def inspect_log(
    path: PathLike,
    *,
    servos: PathLike | Mapping[str, Any] | None = None,
    rename: Mapping[str, str] | None = None,
) -> LogSummary:
    r"""Return format, vehicle, topics, columns and their sources, flights, and missing columns of a log.

    ``path``, ``servos`` and ``rename`` are as of :func:`read_flight`. ``print`` shows the summary. Raises
    FlightReadError if the file cannot be read (a log without a flight can), FileNotFoundError if
    there is none.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "sortie.csv"
    >>> _ = path.write_text("time,airspeed,alpha\n0,20,0.1\n0.02,21,0.2\n0.04,20,0.1\n")
    >>> summary = inspect_log(path)
    >>> summary.format, summary.missing["replay"]
    ('table', ('phi', 'theta', 'psi', 'v_north or u', 'v_east or v', 'v_down or w'))
    """
    path = Path(path)
    if not is_log(path):
        return _of_table(path, read_flight(path, rename=rename))
    with reading(path):
        flown = on_one_clock(path, servos=servos)
    longest = max(flown.parts, key=lambda part: len(part.table))
    log = flown.log
    columns = pd.DataFrame.from_dict(
        {
            name: (*flown.origin[name], values.nunique() < 2)
            for name, values in longest.table.items()
            if name in flown.origin
        },
        orient="index",
        columns=COLUMN,
    )
    tables = [part.table.iloc[rows] for part in flown.parts for rows in part.segments]
    return LogSummary(
        path=str(path),
        format=log.kind,
        firmware=log.firmware,
        vehicle=log.vehicle,
        duration=float(sum(np.ptp(part.table["time"]) for part in flown.parts if len(part.table))),
        topics=pd.DataFrame.from_dict(
            {name: _topic(topic) for name, topic in longest.topics.items()},
            orient="index",
            columns=["messages", "rate", "gaps", "longest_gap"],
        ),
        columns=columns,
        missing=missing_for(columns),
        flights=_flights(tables),
        no_flight="" if tables else no_flight_because(flown),
        remarks=(*flown.remarks, *_contradictions(tables)),
    )


def servo_template(path: PathLike) -> str:
    """Return the text of a servo file for a log of an autopilot, to be filled in with the angles of the surfaces.

    Raises FlightReadError if the file cannot be read, is no such log, or holds nothing that was
    sent to servos.
    """
    if not is_log(path):
        raise FlightReadError(
            f"Got {path}, but expected a log of an autopilot: {', '.join(AUTOPILOTS)}."
        )
    with reading(path):
        return template(read_log(Path(path)))


def names_servos(path: PathLike) -> bool:
    """Return whether the parameters of a log of an autopilot name servos; raise FlightReadError if it is none."""
    with reading(path):
        log = read_log(Path(path))
    return bool(log.servos or log.mixing)


def missing_for(columns: pd.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return by step the columns that are missing, or a sensor's that never change."""
    present = set(columns.index[~(columns["constant"] & columns.index.isin(SENSORS))])
    missing: dict[str, tuple[str, ...]] = {}
    for step, needs in NEEDS.items():
        possible = {before for before, lacking in missing.items() if not lacking}
        missing[step] = tuple(
            need for need in needs if not set(need.split(" or ")) & (present | possible)
        )
    return missing


def _of_table(path: Path, table: pd.DataFrame) -> LogSummary:
    """Return the summary of a file that is no log of an autopilot."""
    steps = table.groupby("flight", sort=False)["time"].diff().dropna()
    rate = 1 / float(steps.median()) if len(steps) else np.nan
    unknown = table.attrs["unknown_columns"]
    channels = table.drop(columns=["time", "flight", *unknown])
    columns = pd.DataFrame(
        {
            "source": "column",
            "rate": rate * channels.notna().mean(),
            "constant": channels.nunique() < 2,
        },
        index=channels.columns,
        columns=COLUMN,
    )
    tables = [table.iloc[rows] for rows in flight_rows(table["flight"]).values()]
    flights = _flights(tables)
    unknown_names = unknown_columns_message(unknown, table.columns)
    remarks = [f"columns of unknown names: {unknown_names}"] if unknown_names else []
    remarks += grouped_messages(find_faults(table))
    return LogSummary(
        path=str(path),
        format="table",
        firmware=path.suffix.lstrip("."),
        duration=float((flights["end"] - flights["begin"]).sum()),
        columns=columns,
        missing=missing_for(columns),
        flights=flights,
        remarks=(*remarks, *_contradictions(tables)),
    )


def _flights(tables: list[pd.DataFrame]) -> pd.DataFrame:
    rows = [
        (
            table["time"].iloc[0],
            table["time"].iloc[-1],
            table["airspeed"].mean() if "airspeed" in table else np.nan,
        )
        for table in tables
    ]
    return pd.DataFrame(rows, columns=["begin", "end", "airspeed"], dtype=float)


def _contradictions(tables) -> tuple[str, ...]:
    """Return what contradicts physics in the flights of a log; nothing if their clocks are too irregular to filter."""
    if not tables:
        return ()
    numbered = [table.assign(flight=number) for number, table in enumerate(tables, start=1)]
    try:
        return tuple(map(str, find_contradictions(pd.concat(numbered, ignore_index=True))))
    except ValueError:
        return ()


def _topic(topic: Topic) -> tuple[int, float, int, float]:
    """Return messages, rate, number of gaps and the longest one of a topic."""
    rate = sampling_rate(topic.time)
    seconds = np.ptp(topic.time)
    if seconds < SHORT or len(topic) < STEADY * rate * seconds:
        return len(topic), np.nan, 0, np.nan
    lengths = [length for _, length in gaps(topic.time)]
    return len(topic), rate, len(lengths), max(lengths, default=0.0)


def _hanging(text, indent) -> str:
    return fill(
        text, WIDTH, initial_indent="  ", subsequent_indent=" " * indent, break_long_words=False
    )
