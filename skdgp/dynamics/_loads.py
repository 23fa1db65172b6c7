"""Loads on the aircraft, computed from coefficients, a flight table, or controls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import THRUST_FORCES, THRUST_MOMENTS
from skdgp._flight.checks import check_columns
from skdgp._flight.frames import cross
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._engines import Propeller, ThrustLine

THRUST_CHOICES = ("auto", "columns", "propeller", None)
CENTRED = ThrustLine()
Thrust: TypeAlias = "str | Callable | None"
"""Sources of the thrust in a simulation."""


def aerodynamic_loads(
    coefficients: ArrayLike, airspeed: ArrayLike, density: ArrayLike, aircraft: Aircraft
) -> tuple[Array, Array]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of coefficients (..., 6).

    F_A = qbar S (CX, CY, CZ),  M_A = qbar S (b Cl, c Cm, b Cn),  qbar = rho V^2 / 2, in body axes about the centre of
    gravity.

    Parameters
    ----------
    coefficients : array-like (..., 6)
        CX CY CZ Cl Cm Cn.
    airspeed, density : array-like (...)
        V [m/s] and rho [kg/m^3].
    aircraft : Aircraft

    Returns
    -------
    force, moment : ndarray (..., 3)

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aircraft, aerodynamic_loads
    >>> aircraft = Aircraft(mass=2, inertia=np.eye(3), wing_area=0.5, span=2, chord=0.25)
    >>> force, moment = aerodynamic_loads([-0.05, 0, -0.4, 0, 0.01, 0], 20.0, 1.2, aircraft)
    >>> force.round(3).tolist(), moment.round(3).tolist()
    ([-6.0, 0.0, -48.0], [0.0, 0.3, 0.0])
    """
    coefficients = np.asarray(coefficients, dtype=float)
    scale = dynamic_pressure(airspeed, density)[..., None] * aircraft.wing_area
    return scale * coefficients[..., :3], scale * aircraft.moment_lengths * coefficients[..., 3:]


def dynamic_pressure(airspeed: ArrayLike, density: ArrayLike) -> Array:
    """Return qbar = rho V^2 / 2 [Pa]."""
    return 0.5 * np.asarray(density, dtype=float) * np.square(np.asarray(airspeed, dtype=float))


