"""Inspection of a log: its content, and the missing columns of each step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from textwrap import fill, wrap
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

NEEDS = {
    "coefficients": ("airspeed", "density", *SPECIFIC_FORCE, *RATES, "thrust_x or propeller_speed"),
    "reconstruction": (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, "airspeed"),
    "regressors": (
        *("airspeed", *RATES, "alpha or reconstruction", "beta or reconstruction", "throttle"),
        *("elevator or elevon_left", "aileron or elevon_right", "rudder"),
    ),
    "replay": (*EULER, "v_north or u", "v_east or v", "v_down or w"),
}
"""Columns that each step reads; any of those joined by "or" will do, or a step that gives them."""
ADVICE = {
    "servos": "angles of the surfaces: a servo file gives them (--servo-template FILE writes one "
    "to fill in)",
    "thrust_x or propeller_speed": "propeller_speed: log RPM or ESC telemetry, add thrust "
    "columns, or take no thrust",
    "airspeed": "airspeed: a pitot tube, calibrated and enabled; without one identify takes it "
    "from turns",
    "alpha or reconstruction": "alpha, beta: vanes, or what the reconstruction needs",
}
STEADY, SHORT = (
    0.5,
    1.0,
)  # with fewer messages than this share of rate times duration, or seconds: no rate
MOST_FLIGHTS = 6  # more flights are summed up in one line
WIDTH = 110


@dataclass(frozen=True)
class TopicSummary:
    """One topic: number of messages, rate [Hz] (NaN for events), number of gaps, longest gap [s]."""

    name: str
    messages: int
    rate: float
    gaps: int
    longest_gap: float


@dataclass(frozen=True)
class ColumnSummary:
    """One column of the flight table: its source, the rate of the source [Hz], whether it is constant."""

    name: str
    source: str
    rate: float
    constant: bool


@dataclass(frozen=True)
class FlightSummary:
    """One flight: begin and end [s], mean airspeed [m/s]."""

    begin: float
    end: float
    airspeed: float


@dataclass(frozen=True, kw_only=True)
class LogSummary:
    """Content of a log, and the missing columns of each step.

    Attributes
    ----------
    path, format, firmware, vehicle : str
        The file; ``vehicle`` is None where the log does not say.
    duration : float
        From the first to the last row of the table [s].
    topics : tuple of TopicSummary
        Every message type with a time.
    columns : tuple of ColumnSummary
        Columns of the flight table.
    missing : dict of str to tuple of str
        By step (coefficients, reconstruction, regressors, replay): columns that it lacks.
    flights : tuple of FlightSummary
        Flights in the air.
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
    topics: tuple[TopicSummary, ...] = ()
    columns: tuple[ColumnSummary, ...]
    missing: dict[str, tuple[str, ...]]
    flights: tuple[FlightSummary, ...]
    no_flight: str = ""
    remarks: tuple[str, ...]

    def to_dict(self) -> dict:
        """Return everything as lists, dicts, texts and numbers, NaN as None, ready for JSON."""
        return plain(asdict(self))

    def __str__(self) -> str:
        lines = [
            f"{self.path}: {self.format}, {self.firmware}, {self.vehicle or 'vehicle unknown'}, "
            f"{self.duration:.1f} s",
            *(
                "",
                *self._flight_lines(),
                "",
                f"  {'columns':<22}{'rate':>9}  from",
                *self._column_lines(),
                "",
            ),
        ]
        for step, names in self.missing.items():
            lines.append(
                _hanging(
                    f"{step:<18}{'lacks ' * bool(names)}{', '.join(names) or 'nothing missing'}", 20
                )
            )
        lacking = {name for names in self.missing.values() for name in names}
        surfaces = {"servos"} if any(name.startswith(SURFACES) for name in lacking) else set()
        lines += [
            f"  {'':<18}- {words}" for name, words in ADVICE.items() if name in lacking | surfaces
        ]
        lines += (
            ["", *(_hanging(f"! {remark}", 4) for remark in self.remarks)] if self.remarks else []
        )
        if self.topics:
            often = [
                f"{t.rate:.3g} Hz" if np.isfinite(t.rate) else f"{t.messages} times"
                for t in self.topics
            ]
            gaps = [f" ({t.gaps} gaps)" * (t.gaps > 0) for t in self.topics]
            words = [
                f"{t.name} {n}{gap}" for t, n, gap in zip(self.topics, often, gaps, strict=True)
            ]
            lines += ["", _hanging(f"topics: {', '.join(words)}", 4)]
        return "\n".join(lines)

    def _flight_lines(self):
        if not self.flights:
            yield f"  no flight: {self.no_flight}"
        elif len(self.flights) > MOST_FLIGHTS:
            seconds = [each.end - each.begin for each in self.flights]
            speeds = [each.airspeed for each in self.flights if np.isfinite(each.airspeed)]
            speed = f" at {min(speeds):.1f} to {max(speeds):.1f} m/s" if speeds else ""
            yield f"  {len(self.flights)} flights of {min(seconds):.1f} to {max(seconds):.1f} s{speed}"
            return
        for each in self.flights:
            speed = f" at {each.airspeed:.1f} m/s" if np.isfinite(each.airspeed) else ""
            yield f"  flight from {each.begin:.1f} s to {each.end:.1f} s{speed}"

    def _column_lines(self):
        for (source, rate, constant), columns in groupby(
            self.columns, key=lambda c: (c.source, c.rate, c.constant)
        ):
            *above, names = wrap(
                " ".join(column.name for column in columns), WIDTH - 40, break_long_words=False
            )
            yield from (f"  {line}" for line in above)
            yield f"  {names:<21} {rate:>6.3g} Hz  {source}{' (never changes)' * constant}"


