"""Replay: predicted coefficients integrated to states along a recorded flight."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.linalg import covariance_root
from skdgp._compute.typing import Array, Indices
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import (
    BODY_VELOCITY,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
)
from skdgp._flight.checks import check_columns, check_flight
from skdgp._flight.clock import true_runs
from skdgp._flight.frames import cross_matrix, quaternion_to_matrix, wrapped
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._error_covariance import STATES, checked_std, state_deviations
from skdgp.dynamics._inputs import table_states
from skdgp.dynamics._loads import aerodynamic_loads, external_loads, propulsive_loads
from skdgp.dynamics._record import channels
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY, rigid_body_derivative, rk4_step

REPLAYED = (*POSITION, *EARTH_VELOCITY, *EULER, *RATES)


def replay(
    flight: pd.DataFrame,
    aircraft: Aircraft,
    coefficients: pd.DataFrame | ArrayLike,
    *,
    std: pd.DataFrame | ArrayLike | None = None,
    horizon: float | Sequence[float] = 2.0,
    correlation_time: float = 0.5,
    initial_std: Mapping[str, float] | None = None,
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
        ``v_north``, ``v_east``, ``v_down`` or ``u``, ``v``, ``w``; ``north``, ``east``, ``down``
        where known; ``flight`` (id); the columns of the thrust.
    aircraft : Aircraft
        Mass, inertia and reference lengths.
    coefficients : array-like of shape (n, 6)
        CX CY CZ Cl Cm Cn at every row of the flight. Rows with NaN are not flown: windows end
        there.
    std : array-like of shape (n, 6) or (n, 6, 6), optional
        Standard deviations of the coefficients, or their covariances across the six. Gives the
        bands.
    horizon : float or sequence of float, default=2.0
        Seconds from restart to restart.
    correlation_time : float, default=0.5
        Of the errors of the coefficients [s], whose correlation is ``exp(-|t - t'| /
        correlation_time)``. 0: every sample anew; ``numpy.inf``: one error for a whole window, the
        widest bands.
    initial_std : mapping of str to float, optional
        Standard deviations of the measured state at a restart, by name ("v_east", "phi", "p", ...).
    thrust, external_forces
        As for `aerodynamic_coefficients`.
    gravity : float, default=9.80665
        [m/s^2].

    Returns
    -------
    pandas.DataFrame
        Indexed as the flight, once per horizon: ``time``, ``flight`` (if present), ``horizon``,
        ``window`` (count of restarts), ``elapsed`` [s] since the restart, the states (north, east,
        down where known) v_north, v_east, v_down, phi, theta, psi, p, q, r, and, given ``std``,
        their standard deviations ``v_east_std``, ..., to first order, by ``std`` and
        ``initial_std`` alone. A row where one window ends and the next starts shows the end. Rows
        not flown are NaN, their window -1: those without loads, and those before the first whole
        state.

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
    >>> flown = replay(flight, glider, coefficients, std=np.full((101, 6), 1e-4), thrust=None)
    >>> flown[["elapsed", "v_east", "v_east_std"]].iloc[-1].round(2).to_dict()
    {'elapsed': 2.0, 'v_east': 0.86, 'v_east_std': 0.4}
    """
    horizons = np.atleast_1d(np.asarray(horizon, dtype=float))
    if not (horizons > 0).all() or not correlation_time >= 0:
        raise ValueError(
            f"Got horizon={horizon!r} and correlation_time={correlation_time!r}, but expected "
            f"seconds, the horizon > 0."
        )
    segments = check_flight(flight, ["time", "airspeed", "density", *EULER, "p", "q", "r"])
    path = _Path.of(flight, aircraft, coefficients, std, thrust, external_forces, float(gravity))
    uncertainty = [] if path.load_factor is None else [path.load_factor.reshape(len(flight), -1)]
    driven = np.isfinite(np.hstack([path.force, path.moment, *uncertainty])).all(axis=1)
    start_std, tables = checked_std(initial_std), []
    runs = [
        slice(part.start + r.start, part.start + r.stop)
        for part in segments
        for r in true_runs(driven[part])
    ]
    for h in horizons.tolist():
        rows = restart_windows(path.time, runs, h, known=np.isfinite(path.state.sum(axis=1)))
        states, std = _integrate(path, rows), None
        if path.load_factor is not None:
            steps = np.diff(path.time[rows]).T[..., None, None]
            samples, along = _error_rates(path, rows, states), np.swapaxes(states, 0, 1)
            found = state_deviations(samples, steps, start_std, along, correlation_time)
            std = np.stack(
                [each[:, [STATES.index(name) for name in REPLAYED]] for each in found], axis=1
            )
        tables.append(_table(flight, rows, states, std, h))
    return pd.concat(tables) if len(tables) > 1 else tables[0]


