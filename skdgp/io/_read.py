"""read_flight and inspect_log: a file to a flight table, and the contents of the file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from skdgp._compute.files import plain
from skdgp._compute.messages import report, warn
from skdgp._flight.channels import CHANNELS
from skdgp._flight.channels import FULL_THROW as IN_FULL_THROWS
from skdgp._flight.clock import LONGEST_STEP, flight_codes, runs_between, unrounded
from skdgp._flight.copies import without_copies
from skdgp._flight.faults import (
    FlightDataWarning,
    find_faults,
    slow_log,
    without_faults,
    without_ground,
)
from skdgp._flight.findings import Code, Finding, texts_of
from skdgp._flight.physics import confirmed_channels, find_contradictions
from skdgp._flight.tables import (
    FlightTable,
    check_table,
    suggestions,
    unknown_columns,
    unknown_columns_message,
)
from skdgp._flight.units import check_units
from skdgp.dynamics import Aircraft, numbers_in_flight
from skdgp.io._autopilot import AUTOPILOTS, flight_table, is_log, on_one_clock, read_log
from skdgp.io._log import FULL_THROW, Topic, full_throws, reversed_of
from skdgp.io._tables import (
    FlightReadError,
    base_name,
    is_number,
    read_csv,
    read_parquet,
    reading,
    to_floats,
)

UNKNOWN = "unknown_columns"
# Readers of tables by suffix, functions of path and new names; another format is one more entry
TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    ".csv": read_csv,
    ".parquet": read_parquet,
    ".pq": read_parquet,
}
# columns in an error
MOST_SHOWN = 12
# of the printed summary of a log [characters]
WIDTH = 110
PathLike: TypeAlias = "str | os.PathLike[str]"


def read_flight(
    path: PathLike,
    *,
    servos: PathLike | Mapping[str, Any] | None = None,
    airborne: bool | float = True,
    rename: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    r"""Read one log into a flight table: SI, radians, one clock, the names of the vocabulary.

    A CSV header may state units, ``alpha [deg]``: these are converted. Columns that the vocabulary
    does not know are kept, ``table.attrs["unknown_columns"]``.

    Messages of an autopilot are brought to one clock (low-passed where faster, interpolated where
    slower, NaN in gaps) and cut into flights; ``table.attrs["sources"]`` names the message of each
    column. Warns with FlightDataWarning if a log is damaged, has gaps or wrong times, its clock was
    set back, channels were never valid, or columns are left out.

    Parameters
    ----------
    path : str or path
        ``.csv``, ``.parquet`` or ``.pq`` (by the extra ``parquet``), ``.ulg`` (PX4) and ``.tlog``
        (MAVLink telemetry), both by the extra ``logs``, ``.bin`` (ArduPilot).
    servos : path or mapping, optional
        Calibration of servos, channel to surface and angle, in TOML: see docs/logs.md. This and the
        two following: autopilots only. Without it the table has no surfaces. ``"full throw"``:
        parts of their full throw, -1 to 1, of the servos that the parameters name.
    airborne : bool or float, default=True
        Keep only the flight: an airspeed above 0.7 times the slowest set on the autopilot (8
        m/s if none is) and not landed by the autopilot's own account, or above this number [m/s],
        whatever it reports; of tables, where the airspeed carries it. False keeps all.
    rename : mapping of str to str, optional
        Names of a flight table for columns of a table, ``{"de": "elevator"}``; a unit in the header
        stays with its column.

    Returns
    -------
    DataFrame
        Columns ``time``, ``flight``, then the others in the file's order; numbers as float64. A file
        without a column ``flight`` names its flight; further ones in a log of an autopilot are
        ``name#2``, ``name#3``.

    Raises
    ------
    FlightReadError
        If the file is damaged or no table or log; has no ``time``, or one that does not increase
        within a flight, text among numbers, or numbers that are not in SI and radians; a log holds
        no flight; or an option makes no sense.
    FileNotFoundError
        If there is no such file.
    ImportError
        If the extra for the file's format is not installed.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "sortie_7.csv"
    >>> _ = path.write_text("time [ms],alpha [deg],q\n0,90,0.1\n20,45,0.2\n")
    >>> read_flight(path).round(3)
       time    flight  alpha    q
    0  0.00  sortie_7  1.571  0.1
    1  0.02  sortie_7  0.785  0.2
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"Got {path}, but there is no such file.")
    with reading(path):
        if is_log(path):
            if rename:
                raise FlightReadError(
                    f"Got rename={dict(rename)} for a log of an autopilot, but expected it only "
                    "with tables: its columns follow from its messages."
                )
            return _from_autopilot(path, servos, airborne)
        if servos is not None or not isinstance(airborne, bool):
            raise FlightReadError(
                f"Got servos={servos}, airborne={airborne} for a table, but expected a servo file and a speed "
                "only with logs of autopilots."
            )
        table = _unrounded(_from_table(path, dict(rename or {})))
        return without_ground(table, path.name) if airborne else table


