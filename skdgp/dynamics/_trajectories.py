"""Trajectories of a simulation: their table, warnings about them, and bands of an ensemble."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    AIR_DATA,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    RATE_DERIVATIVES,
    RATES,
    SENSOR_POSITION,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.frames import wrapped
from skdgp._flight.tables import by_name, check_columns
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._integrate import FLYING, REASONS, Trajectories, channels
from skdgp.dynamics._motion import Motion

BAND_COLUMNS = (*EARTH_VELOCITY, *EULER, *RATES, *AIR_DATA, "altitude", "north", "east")


class SimulationWarning(UserWarning):
    """A trajectory ended early, or left the range of the training data."""


def trajectory_table(
    record: Trajectories, motion: Motion, farthest: Array, first_times: Array
) -> pd.DataFrame:
    """Return the record as one flight table: path by path, start by start, row by row.

    The record's trajectories are (), (n_starts,) or (n_paths, n_starts); ``farthest``
    (n_times, ...) is as of `farthest_beyond`, ``first_times`` (n_starts,) the time at each start.
    """
    shape = record.ended.shape
    n_times = len(record.time)

    def column(values: Any) -> Array:
        """Return values (n_times, ...) of all trajectories, one after the other."""
        return np.moveaxis(np.broadcast_to(values, (n_times, *shape)), 0, -1).ravel()

    # a single trajectory has no axis of starts
    starts = first_times if shape else first_times[0]
    times = np.expand_dims(record.time, tuple(range(1, 1 + len(shape)))) + starts
    table: dict[str, Any] = {"time": column(times), **_identity(shape, n_times)}
    for name, values in _columns(record, motion.aircraft.mass).items():
        table[name] = column(values)
    if motion.aircraft.sensor_position is not None:
        # the specific force is that at the centre of gravity
        table |= dict.fromkeys(SENSOR_POSITION, 0.0)
    names = pd.Index(["", *motion.regressors])
    codes: Any = column(farthest)
    table["beyond"] = pd.Categorical.from_codes(codes, names)
    is_over = np.isnan(record.states).any(axis=-1)
    table["ended"] = pd.Categorical(column(np.where(is_over, record.ended, FLYING)))
    return pd.DataFrame(table)


def _columns(record: Trajectories, mass: float) -> dict[str, Array]:
    """Return the channels of a record by name, (n_times, ...) each."""
    columns = channels(record.states, record.wind)
    columns["density"] = record.instants.density
    columns |= by_name(RATE_DERIVATIVES, record.instants.derivative[..., rigid_body.RATES])
    columns |= by_name(SPECIFIC_FORCE, record.instants.force / mass)
    columns |= by_name(COEFFICIENTS, record.instants.coefficients)
    if record.wind is not None:
        columns |= by_name(WIND, record.wind)
    return columns | record.controls


def _identity(shape: tuple[int, ...], n_times: int) -> dict[str, Array]:
    """Return the columns that number the trajectories (), (n_starts,) or (n_paths, n_starts)."""
    columns = {"flight": np.arange(math.prod(shape))}
    for label, index in zip(("path", "start")[2 - len(shape) :], np.indices(shape), strict=True):
        columns[label] = index.ravel()
    return {name: np.repeat(numbers, n_times) for name, numbers in columns.items()}


def farthest_beyond(motion: Motion, regressors: Array) -> np.ndarray:
    """Return the 1-based index of the regressor (..., d) farthest outside its training range, 0 if none is outside.

    An excess of a fiftieth of the range counts as inside.
    """
    limits = motion.aerodynamics.limits
    if limits is None:
        return np.zeros(regressors.shape[:-1], dtype=int)
    low, high = limits
    width = np.maximum(high - low, np.finfo(float).tiny)
    outside = np.nan_to_num(np.maximum(low - regressors, regressors - high) / width, posinf=0.0)
    return np.where(outside.max(axis=-1) > 0.02, 1 + outside.argmax(axis=-1), 0)


def warn_of(record: Trajectories, motion: Motion, farthest: Array) -> None:
    """Warn of trajectories that ended early, and of those that left the training ranges.

    ``farthest`` (n_times, ...) is as of `farthest_beyond`.
    """
    has_ended = record.ended != FLYING
    if has_ended.any():
        reasons = ", ".join(REASONS[name] for name in np.unique(record.ended[has_ended]))
        warn(
            f"{has_ended.sum()} of {has_ended.size} trajectories ended early ({reasons}). Their rows are NaN from "
            "there on, and the column ended says why. Look at start, controls, wind and thrust; try a smaller dt.",
            SimulationWarning,
        )
    if farthest.any():
        left = [range_text(motion, int(k)) for k in np.unique(farthest[farthest > 0])]
        warn(
            f"{farthest.any(axis=0).sum()} of {has_ended.size} trajectories left what the model was learned from, in "
            f"{', '.join(left)}: the column beyond says where.",
            SimulationWarning,
        )


def range_text(motion: Motion, k: int) -> str:
    """Return the k-th regressor, from 1 on, with its training range, as text."""
    low, high = motion.aerodynamics.limits[:, k - 1]
    return f"{motion.regressors[k - 1]} (learned from {low:.3g} to {high:.3g})"


def trajectory_bands(
    trajectories: pd.DataFrame, level: float = 0.95, columns: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return the bands of an ensemble that `simulate` returned with ``n_paths``, by ``start`` and ``time``.

    ``level`` is the fraction of the flying paths inside: quantiles (1 - level) / 2
    and (1 + level) / 2. ``columns`` are by default velocities, angles (heading unwrapped), rates,
    airspeed, alpha, beta, altitude. The table has ``flying``, the share that has not ended, then
    the medians, ``<column>``, all ``<column>_low`` and all ``<column>_high``.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import trajectory_bands
    >>> paths = pd.DataFrame({"start": 0, "path": [0, 1, 2], "time": 0.0, "airspeed": [20.0, 21.0, 22.0], "ended": ""})
    >>> trajectory_bands(paths, level=1.0)[["airspeed", "airspeed_low", "airspeed_high"]].iloc[0].tolist()
    [21.0, 20.0, 22.0]
    """
    if not 0 < level <= 1:
        raise ValueError(f"Got level={level!r}, but expected a fraction above 0, at most 1.")
    what = "ensemble (simulate with n_paths=...)"
    check_columns(trajectories, ["start", "path", "time", "ended"], what=what)
    keys = ["start", "path", "time"]
    asked = dict.fromkeys(columns or BAND_COLUMNS)
    names = [name for name in asked if name in trajectories and name not in (*keys, "ended")]
    paths = trajectories[[*keys, *names]].assign(flying=(trajectories["ended"] == "").astype(float))
    for name in {*EULER} & {*names}:
        # without jumps, and near the first angle of the first path
        first = paths.groupby("start")[name].transform("first")
        paths[name] = wrapped((paths[name] - first).to_numpy())
        turns = paths.groupby(["start", "path"])[name].transform(np.unwrap)
        paths[name] = first + turns
    at_times = paths.groupby(["start", "time"], sort=False)
    edges = at_times[names]
    bands = [
        at_times[["flying"]].mean(),
        edges.median(),
        edges.quantile(0.5 - 0.5 * level).add_suffix("_low"),
        edges.quantile(0.5 + 0.5 * level).add_suffix("_high"),
    ]
    return pd.concat(bands, axis=1).reset_index()
