"""Motion from noisy poses: velocity, acceleration and angular rates by penalised splines.

Three coordinates x (n, 3) of a body are measured with white noise of variance s^2. They are splines of degree 5 with a
knot at each step of the clock. Their acceleration is C f + g, with axes C that may turn. The coefficients of x'' are
second differences of those of x, and give f at the knots,

    f_j = C_j^T ((c_j - 2 c_j+1 + c_j+2) - g),        f_j - 2 f_j+1 + f_j+2 ~ N(0, s^2 diag(k_1, k_2, k_3)).

For constant C this is the P-spline of Eilers & Marx (1996) with fourth differences. Nothing is assumed of the start and
the end of a record, so nothing is bent there. The k_i maximise the likelihood of all records together, in which s^2 and
all that no difference restrains are integrated out (Wahba 1985).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import linalg, optimize, sparse
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation, Slerp

LEAST_SAMPLES = 10  # records with fewer samples are not differentiated
DEGREE = 5
BANDS = 3 * (DEGREE + 1)
SMOOTHEST, ROUGHEST = np.log(1e-12), np.log(1e2)  # bounds of log k: means of about 30 steps, or hardly any
MOST_LEARNED = 10000  # samples that k is learned from, about
DIFFERENCE = 1e-3  # relative step in the search for log k, as the last digits of the likelihood are rough


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
    fits = [record.fit(log_k) for record in records]
    noise = np.sqrt(sum(fit.misfit for fit in fits) / sum(record.degrees for record in records))
    motions = [record.motion(fit.coefficients) for record, fit in zip(records, fits, strict=True)]
    position, velocity, force = (np.concatenate(parts) for parts in zip(*motions, strict=True))
    return Motion(position, velocity / step, force / step**2, float(noise))


def _likeliest(records: list[Record]) -> np.ndarray:
    """Return the log k (3,) of the largest likelihood, learned from parts of all records drawn by chance."""
    parts = [part for record in records for part in record.parts(MOST_LEARNED // 10)]
    share = min(1.0, MOST_LEARNED / sum(len(part.x) for part in parts))
    drawn = np.random.default_rng(0).permutation(len(parts))[: int(np.ceil(share * len(parts)))]
    parts = [parts[i] for i in np.sort(drawn)]

    def cost(log_k: np.ndarray) -> float:
        return minus_log_likelihood(parts, log_k)

    start = min((np.full(3, level) for level in np.linspace(SMOOTHEST, ROUGHEST, 9)), key=cost)
    bounds = [(SMOOTHEST, ROUGHEST)] * 3
    options: Any = {"finite_diff_rel_step": DIFFERENCE, "ftol": 1e-10}
    return optimize.minimize(cost, start, method="L-BFGS-B", jac="3-point", bounds=bounds, options=options).x


def minus_log_likelihood(records: list[Record], log_k: np.ndarray) -> float:
    """Return minus twice the log likelihood of log k (3,) but for a constant."""
    fits = [record.fit(log_k) for record in records]
    degrees = sum(record.degrees for record in records)
    misfit = sum(fit.misfit for fit in fits) + np.finfo(float).tiny
    differences = sum(record.counts[1] for record in records)
    return float(degrees * np.log(misfit) + sum(fit.log_determinant for fit in fits) + differences * np.sum(log_k))


class PoseFit(NamedTuple):
    """Coefficients of a record (K, 3), their misfit over s^2, and the log determinant of their precision times s^2."""

    coefficients: np.ndarray
    misfit: float
    log_determinant: float


class Record:
    """Samples x (n, 3) at times (n,) in steps, and the axes of f."""

    def __init__(self, time: np.ndarray, x: np.ndarray, axes: Rotation, gravity: float) -> None:
        self.time, self.x, self.axes, self.gravity = time, x, axes, gravity
        self.degrees = x.size - 12
        intervals = int(np.ceil(time[-1] - time[0] - 1e-6))
        self.step = (time[-1] - time[0]) / intervals
        self.knots = time[0] + self.step * np.arange(-DEGREE, intervals + DEGREE + 1)
        inside = np.clip(time, *self.knots[[DEGREE, -DEGREE - 1]])
        basis = sparse.kron(BSpline.design_matrix(inside, self.knots, DEGREE), sparse.eye(3), "csr")
        at_knots = Slerp(time, axes)(np.clip(self.knots[4:-4], time[0], time[-1]))
        turns = sparse.block_diag(list(at_knots.inv().as_matrix()), "csr")
        size = len(self.knots) - DEGREE - 1
        force = turns @ _second_differences(size) / self.step**2
        differences = _second_differences(size - 2)
        fall = differences @ (turns @ np.tile([0.0, 0.0, gravity], size - 2))
        rows = [basis, *((differences @ force)[axis::3] for axis in range(3))]
        self._bands = [_bands(each.T @ each) for each in rows]
        self.counts = [each.shape[0] for each in rows]
        self._rows = sparse.vstack(rows, "csr")
        self._columns = self._rows.T.tocsr()
        self._values = np.concatenate([(x - x[0]).ravel(), *(fall[axis::3] for axis in range(3))])

    def parts(self, longest: int) -> list[Record]:
        """Return the record cut into parts of at most ``longest`` samples."""
        cuts = np.array_split(np.arange(len(self.x)), -(-len(self.x) // longest))
        if len(cuts) == 1:
            return [self]
        return [Record(self.time[rows], self.x[rows], self.axes[rows], self.gravity) for rows in cuts]

    def fit(self, log_k: np.ndarray) -> PoseFit:
        """Return the coefficients of the least misfit |x - B c|^2 + sum_i |D_i c - d_i|^2 / k_i."""
        weights = [1.0, *np.exp(-np.asarray(log_k))]
        precision = sum(weight * bands for weight, bands in zip(weights, self._bands, strict=True))
        factor = linalg.cholesky_banded(precision, lower=True, overwrite_ab=True, check_finite=False)
        found, left, of_row = np.zeros(self._rows.shape[1]), self._values, np.repeat(weights, self.counts)
        for _ in range(3):  # refined, as the precision may be ill-conditioned
            target = self._columns @ (of_row * left)
            found = found + linalg.cho_solve_banded((factor, True), target, check_finite=False)
            left = self._values - self._rows @ found
        misfit = float(of_row @ left**2)
        return PoseFit(found.reshape(-1, 3) + self.x[0], misfit, float(2 * np.sum(np.log(factor[0]))))

    def motion(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, v and f at the samples."""
        spline = BSpline(self.knots, coefficients, DEGREE)
        acceleration = spline(self.time, 2) - [0.0, 0.0, self.gravity]
        return spline(self.time), spline(self.time, 1), self.axes.inv().apply(acceleration)


def _second_differences(size: int) -> sparse.csr_matrix:
    """Return the matrix of second differences of ``size`` vectors of three components."""
    each = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))
    return sparse.kron(each, sparse.eye(3), "csr")


def _bands(symmetric: sparse.csr_matrix) -> np.ndarray:
    """Return a banded symmetric matrix as `scipy.linalg` stores it, its lower part."""
    return np.array([np.pad(symmetric.diagonal(-band), (0, band)) for band in range(BANDS)])
