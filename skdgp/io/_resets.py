"""Resets of an estimator, by the log's own counters, at which a flight is cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skdgp._compute.typing import Matrix, Vector


@dataclass(frozen=True)
class ResetSettings:
    """Settings of the treatment of resets; guesses."""

    # a step is a jump beyond so many times what 95 % of the steps are
    jump: float = 4.0
    # rows this near to a cut [s] are left out: filters smear the jump
    margin: float = 0.25


RESETS = ResetSettings()


def reset_times(time: Vector, values: Matrix, counter: Vector) -> list[float]:
    """Return the times at which a counter (n,) changes and the values (n, k) jump."""
    sizes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    if not len(sizes):
        return []
    is_jump = sizes > RESETS.jump * np.quantile(sizes, 0.95)
    return time[1:][is_jump & (np.diff(counter) != 0)].tolist()


def seconds(times: list[float]) -> str:
    """Return the first times as text."""
    more = f" and {len(times) - 5} more" if len(times) > 5 else ""
    return ", ".join(f"{time:.1f} s" for time in times[:5]) + more
