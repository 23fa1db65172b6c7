"""What `identify` assumes where neither flights nor caller say: units of surfaces, the thrust, the aircraft."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.channels import ALL_SURFACES
from skdgp.dynamics import Aircraft
from skdgp.dynamics._vehicle.estimate import MOMENTS, QUANTITIES, REMEDIES, relative_errors
from skdgp.identification._flights import is_autopilot_log
from skdgp.io import FULL_THROW
from skdgp.io._inspect import names_servos

THRUST_IN_COEFFICIENTS = (
    "Nothing gives the thrust, so it is part of the coefficients, with throttle and airspeed as regressors: CX is "
    "thrust less drag, which the model does not tell apart."
)
FULL_THROWS = "Surfaces are in parts of their full throw, as no servo file gives angles: effects are of a full throw."
THROWS = 'angle of each surface at full throw (a servo file with elevator = "25 deg"): effects per radian'
THRUST = "thrust on a bench over propeller speed, and a sensor of that speed in flight: drag without thrust"
LISTED = 3
"""Measurements that are named."""


def servos_for(servos: Any, *flights: Any) -> Any:
    """Return ``servos``, or without them "full throw" for logs of autopilots whose parameters name servos.

    Raises ValueError of logs without servos beside tables, whose surfaces are in radians.
    """
    items = [item for part in flights for item in _items(part)]
    logs = [is_autopilot_log(item) for item in items]
    if servos is not None or not any(logs):
        return servos
    if not all(logs):
        raise ValueError(
            "Got logs of autopilots without servos beside tables, but expected surfaces in one unit: give servos, a "
            "file of the angles of the surfaces."
        )
    return FULL_THROW if any(map(names_servos, items)) else None


def _items(flights: Any) -> list:
    if flights is None:
        return []
    if isinstance(flights, Mapping):
        return list(flights.values())
    return list(flights) if isinstance(flights, list | tuple) else [flights]


def lacks_thrust(thrust: str | None, tables: Iterable[pd.DataFrame], aircraft: Aircraft) -> bool:
    """Return whether nothing gives the thrust of any flight, but a throttle explains it."""
    return thrust == "auto" and all(
        "throttle" in table
        and not {"thrust_x", "thrust_y", "thrust_z"} & set(table)
        and not (aircraft.propeller is not None and "propeller_speed" in table)
        for table in tables
    )


def control_units(servos: Any) -> dict[str, str]:
    """Return the units of controls that are not the usual ones."""
    return dict.fromkeys(ALL_SURFACES, FULL_THROW) if servos == FULL_THROW else {}


def assumptions(aircraft: Aircraft, *, servos: Any, thrust_unknown: bool) -> list[str]:
    """Return what was assumed, and which measurements would narrow what follows from it most, in a line each."""
    lines = [_of_sizes(aircraft)] if aircraft.deviations else []
    if aircraft.deviations:
        lines += _of_causes(aircraft)
        lines.append(
            "What their errors make of coefficients and derivatives stands beside the bands of the log; errors over "
            "spread, trim, modes and simulations with this aircraft do not depend on them."
        )
    lines += [FULL_THROWS] if servos == FULL_THROW else []
    lines += [THRUST_IN_COEFFICIENTS] if thrust_unknown else []
    remedies = _remedies(aircraft) + [THROWS] * (servos == FULL_THROW) + [THRUST] * thrust_unknown
    if remedies:
        lines.append("An hour each, most useful first: " + "; ".join(remedies) + ".")
    return lines


def _of_sizes(aircraft: Aircraft) -> str:
    """Return the sizes that are uncertain, with what errors of all causes make of them."""
    moments = dict(zip(MOMENTS, aircraft.inertia.diagonal(), strict=True))
    units = QUANTITIES | dict.fromkeys(MOMENTS, "kg m^2")
    words = []
    for name, unit in units.items():
        parts = [each.std * each.powers.get(name, 0.0) for each in (aircraft.deviations or {}).values()]
        if std := float(np.linalg.norm(parts)):
            value = moments[name] if name in moments else getattr(aircraft, name)
            words.append(f"{name.replace('_', ' ')} {value:.3g} {unit} ± {100 * std:.2g} %")
    return f"Of the aircraft: {', '.join(words)}."


def _of_causes(aircraft: Aircraft) -> list[str]:
    """Return a line of the rules that the sizes were estimated by."""
    rules = [f"{name} ({each.source})" for name, each in (aircraft.deviations or {}).items() if each.source != "told"]
    return [f"Estimated: {', '.join(rules)}."] if rules else []


def _remedies(aircraft: Aircraft) -> list[str]:
    """Return what to measure, that first which lessens the errors of the coefficients most."""
    deviations = aircraft.deviations or {}
    errors = np.sum(relative_errors(deviations, ())[..., 0] ** 2, axis=1) if deviations else []
    by_remedy: dict[str, float] = {}
    causes: dict[str, list[str]] = {}
    for (name, _), error in zip(deviations.items(), errors, strict=True):
        words = REMEDIES.get(name, f"measure the {name}")
        by_remedy[words] = by_remedy.get(words, 0.0) + float(error)
        causes.setdefault(words, []).append(name)
    ranked = sorted(by_remedy, key=lambda words: -by_remedy[words])[:LISTED]
    return [f"{words} ({', '.join(causes[words])})" for words in ranked]
