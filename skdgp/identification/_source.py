"""Sources of flights and aircraft, and the flight held out when no test flight is named."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_rows
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Aircraft
from skdgp.io import AUTOPILOTS, FlightReadError, read_flight

MEASURED = ("airspeed", "density", "ax", "ay", "az", "p", "q", "r")
"""What the coefficients follow from."""
HELD_OUT = 0.25
"""Share of a single flight that is held out, at its end."""


@dataclass(frozen=True)
class Source:
    """Flights by name, to learn from and to be tested on, and their aircraft."""

    aircraft: Aircraft
    train: dict[str, pd.DataFrame]
    test: dict[str, pd.DataFrame]
    title: str
    held_out: str | None = None


def file_source(options) -> Source:
    """Read the files that the options name.

    Raises
    ------
    ValueError, OSError
        What the readers raise; or if two files hold a flight of the same name.
    """
    aircraft = read_aircraft(options.aircraft)
    train, test = (read_named(paths, options) for paths in (options.train, options.test))
    check_measured(train | test, [*options.train, *options.test])
    held_out = None
    if not test:
        train, test, held_out = hold_out(train)
    for name in train.keys() & test.keys():
        warnings.warn(
            f"Flight {name!r} is both learned from and tested on: its errors say nothing about other flights.",
            UserWarning,
            stacklevel=2,
        )
    return Source(aircraft, train, test, f"{aircraft.name}: aerodynamic coefficients", held_out)


def example_source() -> Source:
    """Return the example flights."""
    data = load_example_flights()
    return Source(data.aircraft, _by_flight(data.train), _by_flight(data.test), "Example flights: a simulated UAV")


def read_aircraft(path) -> Aircraft:
    """Read an aircraft by the suffix of its file."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"Got {path} as the aircraft, but there is no such file.")
    readers = {".json": Aircraft.from_json, ".toml": Aircraft.from_toml}
    if path.suffix.lower() not in readers:
        raise ValueError(f"Got {path} as the aircraft, but expected a file that ends in .json or .toml.")
    return readers[path.suffix.lower()](path)


def read_named(paths, options) -> dict[str, pd.DataFrame]:
    """Read files into one table for each flight, logs of autopilots as the options say."""
    flights, owner = {}, {}
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    for path in paths:
        of_autopilot = Path(path).suffix.lower() in AUTOPILOTS
        reading = {"servos": options.servos, "airborne": airborne} if of_autopilot else {}
        for name, table in _by_flight(read_flight(path, **reading)).items():
            if name in flights:
                raise FlightReadError(
                    f"Got flight {name!r} in {owner[name]} and in {path}, but expected each once: "
                    f"{_remedy(name, owner[name], path)}."
                )
            flights[name], owner[name] = table, path
    return flights


def _remedy(name, first, second) -> str:
    """Return how two flights get different names: from the file's own, or where that is another, from its column."""
    if Path(first).resolve() == Path(second).resolve():
        return "name the file once"
    columns = [str(path) for path in (second, first) if Path(path).stem != name]
    if columns:
        return f"the name stands in column 'flight' of {columns[0]}; change it there"
    return "rename one of the files, or where a file has a column 'flight', change the name there"


def check_measured(flights, paths) -> None:
    """Raise a ValueError if coefficients cannot follow from a flight: before anything is said of its other faults."""
    logs = [str(path) for path in paths if Path(path).suffix.lower() in AUTOPILOTS]
    for table in flights.values():
        try:
            check_columns(table, MEASURED)
        except ValueError as error:
            if not logs:
                raise
            raise ValueError(
                f"{error} What a log has, and why it lacks them: python -m skdgp inspect {logs[0]}"
            ) from None


def hold_out(flights):
    """Return flights to learn from, those held out, and words for what was held out."""
    last = list(flights)[-1]
    if len(flights) > 1:
        kept = {name: table for name, table in flights.items() if name != last}
        return kept, {last: flights[last]}, f"the last flight, {last}"
    table = flights[last]
    split = round((1 - HELD_OUT) * len(table))
    parts = {"first three quarters": table.iloc[:split], "last quarter": table.iloc[split:]}
    first, rest = (
        {f"{last}, {words}": part.assign(flight=f"{last}, {words}").reset_index(drop=True)}
        for words, part in parts.items()
    )
    return first, rest, f"the last quarter of the only flight, {last}"


def _by_flight(table) -> dict[str, pd.DataFrame]:
    """Return one table for each flight, in their order."""
    if "flight" not in table:
        return {"flight": table}
    rows = flight_rows(table["flight"])
    return {name: table.iloc[here].reset_index(drop=True).assign(flight=name) for name, here in rows.items()}
