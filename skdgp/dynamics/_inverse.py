"""Inverse dynamics, the coefficients from the measured motion, and replay, motion from predicted coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import report
from skdgp._compute.typing import Array, Indices
from skdgp._flight.channels import (
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
)
from skdgp._flight.checks import check_columns, check_flight, check_table
from skdgp._flight.clock import true_runs
from skdgp._flight.faults import (
    POSSIBLE,
    FlightDataWarning,
    find_faults,
    without_faults,
)
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp._flight.smoothing import differentiate, smooth
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._inputs import table_states
from skdgp.dynamics._rigid_body import (
    aerodynamic_loads,
    dynamic_pressure,
    external_loads,
    gyroscopic_moment,
    propulsive_loads,
    rigid_body_derivative,
    rk4_step,
)
from skdgp.dynamics._simulate import channels

RATE_DERIVATIVES = ["p_dot", "q_dot", "r_dot"]
NEEDED = ["airspeed", "density", *SPECIFIC_FORCE, *RATES]


def aerodynamic_coefficients(
    flight: pd.DataFrame,
    aircraft: Aircraft,
    *,
    cutoff: float | str | None = "auto",
    thrust: str | None = "auto",
    external_forces: Sequence[str] = (),
    ignore: Iterable[str] = (),
) -> pd.DataFrame:
    """Return the six aerodynamic coefficients along a flight.

    With specific force f, rates omega, propulsive and external loads F_T, M_T (Hemakumara &
    Sukkarieh 2011, equations 3 to 8),

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
        differentiated.
    aircraft : Aircraft
        Mass, inertia and reference lengths.
    cutoff : float, "auto" or None, default="auto"
        Zero-phase smoothing of the measured channels, and of the rates before they are
        differentiated: a corner frequency [Hz], the smoother of each channel's spectrum, or none.
    thrust : {"auto", None}, default="auto"
        As for `propulsive_loads`. None: F_T and M_T are zero, for a glider, or for an unknown
        thrust, which is then part of the coefficients: throttle and airspeed as regressors explain
        it, and a simulation has ``thrust=None``.
    external_forces : sequence of str, default=()
        Further loads to subtract: "tether" means tether_x, tether_y, tether_z [N] and, where they
        exist, tether_l, tether_m, tether_n [N m], in body axes about the centre of gravity.
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
    flight = _measured(flight, ignore)
    check_flight(flight, ["time", *NEEDED])
    measured, rate_derivatives = _smoothed(flight, cutoff)
    thrust_force, thrust_moment = propulsive_loads(measured, aircraft, thrust)
    other_force, other_moment = external_loads(flight, external_forces)
    rates = measured[list(RATES)].to_numpy(float)
    total_force = aircraft.mass * measured[list(SPECIFIC_FORCE)].to_numpy(float)
    total_moment = rate_derivatives @ aircraft.inertia + gyroscopic_moment(rates, aircraft)
    # Equations 3 to 8: force, moment, coefficients.
    F_A = total_force - thrust_force - other_force
    M_A = total_moment - thrust_moment - other_moment
    qbar = dynamic_pressure(measured["airspeed"], measured["density"])[:, None]
    scale = qbar * aircraft.wing_area
    values = np.hstack([F_A / scale, M_A / (scale * aircraft.moment_lengths)])
    values[~np.isfinite(values).all(axis=1)] = np.nan
    return pd.DataFrame(values, columns=list(COEFFICIENTS), index=flight.index)


def _measured(flight: pd.DataFrame, ignore: Iterable[str]) -> pd.DataFrame:
    """Return the flight with NaN where a needed channel was not measured, and warn."""
    check_columns(check_table(flight), ["time", *NEEDED])
    ignored = {*ignore, *(name for name in POSSIBLE if name not in NEEDED)}
    faults = [fault for fault in find_faults(flight, ignored) if not fault.is_measured]
    if faults:
        numbers = {"faults": [fault.finding for fault in faults]}
        report(Finding(Code.FAULTS_EXCLUDED, numbers=numbers), FlightDataWarning, stacklevel=3)
    return without_faults(flight, faults)


