"""What `identify` assumes where neither flights nor caller say: units of surfaces, the thrust, the aircraft."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    PRESSURE,
    QUANTITIES,
    REMEDIES,
    Aircraft,
    ScaleFactor,
    dynamic_pressure,
    propeller_speed_of,
    propulsive_loads,
    relative_errors,
)
from skdgp.identification._flights import AIRSPEED_ERROR, Flights, items_of
from skdgp.io import FULL_THROW, Throw, is_log, names_servos, read_servos, reversed_of

THRUST_IN_COEFFICIENTS = (
    "Nothing gives the thrust, so it is part of the coefficients, with throttle and airspeed as "
    "regressors: CX is "
    "thrust less drag, which the model does not tell apart."
)
FULL_THROWS = "Surfaces are in parts of their full throw, as no servo file gives angles: effects are of a full throw."
THROWS = 'angles of surfaces at full throw (servo file: elevator = "25 +- 1 deg")'
THRUST = "thrust on a bench over the propeller's speed"
LISTED = 3  # measurements that are named


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
    names = (
        reversed_surfaces(pd.concat(parts[0].values(), ignore_index=True))
        if reversed_of(servos) == ()
        else []
    )
    if not names:
        return servos, *parts
    servos = f"{FULL_THROW}, reversed {' '.join(names)}"
    warn(
        f"The flights show that {' and '.join(names)} move the other way than the autopilot's "
        f"parameters say, so their "
        f'signs are turned: servos = "{servos}".',
        FlightDataWarning,
        stacklevel=3,
    )
    return servos, *(
        {
            key: table.assign(**{name: -table[name] for name in names if name in table})
            for key, table in part.items()
        }
        for part in parts
    )


def with_throw_errors(aircraft: Aircraft, servos: Any) -> Aircraft:
    """Return the aircraft, with the deviations of full throws that a servo file gives among its own."""
    told = read_servos(servos) if reversed_of(servos) is None else {}
    stds = {
        name: each.std / each.angle
        for name, each in told.items()
        if isinstance(each, Throw) and each.std
    }
    factors = {
        f"throw of the {name}": ScaleFactor(std, {name: 1.0}, "given") for name, std in stds.items()
    }
    return _with_deviations(aircraft, factors)


def _with_deviations(aircraft: Aircraft, factors: Mapping[str, ScaleFactor]) -> Aircraft:
    return (
        replace(aircraft, deviations={**(aircraft.deviations or {}), **factors})
        if factors
        else aircraft
    )


def with_airspeed_errors(aircraft: Aircraft, tables: Iterable[pd.DataFrame]) -> Aircraft:
    """Return the aircraft, with the deviation of airspeeds that are of turns, as if one error were in all samples."""
    std = max((table.attrs.get(AIRSPEED_ERROR, 0.0) for table in tables), default=0.0)
    factor = ScaleFactor(2 * std, {PRESSURE: 1.0}, "velocity over the ground in turns")
    return _with_deviations(aircraft, {"airspeed": factor} if std else {})


def with_thrust_errors(
    aircraft: Aircraft, table: pd.DataFrame, regressors: pd.DataFrame, thrust: str
) -> Aircraft:
    """Return the aircraft, with what the deviation of its propeller's thrust makes of the coefficients of flights.

    If the thrust is T (1 + e), coefficients lack e T / (qbar S) of it, and a model learns that as
    the nearest linear function of its regressors.
    """
    propeller = aircraft.propeller
    if propeller is None or not propeller.load_std:
        return aircraft
    scale = dynamic_pressure(table["airspeed"], table["density"])[:, None] * aircraft.wing_area
    force, moment = propulsive_loads(table, aircraft, thrust)
    shares = -np.hstack([force, moment / aircraft.moment_lengths]) / scale
    known = np.isfinite(shares).all(axis=1) & np.isfinite(regressors.to_numpy()).all(axis=1)
    shares, values = shares[known], regressors.to_numpy()[known]
    slopes = np.linalg.lstsq(
        values - values.mean(axis=0), shares - shares.mean(axis=0), rcond=None
    )[0]
    names = ["", *(f"_{str(name).removesuffix(HAT)}" for name in regressors)]
    effects = np.vstack([shares.mean(axis=0), slopes]).T.ravel().tolist()
    added = dict(
        zip(
            [coefficient + name for coefficient in COEFFICIENTS for name in names],
            effects,
            strict=True,
        )
    )
    factor = ScaleFactor(propeller.load_std, source="size of the propeller", added=added)
    return _with_deviations(aircraft, {"thrust": factor})


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
    """Return what was assumed, and which measurements would narrow what follows from it most, in a line each."""
    lines, deviations, full_throws = [], aircraft.deviations or {}, reversed_of(servos) is not None
    # The sizes that are uncertain, with what errors of all causes make of them.
    moments, sizes = dict(zip(MOMENTS, aircraft.inertia.diagonal(), strict=True)), []
    for name, unit in (QUANTITIES | dict.fromkeys(MOMENTS, "kg m^2")).items():
        if std := float(
            np.linalg.norm([each.std * each.powers.get(name, 0.0) for each in deviations.values()])
        ):
            value = moments[name] if name in moments else getattr(aircraft, name)
            sizes.append(f"{name.replace('_', ' ')} {value:.3g} {unit} ± {100 * std:.2g} %")
    if sizes:
        lines.append(
            f"Of the aircraft: {', '.join(sizes)}; what this makes of derivatives is std_aircraft."
        )
    # The rules that they were estimated by, each source with all that is from it.
    by_source: dict[str, list[str]] = {}
    for name, each in deviations.items():
        by_source.setdefault(each.source.rpartition(", ")[2], []).append(name)
    if rules := [
        f"{', '.join(names)} ({source})" for source, names in by_source.items() if source != "given"
    ]:
        lines.append(f"Estimated: {'; '.join(rules)}.")
    lines += [FULL_THROWS] * full_throws + [THRUST_IN_COEFFICIENTS] * thrust_unknown
    # What to measure, that first which lessens the errors of the coefficients most.
    errors = np.sum(relative_errors(deviations, ())[..., 0] ** 2, axis=1) if deviations else []
    gains: dict[str, float] = {}
    for name, error in zip(deviations, errors, strict=True):
        if error:  # none of products of inertia and of throws, which are not of a coefficient
            remedy = REMEDIES.get(name, f"measure the {name}")
            gains[remedy] = gains.get(remedy, 0.0) + float(error)
    remedies = sorted(gains, key=lambda remedy: -gains[remedy])[:LISTED] + [THROWS] * full_throws
    remedies += [THRUST] * (thrust_unknown or "thrust" in deviations)
    return (
        [*lines, f"An hour each, most useful first: {'; '.join(remedies)}."] if remedies else lines
    )