def replay_errors(
    trajectory: pd.DataFrame, flight: pd.DataFrame, *, suffix: str = ""
) -> pd.DataFrame:
    """Return how far a replay is from the flight: median absolute error of each state for each horizon.

    ``trajectory`` is what `replay` returned of ``flight``; ``suffix`` is added to the names of the
    flight's columns: "_true" compares with the truth of a simulation. The columns are ``state``,
    ``horizon`` [s], ``median`` (over all samples but the restarts), ``at_end`` (over the ends of
    full windows), ``spread`` (standard deviation of the measured state over the flight) and, where
    the replay has bands, ``coverage``: the share of samples within 1.96 standard deviations. Units
    are those of the states; angles the short way round.

    Examples
    --------
    >>> import pandas as pd
    >>> from skdgp.dynamics import replay_errors
    >>> flight = pd.DataFrame({"v_east": [0.0, 1.0, 2.0]})
    >>> flown = pd.DataFrame({"horizon": 1.0, "window": 0, "elapsed": [0.0, 0.5, 1.0], "v_east": [0.0, 1.1, 2.3]})
    >>> replay_errors(flown, flight).round(2)
        state  horizon  median  at_end  spread
    0  v_east      1.0     0.2     0.3    0.82
    """
    states = [name for name in REPLAYED if name in trajectory and name + suffix in flight]
    if not states:
        raise ValueError(
            f"The flight has none of the replayed states {list(REPLAYED)} with suffix {suffix!r}."
        )
    rows = []
    for horizon in trajectory["horizon"].unique().tolist():
        part = trajectory[trajectory["horizon"] == horizon]
        if len(part) != len(flight):
            raise ValueError(
                f"Got a replay of {len(part)} rows for a flight of {len(flight)}, but expected as "
                f"many."
            )
        elapsed = part["elapsed"].to_numpy()
        flown, ends = elapsed > 0, np.abs(elapsed - horizon) < 0.02 * horizon
        for state in states:
            measured = flight[state + suffix].to_numpy(float)
            error = part[state].to_numpy() - measured
            error = np.abs(wrapped(error) if state in EULER else error)
            known = measured[np.isfinite(measured)]
            if state in EULER:  # about the direction of the mean
                known = wrapped(known - np.angle(np.exp(1j * known).sum()))
            row = {"state": state, "horizon": horizon, "median": _nanmedian(error[flown])}
            row |= {
                "at_end": _nanmedian(error[ends]),
                "spread": float(known.std()) if known.size else np.nan,
            }
            if f"{state}_std" in part:
                seen = flown & np.isfinite(error)
                inside = error[seen] <= 1.96 * part[f"{state}_std"].to_numpy()[seen]
                row["coverage"] = float(inside.mean()) if inside.size else np.nan
            rows.append(row)
    return pd.DataFrame(rows)


