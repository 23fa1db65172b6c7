"""Flight mechanics of an identified model: trim, derivatives, modes, and simulations of its test flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._flight.findings import Code, Finding
from skdgp.dynamics import (
    ATTITUDE,
    VELOCITY,
    Aerodynamics,
    Air,
    Aircraft,
    Trim,
    air_velocity,
    as_aerodynamics,
    euler_to_quaternion,
    linearize,
    stability_derivatives,
    trim,
)
from skdgp.identification._free_flight import simulation_errors


@dataclass(frozen=True, kw_only=True)
class FlightMechanics:
    """Trim, derivatives and modes in the middle of the training range.

    Parameters
    ----------
    trim : Trim, optional
        None where there is no steady flight.
    derivatives : DataFrame
        Of `skdgp.dynamics.stability_derivatives`.
    modes : DataFrame, optional
        Of `skdgp.dynamics.LinearModel.modes`.
    simulation : DataFrame, optional
        By state ``spread``, ``limit``, ``error`` at the end, how long it ``lasts`` and its
        ``horizon`` [s], and whether the wind with its gusts was known (``wind_known``).
    notes : tuple of Finding
        Why trim, modes, derivatives or the simulation are missing.
    """

    trim: Trim | None = None
    derivatives: pd.DataFrame = field(default_factory=pd.DataFrame)
    modes: pd.DataFrame | None = None
    simulation: pd.DataFrame | None = None
    notes: tuple[Finding, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, SI units and radians."""
        plain: dict[str, Any] = {"notes": [note.text for note in self.notes]}
        if self.trim is not None:
            plain["trim"] = dict(vars(self.trim))
        plain["derivatives"] = self.derivatives.to_dict("index")
        if self.modes is not None:
            plain["modes"] = self.modes.drop(columns="eigenvalue").to_dict("index")
        if self.simulation is not None:
            plain["simulation"] = self.simulation.to_dict("index")
        return plain


def flight_mechanics(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    conditions: Mapping[str, float],
    flights: Sequence[pd.DataFrame],
    options: Mapping[str, Any],
) -> FlightMechanics:
    """Return trim, derivatives and modes at the ``conditions`` of the fit, and a simulation of test flights.

    Without a thrust the flight is a glide. Where there is no trim, derivatives are at the conditions.
    """
    flown = pd.Series(conditions, dtype=float)
    airspeed = float(flown["airspeed"])
    thrust = options["thrust"]
    given: dict[str, Any] = {"thrust": thrust, "air": Air(density=float(flown["density"]))}
    state, controls = _median_state(flown)
    notes = []
    steady: Any = None
    try:
        climb = None if thrust is None else 0.0
        altitude = float(np.nan_to_num(flown.get("altitude", 0.0)))
        steady = trim(pipeline, aircraft, airspeed, altitude=altitude, climb=climb, **given)
        state, controls = steady.state, steady.controls
    except ValueError:
        notes.append(Finding(Code.NO_TRIM, numbers={"airspeed": airspeed}))
    point = aircraft, state, controls
    computed: dict[str, Any] = {}
    try:
        derivatives = stability_derivatives(pipeline, *point, **given)
        modes = None if steady is None else _modes(pipeline, point, given)
        computed = {"derivatives": derivatives, "modes": modes}
    except ValueError as error:
        notes.append(Finding(Code.NO_DERIVATIVES, numbers={"error": str(error)}))
    try:
        computed["simulation"] = simulation_errors(pipeline, aircraft, flights, options)
    except ValueError as error:
        notes.append(Finding(Code.NOT_SIMULATED, numbers={"error": str(error)}))
    return FlightMechanics(trim=steady, notes=tuple(notes), **computed)


def _median_state(flown: pd.Series) -> tuple[np.ndarray, dict[str, float]]:
    """Return the median state with level wings, and the median inputs."""
    alpha = float(flown.get("alpha", 0.0))
    state = np.zeros(13)
    state[VELOCITY] = air_velocity(flown["airspeed"], alpha, 0.0)
    state[ATTITUDE] = euler_to_quaternion(0.0, 0.0, 0.0)
    return state, {str(name): float(value) for name, value in flown.items()}


# Aircraft, state and controls
Point: TypeAlias = tuple[Aircraft, np.ndarray, Mapping[str, float]]


def _modes(
    pipeline: Pipeline | Aerodynamics, trimmed: Point, conditions: Mapping[str, Any]
) -> pd.DataFrame:
    """Return the modes about a trim."""
    # 200 functions give the standard deviations with a relative error of 1 / sqrt(2 n), 5 %
    n_paths = 200 if as_aerodynamics(pipeline).is_uncertain else 0
    return linearize(pipeline, *trimmed, n_paths=n_paths, **conditions).modes()
