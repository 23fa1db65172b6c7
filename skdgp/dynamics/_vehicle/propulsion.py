"""Force and moment of the engine in a simulation, from the controls."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import FORCE_AXES, MOMENT_AXES, propeller_loads
from skdgp.dynamics._vehicle.thrust_line import ThrustLine

__all__ = ["propulsion_of", "thrust_control"]

CENTRED = ThrustLine()
FORCES, MOMENTS = ([f"thrust_{axis}" for axis in axes] for axes in (FORCE_AXES, MOMENT_AXES))


def propulsion_of(aircraft: Aircraft, thrust, controls: Mapping, airspeed, density) -> tuple:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the engine under ``controls``, by name, each (...).

    ``thrust`` None: no engine. A function (controls, airspeed, density) gives newtons along the thrust line. "auto":
    the controls ``thrust_x`` ... ``thrust_n`` where there are any, else ``thrust`` [N] along the thrust line, else the
    propeller at ``propeller_speed`` [rad/s], or at ``throttle`` where its range of speeds is known.

    Raises
    ------
    ValueError
        If nothing tells the thrust.
    """
    if thrust is None:
        return 0.0, 0.0
    line = CENTRED if aircraft.thrust_line is None else aircraft.thrust_line
    if callable(thrust):
        newtons = thrust(controls, airspeed, density)
        if np.ndim(newtons) > np.ndim(airspeed):
            raise ValueError(
                f"Got thrust of shape {np.shape(newtons)} at airspeeds of shape {np.shape(airspeed)}, but expected a "
                "function (controls, airspeed, density) to newtons along the thrust line, one for each airspeed."
            )
        return line.loads(newtons)
    if thrust != "auto":
        raise ValueError(f"Got thrust={thrust!r}, but expected 'auto', None or a function.")
    if any(name in controls for name in FORCES):
        force = _stack(controls, FORCES, airspeed)
        return force, _stack(controls, MOMENTS, airspeed) if _has_moments(controls) else np.cross(line.position, force)
    if "thrust" in controls:
        return line.loads(controls["thrust"])
    if aircraft.propeller is not None and "propeller_speed" in controls:
        return propeller_loads(aircraft, controls["propeller_speed"], airspeed, density)
    if aircraft.propeller is not None and aircraft.propeller.speed_range is not None and "throttle" in controls:
        return propeller_loads(aircraft, aircraft.propeller.speed_at(controls["throttle"]), airspeed, density)
    raise ValueError(
        f"Nothing tells the thrust: the controls are {sorted(controls)}. Give thrust_x ... thrust_n or thrust [N] as "
        "controls; or propeller_speed [rad/s] for an aircraft with a propeller, or throttle if Propeller(speed_range="
        "(idle, full)) is known; or thrust=function of (controls, airspeed, density); or thrust=None for a glider."
    )


def thrust_control(aircraft: Aircraft, thrust) -> str | None:
    """Return the one control that sets the thrust of an aircraft in trim; None for a glider."""
    if thrust is None:
        return None
    if callable(thrust):
        return "throttle"
    if aircraft.propeller is None:
        return "thrust"
    return "propeller_speed" if aircraft.propeller.speed_range is None else "throttle"


def _has_moments(controls) -> bool:
    return any(name in controls for name in MOMENTS)


def _stack(controls, names, airspeed):
    shape = np.shape(airspeed)
    return np.stack([np.broadcast_to(controls.get(name, 0.0), shape) for name in names], axis=-1)
