"""What `identify` assumes where neither flights nor caller say: units of surfaces, the thrust, the aircraft."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._flight.channels import ALL_SURFACES, COEFFICIENTS, HAT, THRUST_FORCES
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.physics import reversed_surfaces
from skdgp.dynamics import (
    MOMENTS,
    QUANTITIES,
    Aircraft,
    ScaleFactor,
    dynamic_pressure,
    propeller_speed_of,
    propulsive_loads,
)
from skdgp.identification._flights import Flights, items_of
from skdgp.io import FULL_THROW, is_log, names_servos, reversed_of

THRUST_IN_COEFFICIENTS = (
    "Nothing gives the thrust, so it is part of the coefficients, with throttle and airspeed as "
    "regressors: CX is "
    "thrust less drag, which the model does not tell apart."
)
FULL_THROWS = "Surfaces are in parts of their full throw, as no servo file gives angles: effects are of a full throw."


def servos_for(servos: Any, *flights: Any) -> Any:
    """Return ``servos``, or without them "full throw" for logs of autopilots whose parameters name servos.

    Raises ValueError of logs without servos beside tables, whose surfaces are in radians.
    """
    items = [item for part in flights if part is not None for item in items_of(part)]
    logs = [is_log(item) for item in items]
    if servos is not None or not any(logs):
        return servos
    if not all(logs):
        raise ValueError(
            "Got logs of autopilots without servos beside tables, but expected surfaces in one "
            "unit: give servos, a "
            "file of the angles of the surfaces."
        )
    return FULL_THROW if any(map(names_servos, items)) else None


def with_signs_of_flights(servos: Any, *parts: Flights) -> tuple[Any, ...]:
    """Return servos in parts of the full throw, and flights, with signs of surfaces that the first flights show."""
    learned = pd.concat(parts[0].values(), ignore_index=True)
    names = reversed_surfaces(learned) if reversed_of(servos) == () else []
    if not names:
        return servos, *parts
    servos = f"{FULL_THROW}, reversed {' '.join(names)}"
    warn(
        f"The flights show that {' and '.join(names)} move the other way than the autopilot's "
        f"parameters say, so their signs are turned: servos = {servos!r}.",
        FlightDataWarning,
        stacklevel=3,
    )
    turned = (
        {
            key: table.assign(**{name: -table[name] for name in names if name in table})
            for key, table in part.items()
        }
        for part in parts
    )
    return servos, *turned


def with_thrust_errors(
    aircraft: Aircraft, table: pd.DataFrame, regressors: pd.DataFrame, thrust: str
) -> Aircraft:
    """Return the aircraft, with the errors of coefficients by the error of its propeller's thrust.

    If the thrust is T (1 + e), coefficients lack e T / (qbar S) of it, and a model learns that as
    the nearest linear function of its regressors.
    """
    propeller = aircraft.propeller
    if propeller is None or not propeller.load_std:
        return aircraft
    scale = dynamic_pressure(table["airspeed"], table["density"])[:, None] * aircraft.wing_area
    force, moment = propulsive_loads(table, aircraft, thrust)
    missing = -np.hstack([force, moment / aircraft.moment_lengths]) / scale
    X = np.column_stack([np.ones(len(regressors)), regressors])
    sampled = np.isfinite(missing).all(axis=1) & np.isfinite(X).all(axis=1)
    X[:, 1:] -= X[sampled, 1:].mean(axis=0)  # the intercept is the mean
    slopes = np.linalg.lstsq(X[sampled], missing[sampled], rcond=None)[0]
    names = ["", *(f"_{str(name).removesuffix(HAT)}" for name in regressors)]
    effects = [coefficient + name for coefficient in COEFFICIENTS for name in names]
    added = dict(zip(effects, slopes.T.ravel().tolist(), strict=True))
    factor = ScaleFactor(propeller.load_std, source="size of the propeller", added=added)
    return replace(aircraft, deviations={**(aircraft.deviations or {}), "thrust": factor})


def lacks_thrust(thrust: str | None, tables: Iterable[pd.DataFrame], aircraft: Aircraft) -> bool:
    """Return whether nothing gives the thrust of any flight, but a throttle explains it."""
    return thrust == "auto" and all(
        "throttle" in table
        and not {*THRUST_FORCES} & {*table}
        and propeller_speed_of(aircraft.propeller, table) is None
        for table in tables
    )


def control_units(servos: Any) -> dict[str, str]:
    """Return the units of controls that are not the usual ones."""
    return dict.fromkeys(ALL_SURFACES, FULL_THROW) if reversed_of(servos) is not None else {}


def assumptions(aircraft: Aircraft, *, servos: Any, thrust_unknown: bool) -> list[str]:
    """Return the assumptions, in a line each."""
    sizes = _uncertain_sizes(aircraft)
    sources = {factor.source for factor in (aircraft.deviations or {}).values()} - {"given"}
    rules = sorted({source.rpartition(", ")[2] for source in sources})
    lines = {
        f"Of the aircraft: {', '.join(sizes)}; their part in errors of derivatives is std_aircraft.": sizes,
        f"Estimated by: {'; '.join(rules)}.": rules,
        FULL_THROWS: reversed_of(servos) is not None,
        THRUST_IN_COEFFICIENTS: thrust_unknown,
    }
    return [line for line, applies in lines.items() if applies]


def _uncertain_sizes(aircraft: Aircraft) -> list[str]:
    """Return the sizes of an aircraft that are uncertain, by errors of all causes together."""
    values = {
        **{name: getattr(aircraft, name) for name in QUANTITIES},
        **dict(zip(MOMENTS, aircraft.inertia.diagonal(), strict=True)),
    }
    factors = (aircraft.deviations or {}).values()
    stds = {
        name: float(np.linalg.norm([f.std * f.powers.get(name, 0.0) for f in factors]))
        for name in values
    }
    return [
        f"{name.replace('_', ' ')} {values[name]:.3g} {QUANTITIES.get(name, 'kg m^2')} ± "
        f"{100 * std:.2g} %"
        for name, std in stds.items()
        if std
    ]