def _smoothed(flight: pd.DataFrame, cutoff: float | str | None) -> tuple[pd.DataFrame, np.ndarray]:
    """Return the flight with smoothed channels, and the rate derivatives (n, 3)."""
    clock: dict[str, Any] = {
        "time": flight["time"].to_numpy(float),
        "flight": flight.get("flight"),
        "cutoff": cutoff,
    }
    names = ["airspeed", *SPECIFIC_FORCE, *RATES]
    is_measured = all(name in flight for name in RATE_DERIVATIVES)
    if is_measured:
        names += RATE_DERIVATIVES
    raw = flight[names].to_numpy(float)
    measured = flight.assign(**dict(zip(names, smooth(raw, **clock).T, strict=True)))
    if is_measured:
        return measured, measured[RATE_DERIVATIVES].to_numpy(float)
    return measured, differentiate(flight[list(RATES)].to_numpy(float), **clock)


def replay(
    flight: pd.DataFrame,
    aircraft: Aircraft,
    coefficients: pd.DataFrame | ArrayLike,
    *,
    horizon: float = 2.0,
    thrust: str | None = "auto",
    external_forces: Sequence[str] = (),
    gravity: float = STANDARD_GRAVITY,
) -> pd.DataFrame:
    """Return predicted coefficients integrated along a flight, restarting from the measured state every horizon.

    RK4 of `rigid_body_derivative` over the log's samples, with the loads of the predicted
    coefficients at the measured airspeed and density, the propulsive and external loads and
    gravity. Raises ValueError if a column is missing, shapes disagree, or a parameter is out of its
    range.

    Parameters
    ----------
    flight : pandas.DataFrame
        ``time``, ``airspeed``, ``density``, ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``;
        ``v_north``, ``v_east``, ``v_down``; ``north``, ``east``, ``down`` where measured;
        ``flight`` (id); the columns of the thrust.
    aircraft : Aircraft
        Mass, inertia and reference lengths.
    coefficients : array-like of shape (n, 6)
        CX CY CZ Cl Cm Cn at every row of the flight. Rows with NaN are not flown: windows end
        there.
    horizon : float, default=2.0
        Seconds from restart to restart.
    thrust, external_forces
        As for `aerodynamic_coefficients`.
    gravity : float, default=9.80665
        [m/s^2].

    Returns
    -------
    pandas.DataFrame
        Indexed as the flight: ``time``, ``flight`` (if present), ``horizon``,
        ``window`` (count of restarts), ``elapsed`` [s] since the restart, and the states (north,
        east, down where measured) v_north, v_east, v_down, phi, theta, psi, p, q, r. A row where
        one window ends and the next starts shows the end. Rows that are not flown are NaN, their
        window -1: rows without loads, and rows before the first complete state.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skdgp.dynamics import Aircraft, replay
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> flight = pd.DataFrame({"time": np.arange(101) * 0.02, "airspeed": 12.0, "density": 1.2, "phi": 0.0,
    ...                        "theta": 0.0, "psi": 0.0, "p": 0.0, "q": 0.0, "r": 0.0, "v_north": 12.0,
    ...                        "v_east": 0.0, "v_down": 0.0})
    >>> coefficients = np.tile([0.0, 0.02, -0.45, 0.0, 0.0, 0.0], (101, 1))
    >>> flown = replay(flight, glider, coefficients, thrust=None)
    >>> flown[["elapsed", "v_east"]].iloc[-1].round(2).to_dict()
    {'elapsed': 2.0, 'v_east': 0.86}
    """
    if not horizon > 0:
        raise ValueError(f"Got horizon={horizon!r}, but expected seconds > 0.")
    needed = ["time", "airspeed", "density", *EULER, *RATES, *EARTH_VELOCITY]
    segments = check_flight(flight, needed)
    values = coefficient_array(coefficients, len(flight))
    parts = (
        aerodynamic_loads(values, flight["airspeed"], flight["density"], aircraft),
        propulsive_loads(flight, aircraft, thrust),
        external_loads(flight, external_forces),
    )
    loads = np.sum([np.hstack(part) for part in parts], axis=0)  # (n, 6), all but gravity
    measured = table_states(flight)
    has_loads: Any = np.isfinite(loads).all(axis=1)
    runs = [
        slice(segment.start + run.start, segment.start + run.stop)
        for segment in segments
        for run in true_runs(has_loads[segment])
    ]
    is_complete: Any = np.isfinite(measured).all(axis=1)
    time = flight["time"].to_numpy(float)
    rows = restart_windows(time, runs, float(horizon), is_complete)
    states = _integrated(measured, loads, time, rows, aircraft, float(gravity))
    return _table(flight, rows, states, float(horizon))


