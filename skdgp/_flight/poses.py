"""Motion from noisy poses: velocity, acceleration and angular rates by a Kalman smoother of integrated white noise.

Three coordinates x of a body are measured with white noise of variance s^2. Their acceleration is a random walk in
axes C that may turn, so

    x' = v,    v' = C f + g,    f' = w,    w white with intensities k_i s^2, i = 1, 2, 3.

The estimate of least mean squared error is that of Rauch, Tung & Striebel (1965); where C is constant it is a smoothing
spline of degree 5 (Wahba 1978). Nothing is assumed of the start, so nothing is bent at the ends of a record. The k_i
maximise the likelihood in which s^2 and the start are integrated out, over all records together.

The states of all samples are solved for at once: their precision is block tridiagonal, and its Cholesky factor banded.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import linalg, optimize
from scipy.spatial.transform import Rotation

LEAST_SAMPLES = 10
"""Records with fewer samples are not differentiated."""
SMOOTHEST, ROUGHEST = np.log(1e-9), np.log(1e3)
"""Bounds of log k where a step is the unit of time: some 30 steps are averaged at most, a third of one at least."""
MOST_LEARNED = 4000
"""Samples that the intensities are learned from, about."""


PRECISION = np.array([[720.0, -360.0, 60.0], [-360.0, 192.0, -36.0], [60.0, -36.0, 9.0]])
"""Inverse of the covariance of (x, v, f) after a unit of time of white noise of unit intensity in f'."""

DIFFERENCE = 1e-3
"""Relative steps of the differences that the search for log k takes; the likelihood is rough in its last digits."""


class Motion(NamedTuple):
    """Estimates at each sample, (n, 3), and the standard deviation s of the noise."""

    x: np.ndarray
    v: np.ndarray
    f: np.ndarray
    noise: float


class Rotations(NamedTuple):
    """Attitude at each sample, body rates and their derivatives (n, 3) [rad/s, rad/s^2], and noise [rad]."""

    attitude: Rotation
    rates: np.ndarray
    accelerations: np.ndarray
    noise: float


def smooth_rotation(time: np.ndarray, attitude: Rotation, segments: list[slice]) -> Rotations:
    """Return the rotation of a body, each segment by itself, of noisy attitudes (body to earth) at times (n,).

    The turns from each sample to the next, log(R_k^-1 R_k+1), add up to coordinates whose rate is that of the body.
    They are those of the smoothed attitude, to which the measured one adds noise; so they are found in two passes.
    """
    smooth = attitude
    for _ in range(2):
        turned = np.zeros((len(time), 3))
        for each in segments:
            part = smooth[each]
            turned[each][1:] = np.cumsum((part[:-1].inv() * part[1:]).as_rotvec(), axis=0)
        motion = smooth_motion(time, turned + (smooth.inv() * attitude).as_rotvec(), segments)
        smooth = smooth * Rotation.from_rotvec(motion.x - turned)
    return Rotations(smooth, motion.v, motion.f, motion.noise)


def smooth_motion(
    time: np.ndarray, x: np.ndarray, segments: list[slice], *, axes: Rotation | None = None, gravity: float = 0.0
) -> Motion:
    """Return the motion of coordinates x (n, 3) at times (n,), each segment by itself.

    ``axes`` turn f into the axes of x, by default they are the same; ``gravity`` acts along the third of x.
    """
    step = float(np.median(np.concatenate([np.diff(time[each]) for each in segments])))
    axes = Rotation.identity(len(time)) if axes is None else axes
    records = [Record(time[each] / step, x[each], axes[each], gravity * step**2) for each in segments]
    log_k = _likeliest(records)
    states, misfits, _ = zip(*(record.solve(log_k) for record in records), strict=True)
    noise = np.sqrt(sum(misfits) / sum(record.degrees for record in records))
    position, velocity, force = np.moveaxis(np.concatenate(states), 1, 0)
    return Motion(position, velocity / step, force / step**2, float(noise))


