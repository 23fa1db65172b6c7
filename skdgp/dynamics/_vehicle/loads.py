"""Loads on the aircraft: from coefficients, a flight table, or controls."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._flight.checks import check_columns
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.engines import Propeller, ThrustLine

__all__ = ["aerodynamic_loads", "external_loads", "propeller_loads", "propulsion_loads", "propulsive_loads"]

FORCE_AXES, MOMENT_AXES = "xyz", "lmn"
FORCES, MOMENTS = ([f"thrust_{axis}" for axis in axes] for axes in (FORCE_AXES, MOMENT_AXES))
THRUST_CHOICES = ("auto", "columns", "propeller", None)
CENTRED = ThrustLine()
Thrust: TypeAlias = "str | Callable | None"
"""What gives the thrust in a simulation."""


def aerodynamic_loads(
    coefficients: ArrayLike, airspeed: ArrayLike, density: ArrayLike, aircraft: Aircraft
) -> tuple[Array, Array]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of coefficients (..., 6).

    F_A = qbar S (CX, CY, CZ),  M_A = qbar S (b Cl, c Cm, b Cn),  qbar = rho V^2 / 2, in body axes about the centre
    of gravity.

    Parameters
    ----------
    coefficients : array-like (..., 6)
        CX CY CZ Cl Cm Cn.
    airspeed, density : array-like (...)
        V [m/s] and rho [kg/m^3].
    aircraft : Aircraft
        Its wing area, span and chord are used.

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
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the aircraft's propeller on its thrust line.

    Equation 7 of Hemakumara & Sukkarieh (2011): F_T = T(Omega, V) d,  M_T = r_T x F_T + Q d.

    Parameters
    ----------
    aircraft : Aircraft
        Its propeller and thrust line.
    propeller_speed, airspeed, density : array-like (...)
        Omega [rad/s], V [m/s], rho [kg/m^3].

    Returns
    -------
    force, moment : ndarray (..., 3)
        In body axes, the moment about the centre of gravity.

    Raises
    ------
    ValueError
        If the aircraft has no propeller.
    """
    propeller = aircraft.propeller
    if propeller is None:
        raise ValueError(
            f"{aircraft!r} has no propeller: give propeller=Propeller.from_table(bench, diameter) to Aircraft."
        )
    state = (propeller_speed, airspeed, density)
    return (aircraft.thrust_line or CENTRED).loads(propeller.thrust(*state), propeller.torque(*state))


def propulsive_loads(flight: pd.DataFrame, aircraft: Aircraft, thrust: str | None = "auto") -> tuple[Array, Array]:
    """Return the propulsive force (n, 3) [N] and moment (n, 3) [N m] along a flight.

    Parameters
    ----------
    flight : pandas.DataFrame
        With columns ``thrust_x`` ... ``thrust_n``, or ``propeller_speed``, ``airspeed`` and ``density``.
    aircraft : Aircraft
        Its thrust line and propeller.
    thrust : {"auto", "columns", "propeller", None}, default="auto"
        "columns" takes the force columns, absent ones being zero. Without any moment column the moment is that of
        the force at the thrust line's position, r_T x F_T. "propeller" evaluates the propeller's model. "auto"
        takes the columns where they stand, else the propeller. None says that there is no propulsion (a glider).

    Returns
    -------
    force, moment : ndarray (n, 3)
        In body axes, the moment about the centre of gravity.

    Raises
    ------
    ValueError
        If nothing tells the thrust.
    """
    if thrust not in THRUST_CHOICES:
        raise ValueError(f"Got thrust={thrust!r}, but expected one of {THRUST_CHOICES}.")
    zero = np.zeros((len(flight), 3))
    if thrust is None:
        return zero, zero
    force_columns = _axis_columns(flight, "thrust", FORCE_AXES)
    if thrust == "auto":
        thrust = "columns" if force_columns else "propeller"
    if thrust == "columns":
        return _thrust_columns(flight, aircraft, force_columns)
    if aircraft.propeller is None or "propeller_speed" not in flight:
        lacking = "the aircraft has no propeller" if aircraft.propeller is None else "it has no propeller_speed [rad/s]"
        raise ValueError(
            f"Nothing tells the thrust of this flight: it has no thrust_x, thrust_y or thrust_z [N], and {lacking}. "
            "Add the thrust columns; or a propeller to the aircraft (Propeller.from_table of a bench table) and "
            "propeller_speed to the flight; or say thrust=None if it flew without an engine."
        )
    check_columns(flight, ["airspeed", "density"])
    speed, airspeed, density = (flight[c].to_numpy(float) for c in ("propeller_speed", "airspeed", "density"))
    _warn_beyond_bench(aircraft.propeller, speed, airspeed)
    return propeller_loads(aircraft, speed, airspeed, density)