class _Path(NamedTuple):
    """Loads and measured states of a flight, one row per sample."""

    time: Array  # (n,)
    force: Array  # (n, 3), all but gravity
    moment: Array  # (n, 3)
    state: Array  # (n, 13), measured
    load_factor: Any  # None, or (n, 6, 6), loads per unit of coefficient error

    aircraft: Aircraft
    gravity: float

    @classmethod
    def of(
        cls, flight: pd.DataFrame, aircraft: Aircraft, coefficients: Any, std: Any, thrust: str | None,
        external_forces: Sequence[str], gravity: float,
    ) -> _Path:  # fmt: skip
        airspeed, density = flight["airspeed"].to_numpy(float), flight["density"].to_numpy(float)
        loads = (
            aerodynamic_loads(
                _coefficient_array(coefficients, flight), airspeed, density, aircraft
            ),
            propulsive_loads(flight, aircraft, thrust),
            external_loads(flight, external_forces),
        )
        force, moment = (np.sum(parts, axis=0) for parts in zip(*loads, strict=True))
        load_factor = None
        if std is not None:
            per_coefficient = np.hstack(
                aerodynamic_loads(np.ones((len(flight), 6)), airspeed, density, aircraft)
            )
            load_factor = per_coefficient[:, :, None] * _covariance_factor(std, len(flight))
        measured = [
            names
            for names in (EARTH_VELOCITY, BODY_VELOCITY)
            if all(name in flight for name in names)
        ]
        velocity = measured[0] if measured else EARTH_VELOCITY
        check_columns(flight, velocity)
        state, time = table_states(flight, velocity), flight["time"].to_numpy(float)
        return cls(time, force, moment, state, load_factor, aircraft, gravity)


def _coefficient_array(coefficients: Any, flight: pd.DataFrame) -> Array:
    if hasattr(coefficients, "columns"):
        check_columns(coefficients, COEFFICIENTS, what="table of coefficients")
        coefficients = coefficients[list(COEFFICIENTS)]
    values = np.asarray(coefficients, dtype=float)
    if values.shape != (len(flight), 6):
        raise ValueError(
            f"Got coefficients of shape {values.shape}, but expected ({len(flight)}, 6): "
            f"{', '.join(COEFFICIENTS)} at "
            "every row of the flight."
        )
    return values


def _table(
    flight: pd.DataFrame, rows: Indices, states: Array, std: Array | None, horizon: float
) -> pd.DataFrame:
    """Return the samples of all windows in the order of the flight; a shared row shows the end of its window."""
    seen = channels(states)
    flown = np.stack([seen[name] for name in REPLAYED], axis=-1)
    time, n = flight["time"].to_numpy(float), len(flight)
    columns = {
        "window": np.full(n, -1),
        "elapsed": np.full(n, np.nan),
        "states": np.full((n, 12), np.nan),
    }
    window = np.broadcast_to(np.arange(len(rows))[:, None], rows.shape)
    values = {"window": window, "elapsed": time[rows] - time[rows[:, :1]], "states": flown}
    if std is not None:
        columns["std"], values["std"] = np.full((n, 12), np.nan), std
    for samples in (slice(0, 1), slice(1, None)):
        for name, column in columns.items():
            column[rows[:, samples]] = values[name][:, samples]
    table = pd.DataFrame({"time": time}, index=flight.index)
    if "flight" in flight:
        table["flight"] = flight["flight"]
    table = table.assign(horizon=horizon, window=columns["window"], elapsed=columns["elapsed"])
    measured = flight[list(EULER)].to_numpy(float)
    angles = columns["states"][:, 6:9]
    # The turn nearest to the log's, which may count heading from 0 to 2 pi: the two can be drawn
    # together.
    angles += 2 * np.pi * np.nan_to_num(np.round((measured - angles) / (2 * np.pi)))
    known = [k for k, name in enumerate(REPLAYED) if k >= 3 or name in flight]
    table[[REPLAYED[k] for k in known]] = columns["states"][:, known]
    if std is not None:
        table[[f"{REPLAYED[k]}_std" for k in known]] = columns["std"][:, known]
    return table


def _integrate(path: _Path, rows: Indices) -> Array:
    """Return the states (n_windows, n_steps + 1, 13) of each window, its loads linear over every step."""
    states = np.empty((*rows.shape, 13))
    states[:, 0] = path.state[rows[:, 0]]
    for k in range(rows.shape[1] - 1):
        here, there = rows[:, k], rows[:, k + 1]
        dt = (path.time[there] - path.time[here])[:, None]

        def rate_per_step(fraction: float, state: Array, here=here, there=there, dt=dt) -> Array:
            force, moment = (
                (1 - fraction) * load[here] + fraction * load[there]
                for load in (path.force, path.moment)
            )
            return rigid_body_derivative(state, force, moment, path.aircraft, path.gravity) * dt

        states[:, k + 1] = rk4_step(rate_per_step, 0.0, states[:, k], 1.0)
    return states


