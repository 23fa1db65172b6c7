"""Inverse dynamics: the aerodynamic coefficients from the measured motion."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import report
from skdgp._compute.typing import Vector
from skdgp._flight.channels import (
    COEFFICIENTS,
    RATE_DERIVATIVES,
    RATES,
    SPECIFIC_FORCE,
)
from skdgp._flight.faults import (
    POSSIBLE,
    FlightDataWarning,
    find_faults,
    without_faults,
)
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import SEA_LEVEL_DENSITY
from skdgp._flight.physics import sizes_in_flight
from skdgp._flight.sensor_position import acceleration_by_rotation
from skdgp._flight.smoothing import (
    LowPass,
    differentiate,
    smooth,
    vibration_band,
    without_vibration,
)
from skdgp._flight.tables import (
    FlightTable,
    by_name,
    numeric,
    sensor_position,
    with_sensor_position,
)
from skdgp._flight.units import check_flight
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._rigid_body import (
    dynamic_pressure,
    gyroscopic_moment,
    propeller_speed_of,
    propulsive_loads,
)

NEEDED = ["airspeed", "density", *SPECIFIC_FORCE, *RATES]
SMOOTHED = ["airspeed", *SPECIFIC_FORCE, *RATES, *RATE_DERIVATIVES]
# targets of a regression may not shrink; airspeed is a regressor, too
SHRINKS = [name == "airspeed" for name in SMOOTHED]


def aerodynamic_coefficients(
    flight: pd.DataFrame | FlightTable,
    aircraft: Aircraft,
    *,
    cutoff: float | str | LowPass | None = "auto",
    thrust: str | None = "auto",
    ignore: Iterable[str] = (),
) -> pd.DataFrame:
    """Return the six aerodynamic coefficients along a flight.

    With specific force f, rates omega, propulsive loads F_T, M_T (Hemakumara & Sukkarieh 2011,
    equations 3 to 8),

        F_A = m f - F_T,   M_A = I omega_dot + omega x (I omega) - M_T,
        (CX, CY, CZ) = F_A / (qbar S),   (Cl, Cm, Cn) = M_A / (qbar S (b, c, b)),   qbar = rho V^2 / 2.

    Raises ValueError if a column is missing, time does not increase, values are impossible in SI
    units, or nothing gives the thrust. Warns with FlightDataWarning if samples were not measured:
    the coefficients are NaN there.

    Parameters
    ----------
    flight : pandas.DataFrame
        Columns ``time`` [s], ``airspeed`` [m/s], ``density`` [kg/m^3], ``ax``, ``ay``, ``az``
        [m/s^2], ``p``, ``q``, ``r`` [rad/s]; ``flight`` (id) where there are several; ``p_dot``,
        ``q_dot``, ``r_dot`` [rad/s^2] where all three were measured, else the rates are
        differentiated. A column ``mass`` [kg] counts in place of the aircraft's mass; the inertia
        stays. ``sensor_position_x``, ``_y``, ``_z`` [m] count in place of the aircraft's position r
        of the inertial sensors, whose reading exceeds f by omega_dot x r + omega x (omega x r).
    aircraft : Aircraft
        Mass, inertia and reference lengths.
    cutoff : float, "auto" or None, default="auto"
        Zero-phase smoothing of the measured channels, and of the rates before they are
        differentiated: a corner frequency [Hz], the smoother of each channel's spectrum, or none.
        "auto" removes noise beyond the frequencies at which a channel has more signal, and keeps
        these as they are, as a Wiener smoother would make derivatives too small. Of flights with
        vanes that vibrate beyond the motion, it removes all beyond, as their pipeline does.
    thrust : {"auto", None}, default="auto"
        As for `propulsive_loads`. None: F_T and M_T are zero, for a glider, or for an unknown
        thrust, which is then part of the coefficients: throttle and airspeed as regressors explain
        it, and a simulation has ``thrust=None``.
    ignore : iterable of str, default=()
        Columns of ``flight`` that are not searched for faults.

    Returns
    -------
    pandas.DataFrame
        Columns CX, CY, CZ, Cl, Cm, Cn with the flight's index; NaN where a channel needed is NaN,
        stuck, impossible or a spike (as :func:`skdgp.preprocessing.inspect_flight` finds them).

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skdgp.dynamics import Aircraft, aerodynamic_coefficients
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> flight = pd.DataFrame({"time": np.arange(4) * 0.02, "airspeed": 12.0, "density": 1.2, "ax": 0.3,
    ...                        "ay": 0.0, "az": -9.8, "p": 0.0, "q": 0.0, "r": 0.0})
    >>> aerodynamic_coefficients(flight, glider, cutoff=None, thrust=None).round(3).iloc[0].to_dict()
    {'CX': 0.014, 'CY': 0.0, 'CZ': -0.454, 'Cl': 0.0, 'Cm': 0.0, 'Cn': 0.0}
    """
    flight = check_flight(_measured(flight, ignore), NEEDED).table
    mass = _mass(flight, aircraft)
    measured, rate_derivatives = _smoothed(flight, cutoff)
    thrust_force, thrust_moment = propulsive_loads(measured, aircraft, thrust)
    rates = numeric(measured, RATES)
    position = np.nan_to_num(sensor_position(with_sensor_position(flight, aircraft)))
    of_sensors = acceleration_by_rotation(rate_derivatives, rates, position)
    specific_force = numeric(measured, SPECIFIC_FORCE) - of_sensors
    total_force = mass[:, None] * specific_force
    total_moment = rate_derivatives @ aircraft.inertia + gyroscopic_moment(rates, aircraft)
    # Equations 3 to 8: force, moment, coefficients.
    F_A = total_force - thrust_force
    M_A = total_moment - thrust_moment
    qbar = dynamic_pressure(measured["airspeed"], measured["density"])[:, None]
    scale = qbar * aircraft.wing_area
    values = np.hstack([F_A / scale, M_A / (scale * aircraft.moment_lengths)])
    values[~np.isfinite(values).all(axis=1)] = np.nan
    return pd.DataFrame(values, columns=list(COEFFICIENTS), index=flight.index)


def numbers_in_flight(
    flights: FlightTable, aircraft: Aircraft
) -> tuple[dict[str, float], dict[str, float]]:
    """Return what flights tell of the sizes of their aircraft, by name, and the standard deviations.

    See `skdgp._flight.physics.sizes_in_flight`. An engine may be off for a part of the flights: the
    propeller's speed is the 95th percentile of the rows in which it turns.
    """
    table = flights.table.assign(density=flights.table.get("density", SEA_LEVEL_DENSITY))
    thrust = None
    with suppress(ValueError, KeyError):  # unknown, or without airspeed
        thrust, _ = propulsive_loads(table, aircraft)
    std = aircraft.propeller.load_std if aircraft.propeller else 0.0
    speed = propeller_speed_of(aircraft.propeller, table)
    numbers, stds = sizes_in_flight(flights, aircraft.mass, aircraft.wing_area, thrust, std)
    # CL_alpha is compared with that of a wing of the same aspect ratio, which the area changes too: between the aspect
    # ratios 7.5 and 3.7, two standard deviations of an estimated area, their ratio goes with the area to the power 0.65
    for name, power in {"CL": 1.0, "CZ_alpha": 0.65}.items():
        if name in numbers:
            of_area = power * abs(numbers[name]) * aircraft.relative_std("wing_area")
            stds[name] = float(np.hypot(stds.get(name, 0.0), of_area))
    turning = np.empty(0) if speed is None else speed[speed > 0]
    if turning.size:
        numbers["propeller_speed"] = float(np.quantile(turning, 0.95))
    return numbers, stds


def _measured(
    flight: pd.DataFrame | FlightTable, ignore: Iterable[str]
) -> pd.DataFrame | FlightTable:
    """Return the flight with NaN where a needed channel was not measured, and warn; one without faults as it is."""
    if isinstance(flight, FlightTable):
        return flight
    flights = FlightTable.of(flight, NEEDED)
    ignored = {*ignore, *(name for name in POSSIBLE if name not in NEEDED)}
    faults = [fault for fault in find_faults(flights, ignored) if not fault.is_measured]
    if faults:
        report(
            Finding(Code.FAULTS_EXCLUDED, faults=[fault.finding for fault in faults]),
            FlightDataWarning,
        )
    return without_faults(flight, faults)


def _mass(flight: pd.DataFrame, aircraft: Aircraft) -> Vector:
    """Return the mass [kg] of each row, (n,): the column ``mass``, or that of the aircraft."""
    if "mass" not in flight:
        return np.full(len(flight), aircraft.mass)
    mass = numeric(flight, ["mass"])[:, 0]
    invalid = np.flatnonzero((mass <= 0) | np.isinf(mass))
    if invalid.size:
        row = int(invalid[0])
        raise ValueError(
            f"Got a mass of {mass[row]:g} kg at row {row}, but expected finite numbers > 0: leave the column out, "
            "and the aircraft's mass counts."
        )
    return mass


def _smoothed(
    flight: pd.DataFrame, cutoff: float | str | LowPass | None
) -> tuple[pd.DataFrame, np.ndarray]:
    """Return the flight with smoothed channels, and the rate derivatives (n, 3)."""
    clock: dict[str, Any] = {"time": flight["time"].to_numpy(float), "flight": flight.get("flight")}
    channels = numeric(flight.reindex(columns=SMOOTHED), SMOOTHED)  # NaN where not measured
    if isinstance(cutoff, str) and cutoff == "auto":
        cutoff = without_vibration(vibration_band(flight))
    smoothed = smooth(channels, cutoff=cutoff, shrink=SHRINKS, **clock)
    measured = flight.assign(**by_name(SMOOTHED, smoothed))
    if {*RATE_DERIVATIVES} <= {*flight}:
        return measured, numeric(measured, RATE_DERIVATIVES)
    rates = [SMOOTHED.index(name) for name in RATES]
    return measured, differentiate(channels[:, rates], cutoff=cutoff, shrink=False, **clock)
