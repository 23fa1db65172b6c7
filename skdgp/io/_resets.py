"""Resets of an estimator, by the log's own counters: corrected by the logged change, else the flight is cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.frames import without_sign_changes


@dataclass(frozen=True)
class ResetSettings:
    """Settings of the treatment of resets; guesses."""

    # a step is a jump beyond so many times what 95 % of the steps are
    jump: float = 4.0
    # rows this near to a cut [s] are left out: filters smear the jump
    margin: float = 0.25


RESETS = ResetSettings()


class Resets(NamedTuple):
    """Values after the resets were corrected, times of the others, and a remark."""

    values: Matrix
    cuts: list[float]
    remark: str


def correct_resets(
    columns: str,
    time: Vector,
    values: Matrix,
    counter: Vector,
    deltas: Matrix,
    is_attitude: bool,
) -> Resets:
    """Return the values (n, k) on the scale after the last reset, and the times where this is unknown.

    ``counter`` (n,) changes at a reset; the row of ``deltas`` there is the change of the values, of
    an attitude the quaternion that turns it.
    """
    if is_attitude:
        values = without_sign_changes(values)
    values = values.copy()
    sizes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    largest = RESETS.jump * np.quantile(sizes, 0.95) if len(sizes) else 0.0
    corrected = []
    cuts = []
    for k in (np.flatnonzero(np.diff(counter)) + 1).tolist():
        if sizes[k - 1] <= largest:
            continue
        moved = _turned(values[:k], deltas[k]) if is_attitude else values[:k] + deltas[k]
        # a change that is not logged is NaN
        if _distance(values[k], moved[-1], is_attitude) <= largest:
            values[:k] = moved
            corrected.append(float(time[k]))
        else:
            cuts.append(float(time[k]))
    remarks = []
    if corrected:
        remarks.append(f"corrected by its logged changes at {seconds(corrected)}")
    if cuts:
        remarks.append(f"not logged with a change, so a new flight begins, at {seconds(cuts)}")
    remark = f"{columns}: resets of the estimator, {'; '.join(remarks)}" if remarks else ""
    return Resets(values, cuts, remark)


def _distance(a: Vector, b: Vector, is_attitude: bool) -> float:
    """Return the distance of two vectors, or of two quaternions of either sign."""
    distance = np.linalg.norm(a - b)
    return float(min(distance, np.linalg.norm(a + b)) if is_attitude else distance)


def _turned(quaternions: Matrix, delta: Vector) -> Matrix:
    """Return quaternions (w, x, y, z) turned by another one, NaN if it is not known."""
    if not delta.any():
        return quaternions
    if not np.isfinite(delta).all():
        return np.full_like(quaternions, np.nan)
    turn = Rotation.from_quat(np.roll(delta, -1))
    turned = turn * Rotation.from_quat(np.roll(quaternions, -1, axis=1))
    return np.roll(turned.as_quat(), 1, axis=1)


def seconds(times: list[float]) -> str:
    """Return the first times as text."""
    more = f" and {len(times) - 5} more" if len(times) > 5 else ""
    return ", ".join(f"{time:.1f} s" for time in times[:5]) + more
