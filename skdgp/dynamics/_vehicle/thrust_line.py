"""The thrust line: from thrust to force and moment (the paper's equation 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["ThrustLine"]


@dataclass(frozen=True, eq=False)
class ThrustLine:
    """Where thrust acts and where it points, in body axes about the centre of gravity.

    Parameters
    ----------
    position : array-like of shape (3,)
        A point of the line: forward, right, down of the centre of gravity [m].
    direction : array-like of shape (3,)
        Where the force points; any length, stored as a unit vector. (1, 0, 0) is straight forward.

    Examples
    --------
    An engine .2 m above the centre of gravity pitches the nose down:

    >>> from skdgp.dynamics import ThrustLine
    >>> force, moment = ThrustLine(position=(-0.5, 0.0, -0.2), direction=(1, 0, 0)).loads(100.0)
    >>> force.tolist(), moment.tolist()
    ([100.0, 0.0, 0.0], [0.0, -20.0, 0.0])
    """

    position: ArrayLike = (0.0, 0.0, 0.0)
    direction: ArrayLike = (1.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("position", "direction"):
            object.__setattr__(self, name, _vector(getattr(self, name), name))
        length = np.linalg.norm(self.direction)
        if length == 0:
            raise ValueError("Got a thrust direction of length zero, but expected one such as (1, 0, 0).")
        object.__setattr__(self, "direction", self.direction / length)
        object.__setattr__(self, "_arm", np.cross(self.position, self.direction))

    def loads(self, thrust: ArrayLike, torque: ArrayLike = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return force (..., 3) [N] and moment (..., 3) [N m] about the centre of gravity.

        F_T = T d and M_T = r_T x F_T + Q d, with ``thrust`` T [N] and ``torque`` Q [N m] on the aircraft
        about the line's direction d (a propeller turning clockwise seen from behind gives Q < 0).
        """
        thrust, torque = (np.asarray(load, dtype=float)[..., None] for load in (thrust, torque))
        return thrust * self.direction, thrust * self._arm + torque * self.direction


def _vector(value: ArrayLike, name: str) -> np.ndarray:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        vector = np.array(np.nan)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"Got thrust-line {name} {value!r}, but expected three finite numbers (x, y, z).")
    vector.setflags(write=False)
    return vector