def _likeliest(records: list[Record]) -> np.ndarray:
    """Return the log k (3,) of the largest likelihood, learned from records spread over all."""
    parts = [part for record in records for part in record.parts(MOST_LEARNED // 4)]
    every = max(1, sum(len(part.x) for part in parts) // MOST_LEARNED)
    parts = parts[::every]

    def cost(log_k: np.ndarray) -> float:
        return minus_log_likelihood(parts, log_k)

    start = min((np.full(3, level) for level in np.linspace(SMOOTHEST, ROUGHEST, 9)), key=cost)
    bounds = [(SMOOTHEST, ROUGHEST)] * 3
    options: Any = {"finite_diff_rel_step": DIFFERENCE, "ftol": 1e-7}
    return optimize.minimize(cost, start, method="L-BFGS-B", jac="3-point", bounds=bounds, options=options).x


def minus_log_likelihood(records: list[Record], log_k: np.ndarray) -> float:
    """Return minus twice the log likelihood of log k (3,), s^2 and the starts integrated out, but for a constant."""
    _, misfits, log_determinants = zip(*(record.solve(log_k) for record in records), strict=True)
    degrees = sum(record.degrees for record in records)
    steps = sum(len(record.x) - 1 for record in records)
    tiny = np.finfo(float).tiny
    return float(degrees * np.log(sum(misfits) + tiny) + sum(log_determinants) + 3 * steps * np.sum(log_k))


class Record:
    """Samples x (n, 3) at times (n,) in steps, and the axes of f; states are (x, v, f)."""

    def __init__(self, time: np.ndarray, x: np.ndarray, axes: Rotation, gravity: float) -> None:
        self.time, self.x, self.axes, self.gravity = time, x, axes, gravity
        self.degrees = x.size - 9
        h = np.diff(time)
        turn = (axes[:-1] * Rotation.from_rotvec((axes[:-1].inv() * axes[1:]).as_rotvec() / 2)).as_matrix()
        self._turns = np.stack([turn, turn, np.broadcast_to(np.eye(3), turn.shape)], axis=1)
        """Axes halfway through each step, in those of x, v and f: (n - 1, 3, 3, 3)."""
        self._fall = gravity * np.stack([h**2 / 2, h, 0 * h], axis=1)[:, :, None] * [0.0, 0.0, 1.0]
        flow = np.eye(3) + h[:, None, None] * np.eye(3, k=1) + h[:, None, None] ** 2 / 2 * np.eye(3, k=2)
        scale = h[:, None] ** [-2.5, -1.5, -0.5]
        self._flow, self._precision = flow, PRECISION * scale[:, :, None] * scale[:, None, :]

    def parts(self, longest: int) -> list[Record]:
        """Return the record cut into parts of at most ``longest`` samples."""
        cuts = np.array_split(np.arange(len(self.x)), -(-len(self.x) // longest))
        return [Record(self.time[rows], self.x[rows], self.axes[rows], self.gravity) for rows in cuts]

    def solve(self, log_k: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Return the states (n, 3, 3), the misfit over s^2, and the log determinant of the states' precision."""
        n, k = len(self.x), np.exp(log_k)
        turns = (self._turns / np.sqrt(k)).reshape(n - 1, 9, 3)
        turned = turns @ np.swapaxes(turns, 1, 2)
        across = -self._precision @ self._flow
        before = -np.swapaxes(self._flow, 1, 2) @ across
        # Weights of the next state, of the next with this one, and of this one, in the misfit of each step.
        after, across, before = (
            each.repeat(3, axis=1).repeat(3, axis=2) * turned for each in (self._precision, across, before)
        )
        diagonal = np.zeros((n, 9, 9))
        diagonal[1:] += after
        diagonal[:-1] += before
        diagonal[:, range(3), range(3)] += 1.0
        fall = self._fall.reshape(n - 1, 9, 1)
        target = np.zeros((n, 9))
        target[:, :3] = self.x - self.x[0]
        target[1:] += (after @ fall)[:, :, 0]
        target[:-1] += (np.swapaxes(across, 1, 2) @ fall)[:, :, 0]
        factor = linalg.cholesky_banded(_banded(diagonal, across), lower=True, check_finite=False)
        state = linalg.cho_solve_banded((factor, True), target.ravel(), check_finite=False).reshape(n, 3, 3)
        jumps = np.einsum("nsai,nsa->nsi", self._turns, state[1:] - self._fall) - self._flow @ np.einsum(
            "nsai,nsa->nsi", self._turns, state[:-1]
        )
        state[:, 0] += self.x[0]
        misfit = np.sum((state[:, 0] - self.x) ** 2) + np.einsum(
            "nsi,nst,nti,i->", jumps, self._precision, jumps, 1 / k
        )
        return state, float(misfit), float(2 * np.sum(np.log(factor[0])))


def _banded(diagonal: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix of blocks (n, 9, 9) and (n - 1, 9, 9) below them as `scipy.linalg` stores its bands."""
    n = len(diagonal)
    bands = np.zeros((18, n, 9))
    for column in range(9):
        bands[: 9 - column, :, column] = diagonal[:, column:, column].T
        bands[9 - column : 18 - column, :-1, column] = below[:, :, column].T
    return bands.reshape(18, 9 * n)