def propeller_loads(
    aircraft: Aircraft, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike
) -> tuple[Array, Array]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the aircraft's propeller, about the centre of gravity.

    Equation 7 of Hemakumara & Sukkarieh (2011): F_T = T(Omega, V) d,  M_T = r_T x F_T + Q d. Raises ValueError if the
    aircraft has no propeller.

    Parameters
    ----------
    aircraft : Aircraft
    propeller_speed, airspeed, density : array-like (...)
        Omega [rad/s], V [m/s], rho [kg/m^3].

    Returns
    -------
    force, moment : ndarray (..., 3)
        In body axes.
    """
    propeller = aircraft.propeller
    if propeller is None:
        raise ValueError(
            f"{aircraft!r} has no propeller: give propeller=Propeller.from_table(bench, diameter) "
            f"to Aircraft."
        )
    state = (propeller_speed, airspeed, density)
    return (aircraft.thrust_line or CENTRED).loads(
        propeller.thrust(*state), propeller.torque(*state)
    )


def propulsive_loads(
    flight: pd.DataFrame, aircraft: Aircraft, thrust: str | None = "auto"
) -> tuple[Array, Array]:
    """Return the propulsive force (n, 3) [N] and moment (n, 3) [N m] along a flight, in body axes about the CG.

    ``thrust`` "columns": ``thrust_x`` ... ``thrust_z``, absent ones zero, and ``thrust_l`` ...
    ``thrust_n``, or without any of these r_T x F_T at the thrust line's position. "propeller": that
    of the aircraft at ``propeller_speed``, or where it knows its ``speed_range`` at ``throttle``,
    ``airspeed`` and ``density``. "auto": columns where there are any, else the propeller. None:
    zero, for a glider, or for an unknown thrust as part of the coefficients. Raises ValueError if
    nothing gives the thrust.
    """
    if thrust not in THRUST_CHOICES:
        raise ValueError(f"Got thrust={thrust!r}, but expected one of {THRUST_CHOICES}.")
    if thrust is None:
        return np.zeros((len(flight), 3)), np.zeros((len(flight), 3))
    has_columns, propeller = any(name in flight for name in THRUST_FORCES), aircraft.propeller
    if thrust == "columns" and not has_columns:
        raise ValueError(
            "Got thrust='columns' for a flight without thrust_x, thrust_y or thrust_z [N]: add "
            "them, or say "
            "thrust='propeller' or thrust=None."
        )
    if has_columns and thrust != "propeller":
        return _loads_by_axis(flight, aircraft, (len(flight),))
    speed = propeller_speed_of(propeller, flight)
    if propeller is None or speed is None:
        lacking = (
            "the aircraft has no propeller"
            if propeller is None
            else "it has no propeller_speed [rad/s]"
        )
        raise ValueError(
            f"The thrust of this flight is unknown: it has no thrust_x, thrust_y or thrust_z [N], "
            f"and {lacking}. "
            "Add the thrust columns; or a propeller to the aircraft (Propeller.from_table of a "
            "bench table) and "
            "propeller_speed to the flight; or say thrust=None (--thrust none) if it flew without "
            "an engine, or to "
            "leave an unknown thrust in the coefficients (regressors with throttle and airspeed "
            "explain it)."
        )
    check_columns(flight, ["airspeed", "density"])
    airspeed, density = (flight[c].to_numpy(float) for c in ("airspeed", "density"))
    largest, running = propeller.max_advance_ratio, speed > 0
    if largest is not None:
        beyond = propeller.advance_ratio(speed, airspeed)[running] > 1.05 * largest
        if beyond.any():
            warn(
                f"In {100 * beyond.mean():.0f} % of the samples the propeller's advance ratio "
                f"exceeds the largest one "
                f"on the bench ({largest:.2f}): the thrust there is an extrapolation. Measure at "
                f"higher airspeed, or "
                "give thrust columns.",
                stacklevel=3,
            )
    return propeller_loads(aircraft, speed, airspeed, density)


def propeller_speed_of(propeller: Propeller | None, values: Mapping | pd.DataFrame) -> Array | None:
    """Return the propeller speed [rad/s] of a flight or of controls, by the throttle if need be; None if unknown."""
    if propeller is None:
        return None
    if "propeller_speed" in values:
        return np.asarray(values["propeller_speed"], dtype=float)
    by_throttle = propeller.speed_range is not None and "throttle" in values
    return propeller.speed_at(values["throttle"]) if by_throttle else None


def propulsion_loads(
    aircraft: Aircraft, thrust: Thrust, controls: Mapping, airspeed: Array, density: Array | float
) -> tuple[Array, Array] | tuple[float, float]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the engine in a simulation, from controls by name, (...).

    ``thrust`` is that of `skdgp.dynamics.simulate`: None, a function, or "auto"; raises ValueError
    if nothing gives it.
    """
    if thrust is None:
        return 0.0, 0.0
    line = aircraft.thrust_line or CENTRED
    if callable(thrust):
        newtons = thrust(controls, airspeed, density)
        if np.ndim(newtons) > np.ndim(airspeed):
            raise ValueError(
                f"Got thrust of shape {np.shape(newtons)} at airspeeds of shape "
                f"{np.shape(airspeed)}, but expected a "
                "function (controls, airspeed, density) to newtons along the thrust line, one for "
                "each airspeed."
            )
        return line.loads(newtons)
    if thrust != "auto":
        raise ValueError(f"Got thrust={thrust!r}, but expected 'auto', None or a function.")
    if any(name in controls for name in THRUST_FORCES):
        return _loads_by_axis(controls, aircraft, np.shape(airspeed))
    if "thrust" in controls:
        return line.loads(controls["thrust"])
    if (speed := propeller_speed_of(aircraft.propeller, controls)) is not None:
        return propeller_loads(aircraft, speed, airspeed, density)
    raise ValueError(
        f"The thrust is unknown: the controls are {sorted(controls)}. Give thrust_x ... thrust_n "
        f"or thrust [N] as "
        "controls; or propeller_speed [rad/s] for an aircraft with a propeller, or throttle if "
        "Propeller(speed_range="
        "(idle, full)) is known; or thrust=function of (controls, airspeed, density); or "
        "thrust=None (--thrust none) "
        "for a glider, or if the coefficients of the model include the thrust."
    )


def thrust_control(aircraft: Aircraft, thrust: Thrust) -> str | None:
    """Return the control that sets the thrust of an aircraft in trim; None without thrust."""
    if thrust is None:
        return None
    if callable(thrust):
        return "throttle"
    if aircraft.propeller is None:
        return "thrust"
    return "propeller_speed" if aircraft.propeller.speed_range is None else "throttle"


def external_loads(flight: pd.DataFrame, names: Iterable[str]) -> tuple[Array, Array]:
    """Return the sum of the external forces (n, 3) [N] and moments (n, 3) [N m] named in ``names``.

    The name "tether" stands for the columns tether_x, tether_y, tether_z (all required) and
    tether_l, tether_m, tether_n (those that exist), in body axes about the centre of gravity.
    """
    if isinstance(names, str):
        raise ValueError(
            f"Got external_forces={names!r}, but expected a sequence of names: ({names!r},)."
        )
    force, moment = np.zeros((len(flight), 3)), np.zeros((len(flight), 3))
    for name in names:
        forces, moments = ([f"{name}_{axis}" for axis in axes] for axes in ("xyz", "lmn"))
        check_columns(flight, forces)
        force += stacked(flight, forces, (len(flight),))
        moment += stacked(flight, moments, (len(flight),))
    return force, moment


def _loads_by_axis(
    values: Mapping | pd.DataFrame, aircraft: Aircraft, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    """Return the thrust of its columns or controls; without a moment, that of the force on the thrust line."""
    force = stacked(values, THRUST_FORCES, shape)
    if any(name in values for name in THRUST_MOMENTS):
        return force, stacked(values, THRUST_MOMENTS, shape)
    return force, cross((aircraft.thrust_line or CENTRED).position, force)


def stacked(values: Mapping | pd.DataFrame, names: Iterable[str], shape: tuple[int, ...]) -> Array:
    """Return values by name as (..., 3), zero where one is absent."""
    columns = [np.asarray(values[name], dtype=float) if name in values else 0.0 for name in names]
    return np.stack([np.broadcast_to(column, shape) for column in columns], axis=-1)
