"""Trajectories as flight tables, and the bands of an ensemble."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.checks import check_columns
from skdgp._flight.frames import air_data, body_to_ned, ned_to_body, quaternion_to_euler, unwrapped_paths
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY

BEYOND = 0.02
"""Share of its range by which a regressor may exceed what was flown without a warning."""
TINY = 1e-12
REASONS = {
    "airspeed": "airspeed under 1 m/s",
    "altitude": "outside of the atmosphere",
    "diverged": "diverged",
    "fixed point": "no fixed point of the regressors that follow from the loads",
}


class SimulationWarning(UserWarning):
    """A trajectory ended early, or left the range of the training data."""


def channels(states: Array, wind: Array | None = None) -> dict[str, Array]:
    """Return the columns of the vocabulary that follow from states (..., 13) in a ``wind`` (..., 3), each (...)."""
    attitude = states[..., ATTITUDE]
    earth, angles = body_to_ned(attitude, states[..., VELOCITY]), quaternion_to_euler(attitude)
    air = states[..., VELOCITY] if wind is None else states[..., VELOCITY] - ned_to_body(attitude, wind)
    groups = {POSITION: states[..., rigid_body.POSITION], EARTH_VELOCITY: earth, BODY_VELOCITY: states[..., VELOCITY]}
    groups |= {EULER: angles, RATES: states[..., rigid_body.RATES]}
    found = {name: values[..., k] for names, values in groups.items() for k, name in enumerate(names)}
    found |= dict(zip(AIR_DATA, air_data(air), strict=True))
    return found | {"altitude": -states[..., 2]}


def trajectory_table(record: Any, motion: Motion, first_times: Array, further: dict[str, Array]) -> pd.DataFrame:
    """Return what was flown as one flight table: path by path, start by start, row by row.

    The record's trajectories are (), (n_starts,) or (n_paths, n_starts); ``first_times`` (n_starts,) is the time at
    each start, ``further`` holds more columns (n_times, ...).
    """
    shape = record.ended.shape
    n_times = len(record.time)
    wind = record.wind

    def column(values: Array) -> Array:
        return np.moveaxis(np.broadcast_to(values, (n_times, *shape)), 0, -1).ravel()

    over = np.arange(n_times).reshape(-1, *[1] * len(shape)) >= record.end
    seen = channels(record.states, wind) | {"density": record.density}
    for k, name in enumerate(("p_dot", "q_dot", "r_dot")):
        seen[name] = record.derivative[..., rigid_body.RATES][..., k]
    for names, values in ((SPECIFIC_FORCE, record.specific_force), (COEFFICIENTS, record.coefficients)):
        seen |= {name: values[..., k] for k, name in enumerate(names)}
    if wind is not None:
        seen |= {name: wind[..., k] for k, name in enumerate(WIND)}
    clock = np.add.outer(record.time, first_times)
    table: dict[str, Any] = {"time": column(clock[:, None] if len(shape) == 2 else clock.reshape(n_times, *shape))}
    table |= _identity(shape, n_times)
    table |= {name: column(values) for name, values in (seen | record.controls | further).items()}
    farthest = np.array(["", *motion.regressors], dtype=object)[column(beyond(motion, record.regressors))]
    table["beyond"] = pd.Categorical(farthest, ["", *motion.regressors])
    table["ended"] = pd.Categorical(column(np.where(over, record.ended, "")))
    return pd.DataFrame(table)


def _identity(shape: tuple[int, ...], n_times: int) -> dict[str, Any]:
    """Return the columns that name the trajectories."""
    if not shape:
        return {"flight": pd.Categorical(["simulation"] * n_times)}
    *paths, starts = np.indices(shape).reshape(len(shape), -1)
    names = [f"start {start}" for start in starts]
    if paths:
        several = shape[1] > 1
        names = [f"path {p}, {name}" if several else f"path {p}" for p, name in zip(*paths, names, strict=True)]
    found: dict[str, Any] = {"flight": pd.Categorical(np.repeat(names, n_times), names)}
    found["start"] = np.repeat(starts, n_times)
    return found | ({"path": np.repeat(paths[0], n_times)} if paths else {})


def beyond(motion: Motion, regressors: Array) -> np.ndarray:
    """Return 1 + the one of the regressors (..., d) that is farthest outside of what was flown, 0 where none is."""
    limits = motion.aerodynamics.limits
    if limits is None:
        return np.zeros(regressors.shape[:-1], dtype=int)
    low, high = limits
    outside = np.maximum(low - regressors, regressors - high) / np.maximum(high - low, TINY)
    outside = np.where(np.isfinite(outside), outside, 0.0)
    return np.where(outside.max(axis=-1) > BEYOND, 1 + outside.argmax(axis=-1), 0)


def warn_of(record: Any, motion: Motion) -> None:
    """Warn of trajectories that ended early, and of those that left what the model was learned from."""
    ended = [reason for reason in record.ended.ravel().tolist() if reason]
    n, dt = record.ended.size, record.time[1]
    if ended:
        why = ", ".join(f"{REASONS[reason]}: {ended.count(reason)}" for reason in REASONS if reason in ended)
        warnings.warn(
            f"{len(ended)} of {n} trajectories ended early, the first {record.end.min() * dt:.2f} s after its start "
            f"({why}). Their rows are NaN from there on, and the column ended says why. Look at start, controls, wind "
            "and thrust; try a smaller dt.",
            SimulationWarning,
            stacklevel=3,
        )
    outside, limits = beyond(motion, record.regressors).reshape(len(record.time), -1), motion.aerodynamics.limits
    if limits is not None and outside.any():
        first = int(np.flatnonzero(outside.any(axis=1))[0])
        k = int(outside[first].max()) - 1
        (low, high), values = limits[:, k], record.regressors[..., k]
        warnings.warn(
            f"{np.count_nonzero(outside.any(axis=0))} of {n} trajectories left what the model was learned from, the "
            f"first {first * dt:.2f} s after its start in {motion.aerodynamics.regressors[k]} (here "
            f"{np.nanmin(values):.3g} to {np.nanmax(values):.3g}, learned from {low:.3g} to {high:.3g}): the column "
            "beyond says where.",
            SimulationWarning,
            stacklevel=3,
        )


def trajectory_bands(
    trajectories: pd.DataFrame, level: float = 0.95, columns: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return the bands of an ensemble that `simulate` returned with ``n_paths``, by ``start`` and ``time``.

    ``level`` is the share of the paths inside, of those that still fly: quantiles (1 - level) / 2 and (1 + level) / 2.
    ``columns`` are by default velocities, angles (heading unwrapped), rates, airspeed, alpha, beta, altitude. The table
    has ``<column>`` (the median), ``<column>_low``, ``<column>_high``, and ``flying``, the share that has not ended.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import trajectory_bands
    >>> paths = pd.DataFrame({"start": 0, "path": [0, 1, 2], "time": 0.0, "airspeed": [20.0, 21.0, 22.0], "ended": ""})
    >>> trajectory_bands(paths, level=1.0)[["airspeed", "airspeed_low", "airspeed_high"]].iloc[0].tolist()
    [21.0, 20.0, 22.0]
    """
    if not 0 < level <= 1:
        raise ValueError(f"Got level={level!r}, but expected a share between 0 and 1.")
    check_columns(trajectories, ["start", "path", "time", "ended"], what="ensemble (simulate with n_paths=...)")
    wanted = (*EARTH_VELOCITY, *EULER, *RATES, *AIR_DATA, "altitude", "north", "east") if columns is None else columns
    names = [name for name in wanted if name in trajectories]
    rows = []
    for start, part in trajectories.groupby("start", sort=False):
        n_paths = part["path"].nunique()
        flying = (part["ended"] == "").to_numpy().reshape(n_paths, -1).mean(axis=0)
        band = {"start": start, "time": part["time"].to_numpy()[: len(flying)], "flying": flying}
        for name in names:
            values = part[name].to_numpy(float).reshape(n_paths, -1)
            if name in EULER:
                values = unwrapped_paths(values)
            low, middle, high = path_quantiles(values, level)
            band |= {name: middle, f"{name}_low": low, f"{name}_high": high}
        rows.append(pd.DataFrame(band))
    return pd.concat(rows, ignore_index=True)


def path_quantiles(values: Array, level: float) -> Array:
    """Return the lower edge, the median and the upper edge over the paths that still fly, (3, n_times)."""
    found = np.full((3, values.shape[1]), np.nan)
    some = np.isfinite(values).any(axis=0)
    found[:, some] = np.nanquantile(values[:, some], [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level], axis=0)
    return found