def external_loads(flight: pd.DataFrame, names: Iterable[str]) -> tuple[Array, Array]:
    """Return the sum of the external forces (n, 3) [N] and moments (n, 3) [N m] named in ``names``.

    The name "tether" stands for the columns tether_x, tether_y, tether_z (all required) and tether_l, tether_m,
    tether_n (those that exist), in body axes about the centre of gravity.
    """
    if isinstance(names, str):
        raise ValueError(f"Got external_forces={names!r}, but expected a sequence of names: ({names!r},).")
    force, moment = np.zeros((len(flight), 3)), np.zeros((len(flight), 3))
    for name in names:
        check_columns(flight, [f"{name}_{axis}" for axis in FORCE_AXES])
        force += _axes(flight, name, FORCE_AXES)
        moment += _axes(flight, name, MOMENT_AXES)
    return force, moment


def propulsion_loads(
    aircraft: Aircraft, thrust: Thrust, controls: Mapping, airspeed: Array, density: Array
) -> tuple[Array, Array] | tuple[float, float]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the engine in a simulation, from controls by name, (...).

    ``thrust`` is that of `skdgp.dynamics.simulate`: None, a function, or "auto".

    Raises
    ------
    ValueError
        If nothing tells the thrust.
    """
    if thrust is None:
        return 0.0, 0.0
    line = aircraft.thrust_line or CENTRED
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
        shape = np.shape(airspeed)
        force, moment = (
            np.stack([np.broadcast_to(controls.get(name, 0.0), shape) for name in names], axis=-1)
            for names in (FORCES, MOMENTS)
        )
        return force, moment if any(name in controls for name in MOMENTS) else np.cross(line.position, force)
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


def thrust_control(aircraft: Aircraft, thrust: Thrust) -> str | None:
    """Return the control that sets the thrust of an aircraft in trim; None for a glider."""
    if thrust is None:
        return None
    if callable(thrust):
        return "throttle"
    if aircraft.propeller is None:
        return "thrust"
    return "propeller_speed" if aircraft.propeller.speed_range is None else "throttle"


def _thrust_columns(flight: pd.DataFrame, aircraft: Aircraft, force_columns: list[str]) -> tuple[Array, Array]:
    if not force_columns:
        raise ValueError(
            "Got thrust='columns' for a flight without thrust_x, thrust_y or thrust_z [N]: add them, or say "
            "thrust='propeller' or thrust=None."
        )
    force, moment = _axes(flight, "thrust", FORCE_AXES), _axes(flight, "thrust", MOMENT_AXES)
    if aircraft.thrust_line is not None and not _axis_columns(flight, "thrust", MOMENT_AXES):
        moment = np.cross(aircraft.thrust_line.position, force)
    return force, moment


def _warn_beyond_bench(propeller: Propeller, propeller_speed: Array, airspeed: Array) -> None:
    if propeller.max_advance_ratio is None:
        return
    running = propeller_speed > 0
    beyond = propeller.advance_ratio(propeller_speed, airspeed)[running] > 1.05 * propeller.max_advance_ratio
    if beyond.any():
        warnings.warn(
            f"In {100 * beyond.mean():.0f} % of the samples the propeller's advance ratio exceeds the largest one on "
            f"the bench ({propeller.max_advance_ratio:.2f}): the thrust there is an extrapolation. Measure at higher "
            "airspeed, or give thrust columns.",
            UserWarning,
            stacklevel=4,
        )


def _axis_columns(flight: pd.DataFrame, name: str, axes: str) -> list[str]:
    return [f"{name}_{axis}" for axis in axes if f"{name}_{axis}" in flight]


def _axes(flight: pd.DataFrame, name: str, axes: str) -> Array:
    """Return the columns name_axis as (n, 3), zero where a column is absent."""
    columns = [f"{name}_{axis}" for axis in axes]
    return np.stack([flight[c].to_numpy(float) if c in flight else np.zeros(len(flight)) for c in columns], axis=-1)
