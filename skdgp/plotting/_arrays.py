"""Validation of the arguments of displays."""

from __future__ import annotations

import numpy as np


def check_time(time, n_samples: int | None = None) -> np.ndarray:
    """Return ``time`` as finite floats, ``(n,)`` with n at least one."""
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size == 0 or not np.isfinite(time).all():
        raise ValueError(
            f"Got time of shape {time.shape} with {np.count_nonzero(~np.isfinite(time))} values that are not "
            "finite, but expected (n,) seconds, n at least 1: drop the rows without a time."
        )
    if n_samples is not None and len(time) != n_samples:
        raise ValueError(f"Got {len(time)} times for {n_samples} samples: give one per sample.")
    return time


def check_columns_of(values, shape: tuple[int, int] | None, what: str) -> np.ndarray:
    """Return ``values`` as floats ``(n, P)``; a vector is one column. NaN is allowed."""
    values = np.asarray(values, dtype=float)
    values = values[:, np.newaxis] if values.ndim == 1 else values
    if values.ndim != 2:
        raise ValueError(f"Got {what} of shape {values.shape}, but expected (n_samples, n_outputs).")
    if shape is not None and values.shape != shape:
        raise ValueError(
            f"Got {what} of shape {values.shape}, but expected {shape}, like the values it is compared with."
        )
    return values


def check_std(std, shape: tuple[int, int]) -> np.ndarray | None:
    """Return standard deviations ``(n, P)``, none negative; None stays None."""
    if std is None:
        return None
    std = check_columns_of(std, shape, "std")
    if np.any(std < 0):
        raise ValueError(f"Got standard deviations down to {np.nanmin(std):.3g}, but expected none below 0.")
    return std


def names_of(values, n_outputs: int, given=None, default=()) -> tuple[str, ...]:
    """Return the outputs' names: given, else the DataFrame's columns, else ``default``, else y0, y1, ..."""
    if given is None:
        columns = getattr(values, "columns", None)
        given = default if columns is None and len(default) == n_outputs else columns
    names = [f"y{i}" for i in range(n_outputs)] if given is None else [str(name) for name in given]
    if len(names) != n_outputs or len(set(names)) != n_outputs:
        raise ValueError(f"Got the names {names} for {n_outputs} outputs: give each output one name of its own.")
    return tuple(names)


def choose(names: tuple[str, ...], wanted) -> list[int]:
    """Return the positions of the ``wanted`` names; all, for None."""
    wanted = names if wanted is None else [wanted] if isinstance(wanted, str) else wanted
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise ValueError(f"Got the outputs {unknown}, but expected some of {list(names)}.")
    return [names.index(name) for name in wanted]