def coefficient_array(coefficients: Any, n_samples: int) -> Array:
    """Return coefficients (n, 6), of a table by name; raise ValueError at another shape."""
    if hasattr(coefficients, "columns"):
        check_columns(coefficients, COEFFICIENTS, what="table of coefficients")
        coefficients = coefficients[list(COEFFICIENTS)]
    values = np.asarray(coefficients, dtype=float)
    if values.shape != (n_samples, 6):
        raise ValueError(
            f"Got coefficients of shape {values.shape}, but expected ({n_samples}, 6): "
            f"{', '.join(COEFFICIENTS)} at every row of the flight."
        )
    return values


def _table(flight: pd.DataFrame, rows: Indices, states: Array, horizon: float) -> pd.DataFrame:
    """Return the samples of all windows in the order of the flight; a shared row shows the end of its window."""
    window = np.broadcast_to(np.arange(len(rows))[:, None], rows.shape)
    time = flight["time"].to_numpy(float)
    columns = {"window": window, "elapsed": time[rows] - time[rows[:, :1]]} | channels(states)
    names = [name for name in POSITION if name in flight] + [*EARTH_VELOCITY, *EULER, *RATES]
    table = flight[[name for name in ("time", "flight") if name in flight]].assign(horizon=horizon)
    for name in ("window", "elapsed", *names):
        values = np.full(len(flight), -1 if name == "window" else np.nan)
        for samples in (slice(0, 1), slice(1, None)):
            values[rows[:, samples]] = columns[name][:, samples]
        table[name] = values
    for name in EULER:  # the turn nearest to the log's, which may count heading from 0 to 2 pi
        turns = np.round((flight[name].to_numpy(float) - table[name]) / (2 * np.pi))
        table[name] += 2 * np.pi * turns.fillna(0.0)
    return table.astype({"time": float, "window": int})


def _integrated(
    measured: Array, loads: Array, time: Array, rows: Indices, aircraft: Aircraft, gravity: float
) -> Array:
    """Return the states (n_windows, n_steps + 1, 13) of each window, its loads linear over every step."""
    states = np.empty((*rows.shape, 13))
    states[:, 0] = measured[rows[:, 0]]
    for k in range(rows.shape[1] - 1):
        first = rows[:, k]
        second = rows[:, k + 1]
        dt = (time[second] - time[first])[:, None]

        def rate_per_step(
            fraction: float, state: Array, first=first, second=second, dt=dt
        ) -> Array:
            load = (1 - fraction) * loads[first] + fraction * loads[second]
            return rigid_body_derivative(state, load[:, :3], load[:, 3:], aircraft, gravity) * dt

        states[:, k + 1] = rk4_step(rate_per_step, 0.0, states[:, k], 1.0)
    return states


def restart_windows(
    time: Array, runs: Iterable[slice], horizon: float, is_complete: Array
) -> Indices:
    """Return the rows of each window, (n_windows, n_steps + 1), shorter windows padded with their last row.

    A window starts at a row of a run whose measured state ``is_complete`` (n,) and ends at the last such row no
    more than ``horizon`` [s] later, where the next one starts; where there is none, it ends with
    the horizon.
    """
    complete = np.flatnonzero(is_complete)
    windows = [rows for run in runs for rows in _windows_of_run(time, run, horizon, complete)]
    if not windows:
        return np.empty((0, 1), dtype=int)
    length = max(map(len, windows))
    return np.stack([np.pad(rows, (0, length - len(rows)), mode="edge") for rows in windows])


def _windows_of_run(
    time: Array, run: slice, horizon: float, complete: Indices
) -> Iterator[Indices]:
    starts = complete[(complete >= run.start) & (complete < run.stop - 1)]
    k = 0
    while k < len(starts):
        start = starts[k]
        # A millionth of the horizon forgives the rounding of stored times.
        end = time[start] + horizon * (1 + 1e-6) + 1e-9
        last = max(run.start + int(np.searchsorted(time[run], end, side="right")) - 1, start + 1)
        following = int(np.searchsorted(starts, last, side="right")) - 1
        if following > k and last < run.stop - 1:
            last, k = starts[following], following
        else:
            k = int(np.searchsorted(starts, last))
        yield np.arange(start, last + 1)
