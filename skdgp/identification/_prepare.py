"""Flights that are ready to learn from: read, checked, complete, split, and what was assumed of them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from skdgp._compute.messages import warn
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, check_aircraft
from skdgp.identification import _assumed, _flights
from skdgp.identification._flights import Flights
from skdgp.io import reversed_of


@dataclass(frozen=True, kw_only=True)
class PreparedFlights:
    """Flights of an identification.

    Attributes
    ----------
    train, test : dict of str to DataFrame
        Usable rows of the flights to learn from, and to be tested on.
    held_out : str or None
        What is tested on because no test flight was named.
    aircraft : Aircraft
        With the deviations that the flights leave it.
    servos : object
        What gave the surfaces, with the signs that the flights show.
    loads : dict
        ``thrust`` and ``external_forces`` of the inverse dynamics.
    lacks_thrust : bool
        Whether the thrust is part of the coefficients, as nothing gives it.
    """

    train: Flights
    test: Flights
    held_out: str | None
    aircraft: Aircraft
    servos: Any
    loads: dict[str, Any]
    lacks_thrust: bool

    @property
    def table(self) -> pd.DataFrame:
        """The training flights in one table."""
        return pd.concat(self.train.values(), ignore_index=True)

    def coefficients(self) -> pd.DataFrame:
        """Return the measured coefficients of the training flights, (n, 6); ValueError if hardly any is known."""
        table = self.table
        Y = aerodynamic_coefficients(table, self.aircraft, **self.loads)
        _flights.check_known(Y, table)
        return Y

    def assumptions(self, aircraft: Aircraft) -> list[str]:
        """Return what was assumed of an aircraft and its flights, in a line each."""
        return _assumed.assumptions(aircraft, servos=self.servos, thrust_unknown=self.lacks_thrust)


def prepare(
    flights: Any,
    test: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    regressors: str | Sequence[str],
    thrust: str | None,
    external_forces: Sequence[str],
    reading: Mapping[str, Any],
) -> PreparedFlights:
    """Read and check flights; the parameters and errors are those of `identify`.

    Warns of faults, of contradictions, and of what was assumed.
    """
    aircraft = as_aircraft(aircraft)
    servos = _assumed.servos_for(reading.get("servos"), flights, test)
    aircraft = _assumed.with_throw_errors(aircraft, servos)
    options = {**reading, "servos": servos, "needed": _flights.MEASURED}
    train = _flights.named_flights(flights, **options)
    _flights.check_controls(train, regressors)
    aircraft = _assumed.with_airspeed_errors(aircraft, train.values())
    named = {} if test is None else _flights.named_flights(test, default="test flight", **options)
    train, named, held_out = _flights.train_and_test(train, named)
    servos, train, named = _assumed.with_signs_of_flights(servos, train, named)
    columns = _flights.regressor_columns(train.values(), regressors)
    train, named = (_flights.usable_flights(part, regressors, columns) for part in (train, named))
    _flights.warn_of_short_flights(train, regressors)
    lacks_thrust = _assumed.lacks_thrust(thrust, train.values(), aircraft)
    if lacks_thrust:
        warn(_assumed.THRUST_IN_COEFFICIENTS, stacklevel=3)
        thrust = None
    if thrust is None:
        _flights.warn_of_engine(train, regressors)
    if reversed_of(servos) is not None:
        warn(_assumed.FULL_THROWS, stacklevel=3)
    return PreparedFlights(
        train=train,
        test=named,
        held_out=held_out,
        aircraft=aircraft,
        servos=servos,
        loads={"thrust": thrust, "external_forces": list(external_forces)},
        lacks_thrust=lacks_thrust,
    )


def as_aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, read from a file where a path is given."""
    if isinstance(aircraft, str | os.PathLike):
        return Aircraft.from_file(aircraft)
    return check_aircraft(aircraft)