def _from_autopilot(path: Path, servos: Any, airborne: Any) -> pd.DataFrame:
    flown = on_one_clock(read_log(path), servos=servos, airborne=airborne)
    table = flight_table(flown, path.stem)
    if reversed_of(servos) is not None:
        table[IN_FULL_THROWS] = 1.0
    table = _as_flight(table)
    table.attrs["sources"] = {
        column: words for column, (words, _) in flown.origin.items() if column in table
    }
    if flown.remarks:
        warn(f"{path.name}: {'; '.join(flown.remarks)}.", FlightDataWarning)
    return table


def _from_table(path: Path, rename: dict[str, str]) -> pd.DataFrame:
    if path.is_dir():
        raise FlightReadError(
            "Got a folder, but expected a file: give that of one flight, of PX4 the .ulg itself."
        )
    kind = path.suffix.lower()
    if kind not in TABLES:
        raise FlightReadError(
            f"Got the suffix {path.suffix!r}, but expected one of {sorted(TABLES | AUTOPILOTS)}: "
            "convert it, in MATLAB by writetable, or rename it."
        )
    table = _renamed(TABLES[kind](path, rename), rename)
    if "flight" not in table:
        table["flight"] = path.stem
    return _as_flight(table)


def _unrounded(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the times that were rounded on their uniform clock, which a note says."""
    clock = FlightTable.of(table).clock
    times = clock.time.copy()
    for flight, rows in clock.rows.items():
        time = clock.time[rows]
        gap = LONGEST_STEP * np.median(np.diff(time, prepend=-np.inf))
        resolutions = []
        for run in runs_between(time, gap):
            times[rows[run]], resolution = unrounded(time[run])
            resolutions.append(resolution)
        if any(resolutions):
            report(Finding(Code.TIMES_RESTORED, flight=flight, resolution=max(resolutions)))
    restored = table.assign(time=times)
    restored.attrs = table.attrs
    return restored


def _renamed(table: pd.DataFrame, rename: Mapping[str, str]) -> pd.DataFrame:
    """Return the table with new names; raise FlightReadError if it has a column by neither name."""
    table = table.rename(columns=lambda name: str(name).strip())
    names = list(table.columns)
    for old, new in rename.items():
        if base_name(new) not in CHANNELS:
            raise FlightReadError(
                f"Got rename of {old!r} to {new!r}, but expected a name of a flight table "
                "(docs/notation.md) without a unit: units stand in the file's header, such as 'de [deg]'."
            )
        if old not in names and new not in names:
            raise FlightReadError(
                f"Got rename of {old!r}, but the file has no such column: expected one such as {names[:MOST_SHOWN]}."
            )
    return table.rename(columns=rename)


def _as_flight(table: pd.DataFrame) -> pd.DataFrame:
    """Return a raw table in the order and types of a flight table."""
    table = table.reset_index(drop=True)
    unknown = unknown_columns(table)
    if suggestions(unknown, table.columns):
        unknown_names = unknown_columns_message(unknown, table.columns)
        warn(f"Unknown columns are kept as they are: {unknown_names}.")
    if "time" not in table:
        raise FlightReadError(
            f"Got no column 'time' [s] among {list(table.columns)[:MOST_SHOWN]}, but expected one: rename "
            "a column, as by --rename t=time, or compute it; its unit stands in the header "
            "('t [ms]')."
        )
    try:
        check_table(table)
        table = table.assign(**_as_numbers(table), flight=_flight_names(table["flight"]))
        is_missing = table["time"].isna().to_numpy()
        if is_missing.any():
            row = int(np.argmax(is_missing))
            raise FlightReadError(f"Got no time at row {row}, but expected it in every row [s].")
        check_units(FlightTable.of(table))
    except (ValueError, TypeError) as error:
        raise FlightReadError(*error.args) from error
    channels = [name for name in table.columns if name not in ("time", "flight")]
    table = table[["time", "flight", *channels]]
    table.attrs = {UNKNOWN: unknown}
    return table


def _as_numbers(table: pd.DataFrame) -> dict[str, np.ndarray]:
    """Return the columns of the vocabulary as floats; infinities as NaN, with a warning."""
    numbers = {}
    infinite = []
    for name in filter(is_number, table.columns):
        column = table[name]
        if name == "time":
            column = _as_seconds(column)
        values = to_floats(column)
        is_infinite = np.isinf(values)
        if is_infinite.any():
            infinite.append(name)
            values = np.where(is_infinite, np.nan, values)
        numbers[name] = values
    if infinite:
        warn(f"Infinite values in {infinite} are read as missing (NaN).")
    return numbers


def _as_seconds(time: pd.Series) -> pd.Series:
    """Return durations as seconds, dates (ISO 8601) from the first row on, numbers as they are."""
    if pd.api.types.is_object_dtype(time) or pd.api.types.is_string_dtype(time):
        # ISO 8601 has either decimal mark
        time = time.map(lambda cell: cell.replace(",", ".") if isinstance(cell, str) else cell)
        try:
            time = pd.to_datetime(time, format="ISO8601", utc=True)
        except (ValueError, TypeError):
            return time
    if pd.api.types.is_datetime64_any_dtype(time):
        time = time - time.iloc[0]
    return time.dt.total_seconds() if pd.api.types.is_timedelta64_dtype(time) else time


def _flight_names(flight: pd.Series) -> np.ndarray:
    """Return the name of each row's flight as str; whole numbers without a point."""
    codes, names = flight_codes(flight)
    texts = []
    for name in names:
        is_whole = isinstance(name, float) and name.is_integer()
        texts.append(str(int(name) if is_whole else name).strip())
    return np.array(texts, dtype=object)[codes]


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
        Columns of the flight table: ``source``, its ``rate`` [Hz], and ``physics``, "confirmed" where a relation
        of equal changes confirms the channel.
    flights : DataFrame
        Flights in the air: ``begin`` and ``end`` [s], median ``airspeed`` [m/s].
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
        content = vars(self).copy()
        for name in ("topics", "columns", "flights"):
            content[name] = content[name].reset_index(names="name").to_dict("records")
        return plain(content)

    def __str__(self) -> str:
        vehicle = self.vehicle or "vehicle unknown"
        parts = [f"{self.path}: {self.format}, {self.firmware}, {vehicle}"]
        for table in (self.topics, self.columns, self.flights):
            if len(table):
                parts.append(table.round(2).to_string())
        for remark in self.remarks:
            parts.append(fill(f"! {remark}", WIDTH, subsequent_indent="    "))
        return "\n\n".join(parts)


def inspect_log(
    path: PathLike,
    *,
    servos: PathLike | Mapping[str, Any] | None = None,
    airborne: bool | float = True,
    rename: Mapping[str, str] | None = None,
    aircraft: Aircraft | None = None,
) -> LogSummary:
    r"""Return format, vehicle, topics, columns and their sources, flights, and faults of a log.

    ``print`` shows the summary.

    Parameters
    ----------
    path, servos, airborne, rename : as of :func:`read_flight`
        A table takes ``rename`` alone. Without servos, surfaces are in parts of their full throw
        where the parameters of a log name them.
    aircraft : Aircraft, optional
        Its sizes are judged by the lift that carried it.

    Returns
    -------
    LogSummary
        Of a log without a flight too.

    Raises
    ------
    FlightReadError
        If the file cannot be read.
    FileNotFoundError
        If there is no such file.

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
        table = read_flight(path, servos=servos, airborne=airborne, rename=rename)
        return _of_table(path, table, aircraft)
    lacking = []
    with reading(path):
        log = read_log(path)
        if servos is None:
            try:
                full_throws(log)
                servos = FULL_THROW
            except FlightReadError as error:
                lacking = [str(error)]
        flown = on_one_clock(log, servos=servos, airborne=airborne)
    try:
        table = flight_table(flown, path.stem)
        faults = _faults(table, aircraft)
    except FlightReadError as error:
        table = flown.table[:0].assign(flight="")
        faults = [str(error)]
    columns = pd.DataFrame.from_dict(flown.origin, orient="index", columns=["source", "rate"])
    return LogSummary(
        path=str(path),
        format=flown.log.kind,
        firmware=flown.log.firmware,
        vehicle=flown.log.vehicle,
        topics=_topics(flown.log.topics),
        columns=_with_physics(columns, table),
        flights=_flights(table),
        remarks=(*flown.remarks, *lacking, *faults),
    )


def _topics(topics: Mapping[str, Topic]) -> pd.DataFrame:
    """Return the number of messages of each topic, and their mean rate [Hz]."""
    rows = {}
    for name, topic in topics.items():
        seconds = max(np.ptp(topic.time), 1e-9)
        rows[name] = (len(topic), (len(topic) - 1) / seconds)
    return pd.DataFrame.from_dict(rows, orient="index", columns=["messages", "rate"])


def _of_table(path: Path, table: pd.DataFrame, aircraft: Aircraft | None) -> LogSummary:
    """Return the summary of a file that is no log of an autopilot."""
    step = table.groupby("flight", sort=False)["time"].diff().median()
    unknown = table.attrs[UNKNOWN]
    channels = table.drop(columns=["time", "flight", *unknown])
    columns = pd.DataFrame({"source": "column", "rate": channels.notna().mean() / step})
    remarks = _faults(table, aircraft)
    unknown_names = unknown_columns_message(unknown, table.columns)
    if unknown_names:
        remarks.insert(0, f"columns of unknown names: {unknown_names}")
    return LogSummary(
        path=str(path),
        format="table",
        firmware=path.suffix.lstrip("."),
        topics=pd.DataFrame(),
        columns=_with_physics(columns, table),
        flights=_flights(table),
        remarks=tuple(remarks),
    )


def _with_physics(columns: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of a flight table with what physics confirms of them, nothing by irregular clocks."""
    confirmed: set[str] = set()
    with suppress(ValueError):
        confirmed = confirmed_channels(FlightTable.of(table))
    return columns.assign(physics=np.where(columns.index.isin(confirmed), "confirmed", ""))


def _flights(table: pd.DataFrame) -> pd.DataFrame:
    """Return begin and end [s] of each flight, and its median airspeed."""
    if "airspeed" not in table:
        table = table.assign(airspeed=np.nan)
    flights = table.groupby("flight", sort=False)
    return flights.agg(
        begin=("time", "first"), end=("time", "last"), airspeed=("airspeed", "median")
    )


def _faults(table: pd.DataFrame, aircraft: Aircraft | None) -> list[str]:
    """Return faults of flights, and contradictions of what was measured and of sizes of the aircraft.

    There is no contradiction if the clocks are too irregular to filter.
    """
    flights = FlightTable.of(table)
    found = find_faults(flights)
    faults = list(texts_of([*slow_log(flights), *(fault.finding for fault in found)]))
    measured = FlightTable.of(without_faults(table, found))
    try:
        _, _, copies = without_copies(measured.flights, {})
        contradictions = [*copies, *find_contradictions(measured)]
        question = None
        if aircraft is not None:
            question = aircraft.question_of_sizes(*numbers_in_flight(measured, aircraft))
    except ValueError:
        return faults
    faults += [contradiction.text for contradiction in contradictions]
    return faults if question is None else [*faults, question.text]