def _error_rates(path: _Path, rows: Indices, states: Array) -> Iterator[tuple[Array, Array]]:
    """Yield A (n_windows, 12, 12) and B (n_windows, 12, 6) of every sample: the loads do not depend on the state."""
    P, V, T, W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
    inertia, inverse = path.aircraft.inertia, path.aircraft.inertia_inverse
    for k in range(rows.shape[1]):
        state, load_factor = states[:, k], path.load_factor[rows[:, k]]
        rotation = quaternion_to_matrix(state[:, ATTITUDE])
        velocity, omega = cross_matrix(state[:, VELOCITY]), cross_matrix(state[:, rigid_body.RATES])
        A, B = np.zeros((len(state), 12, 12)), np.zeros((len(state), 12, 6))
        A[:, P, V], A[:, P, T] = rotation, -rotation @ velocity
        A[:, V, V], A[:, V, W] = -omega, velocity
        A[:, V, T] = cross_matrix(path.gravity * rotation[:, 2])
        A[:, T, T], A[:, T, W] = -omega, np.eye(3)
        A[:, W, W] = inverse @ (
            cross_matrix(state[:, rigid_body.RATES] @ inertia) - omega @ inertia
        )
        B[:, V], B[:, W] = load_factor[:, :3] / path.aircraft.mass, inverse @ load_factor[:, 3:]
        yield A, B


def _nanmedian(values: Array) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan


def _covariance_factor(std: ArrayLike, n_samples: int) -> Array:
    """Return L (n, 6, 6) with L L^T the covariance of the coefficients, of std (n, 6) or covariance (n, 6, 6)."""
    values = np.asarray(std, dtype=float)
    if values.shape not in ((n_samples, 6), (n_samples, 6, 6)):
        raise ValueError(
            f"Got std of shape {values.shape}, but expected ({n_samples}, 6), standard deviations "
            f"of "
            f"{', '.join(COEFFICIENTS)} at each sample, or ({n_samples}, 6, 6), their covariances."
        )
    if values.ndim == 2:
        if (values < 0).any():
            raise ValueError("Got negative values in std, but expected standard deviations >= 0.")
        return values[:, :, None] * np.eye(6)
    good = np.isfinite(values).all(axis=(1, 2))
    eigenvalues = np.linalg.eigvalsh(values[good])
    if (eigenvalues < -1e-8 * np.abs(eigenvalues).max(axis=1, initial=0.0, keepdims=True)).any():
        raise ValueError(
            "Got covariances with negative eigenvalues in std, but expected positive "
            "semi-definite ones."
        )
    factor = np.full_like(values, np.nan)
    factor[good] = covariance_root(values[good])
    return factor


def restart_windows(
    time: Array, runs: Iterable[slice], horizon: float, known: np.ndarray | None = None
) -> Indices:
    """Return the rows of each window, (n_windows, n_steps + 1), shorter windows padded with their last row.

    A window starts at a row of a run whose state is ``known`` (n,) and ends at the last such row no
    more than ``horizon`` [s] later, where the next one starts; where there is none, it ends with
    the horizon.
    """
    known = np.ones(len(time), dtype=bool) if known is None else known
    windows = [
        window
        for run in runs
        for window in _windows_of_run(time, run, horizon, np.flatnonzero(known))
    ]
    if not windows:
        return np.empty((0, 1), dtype=int)
    length = max(map(len, windows))
    return np.stack([np.pad(rows, (0, length - len(rows)), mode="edge") for rows in windows])


def _windows_of_run(time: Array, run: slice, horizon: float, known: Indices) -> Iterator[Indices]:
    starts = known[(known >= run.start) & (known < run.stop - 1)]
    at = 0
    while at < len(starts):
        start = starts[at]
        # A millionth of the horizon forgives the rounding of stored times.
        end = time[start] + horizon * (1 + 1e-6) + 1e-9
        last = max(run.start + int(np.searchsorted(time[run], end, side="right")) - 1, start + 1)
        following = int(np.searchsorted(starts, last, side="right")) - 1
        if following > at and last < run.stop - 1:
            last, at = starts[following], following
        else:
            at = int(np.searchsorted(starts, last))
        yield np.arange(start, last + 1)
