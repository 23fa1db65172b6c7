"""Loads on the aircraft, computed from coefficients, a flight table, or controls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

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

CENTRED = ThrustLine()
Thrust: TypeAlias = "str | Callable | None"  # Sources of the thrust in a simulation


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
    values: Mapping | pd.DataFrame, aircraft: Aircraft, thrust: Thrust = "auto"
) -> tuple[Array, Array]:
    """Return the propulsive force (..., 3) [N] and moment (..., 3) [N m], in body axes about the CG.

    ``values`` are a flight table, or controls with ``airspeed`` and ``density`` by name, (...).
    ``thrust`` "auto": ``thrust_x`` ... ``thrust_z``, absent ones zero, and ``thrust_l`` ...
    ``thrust_n``, or without any of these r_T x F_T at the thrust line's position; else ``thrust``
    [N] along the thrust line; else the propeller of the aircraft at ``propeller_speed`` or, where
    its ``speed_range`` is given, at ``throttle``. A function (values, airspeed, density) to newtons
    along the thrust line. None: zero, for a glider, or for an unknown thrust as part of the
    coefficients. Raises ValueError if nothing gives the thrust.
    """
    airspeed = np.asarray(values["airspeed"], dtype=float)
    density = np.asarray(values["density"], dtype=float)
    line = aircraft.thrust_line or CENTRED
    if thrust is None:
        return np.zeros((*airspeed.shape, 3)), np.zeros((*airspeed.shape, 3))
    if callable(thrust):
        newtons = thrust(values, airspeed, density)
        if np.ndim(newtons) > airspeed.ndim:
            raise ValueError(
                f"Got thrust of shape {np.shape(newtons)} at airspeeds of shape {airspeed.shape}, "
                f"but expected a function (controls, airspeed, density) to newtons along the thrust "
                f"line, one for each airspeed."
            )
        return line.loads(newtons)
    if thrust != "auto":
        raise ValueError(f"Got thrust={thrust!r}, but expected 'auto', None or a function.")
    if any(name in values for name in THRUST_FORCES):
        force = stacked(values, THRUST_FORCES, airspeed.shape)
        if any(name in values for name in THRUST_MOMENTS):
            return force, stacked(values, THRUST_MOMENTS, airspeed.shape)
        return force, cross(line.position, force)
    if "thrust" in values:
        return line.loads(values["thrust"])
    speed = propeller_speed_of(aircraft.propeller, values)
    if speed is None:
        lacking = "no propeller_speed [rad/s]" if aircraft.propeller else "no propeller"
        raise ValueError(
            f"The thrust is unknown: there is neither thrust_x, thrust_y, thrust_z nor thrust [N], "
            f"and {lacking}. Add them, or Propeller.from_table(bench, diameter) to the aircraft and "
            f"propeller_speed, or throttle with speed_range=(idle, full); or say thrust=None "
            f"(--thrust none) for a glider, or to leave an unknown thrust in the coefficients."
        )
    if isinstance(values, pd.DataFrame):
        _warn_beyond_bench(aircraft.propeller, speed, airspeed)
    return propeller_loads(aircraft, speed, airspeed, density)


def _warn_beyond_bench(propeller: Any, speed: Array, airspeed: Array) -> None:
    """Warn of samples whose advance ratio exceeds the largest one of the bench table."""
    largest = propeller.max_advance_ratio
    is_beyond = propeller.advance_ratio(speed, airspeed)[speed > 0] > 1.05 * (largest or np.inf)
    if is_beyond.any():
        warn(
            f"In {100 * is_beyond.mean():.0f} % of the samples the propeller's advance ratio exceeds "
            f"the largest one on the bench ({largest:.2f}): the thrust there is an extrapolation. "
            f"Measure at higher airspeed, or give thrust columns.",
            stacklevel=4,
        )


def propeller_speed_of(propeller: Propeller | None, values: Mapping | pd.DataFrame) -> Array | None:
    """Return the propeller speed [rad/s] of a flight or of controls, by the throttle if need be; None if unknown."""
    if propeller is None:
        return None
    if "propeller_speed" in values:
        return np.asarray(values["propeller_speed"], dtype=float)
    by_throttle = propeller.speed_range is not None and "throttle" in values
    return propeller.speed_at(values["throttle"]) if by_throttle else None


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


def stacked(values: Mapping | pd.DataFrame, names: Iterable[str], shape: tuple[int, ...]) -> Array:
    """Return values by name as (..., 3), zero where one is absent."""
    columns = [np.asarray(values[name], dtype=float) if name in values else 0.0 for name in names]
    return np.stack([np.broadcast_to(column, shape) for column in columns], axis=-1)