def inspect_log(
    path: PathLike,
    *,
    servos: PathLike | Mapping[str, Any] | None = None,
    rename: Mapping[str, str] | None = None,
) -> LogSummary:
    r"""Return format, vehicle, topics, columns and their sources, flights, and what is missing in a log.

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
    log, found = (
        flown.log,
        {name: each for name, each in longest.table.items() if name in flown.origin},
    )
    columns = tuple(
        ColumnSummary(name, *flown.origin[name], _constant(each)) for name, each in found.items()
    )
    tables = [part.table.iloc[rows] for part in flown.parts for rows in part.segments]
    return LogSummary(
        path=str(path),
        format=log.kind,
        firmware=log.firmware,
        vehicle=log.vehicle,
        duration=float(sum(np.ptp(part.table["time"]) for part in flown.parts if len(part.table))),
        topics=tuple(_topic(name, topic) for name, topic in longest.topics.items()),
        columns=columns,
        missing=missing_for(columns),
        flights=tuple(map(_flight, tables)),
        no_flight="" if tables else no_flight_because(longest.table, log, flown.speed),
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


def missing_for(columns: Iterable[ColumnSummary]) -> dict[str, tuple[str, ...]]:
    """Return by step the columns that are missing, or a sensor's that never change."""
    found = {column.name for column in columns if not (column.constant and column.name in SENSORS)}
    missing: dict[str, tuple[str, ...]] = {}
    for step, needs in NEEDS.items():
        possible = {before for before, lacking in missing.items() if not lacking}
        missing[step] = tuple(
            need for need in needs if not set(need.split(" or ")) & (found | possible)
        )
    return missing


def _of_table(path, table) -> LogSummary:
    steps = table.groupby("flight", sort=False)["time"].diff().dropna()
    rate = 1 / float(steps.median()) if len(steps) else np.nan
    unknown = table.attrs["unknown_columns"]
    columns = tuple(
        ColumnSummary(str(name), "column", rate * each.notna().mean(), _constant(each))
        for name, each in table.items()
        if name not in ("time", "flight", *unknown)
    )
    tables = [table.iloc[rows] for rows in flight_rows(table["flight"]).values()]
    flights = tuple(map(_flight, tables))
    return LogSummary(
        path=str(path),
        format="table",
        firmware=path.suffix.lstrip("."),
        duration=sum(each.end - each.begin for each in flights),
        columns=columns,
        missing=missing_for(columns),
        flights=flights,
        remarks=(
            *_unknown(unknown, table),
            *grouped_messages(find_faults(table)),
            *_contradictions(tables),
        ),
    )


def _unknown(names, table) -> list[str]:
    words = unknown_columns_message(names, table.columns)
    return [f"columns of unknown names: {words}"] if words else []


def _flight(table) -> FlightSummary:
    time = table["time"]
    airspeed = float(table["airspeed"].mean()) if "airspeed" in table else np.nan
    return FlightSummary(float(time.iloc[0]), float(time.iloc[-1]), airspeed)


def _contradictions(tables) -> tuple[str, ...]:
    """Return what contradicts physics in the flights of a log; nothing if their clocks are too irregular to filter."""
    if not tables:
        return ()
    numbered = [table.assign(flight=number) for number, table in enumerate(tables, start=1)]
    try:
        return tuple(map(str, find_contradictions(pd.concat(numbered, ignore_index=True))))
    except ValueError:
        return ()


def _topic(name, topic: Topic) -> TopicSummary:
    found, rate = gaps(topic.time), sampling_rate(topic.time)
    seconds = np.ptp(topic.time)
    if seconds < SHORT or len(topic) < STEADY * rate * seconds:
        return TopicSummary(name, len(topic), np.nan, 0, np.nan)
    return TopicSummary(
        name, len(topic), rate, len(found), max((length for _, length in found), default=0.0)
    )


def _constant(column) -> bool:
    return bool(column.nunique() < 2)


def _hanging(words, indent) -> str:
    return fill(
        words, WIDTH, initial_indent="  ", subsequent_indent=" " * indent, break_long_words=False
    )
