"""flight_from_poses: noisy position and attitude, as of motion capture, to a flight table, by penalised splines.

Three coordinates x (n, 3) of a body are measured with white noise of variance s^2. They are splines
of degree 5 with a knot at each step of the clock. Their acceleration is C f + g, with axes C that
may turn. The coefficients of x'' are second differences of those of x, and give f at the knots,

    f_j = C_j^T ((c_j - 2 c_j+1 + c_j+2) - g),        f_j - 2 f_j+1 + f_j+2 ~ N(0, s^2 diag(k_1, k_2, k_3)).

For constant C this is the P-spline of Eilers & Marx (1996) with fourth differences. Nothing is
assumed of the start and the end of a record, so nothing is bent there. The k_i maximise the
likelihood of all records together, in which s^2 and all that no difference restrains are integrated
out (Wahba 1985).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import linalg, optimize, sparse
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation, Slerp

from skdgp._flight.atmosphere import STANDARD_GRAVITY, standard_density
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.clock import flight_segments
from skdgp._flight.faults import NOT_MEASURED, faults_message, find_faults
from skdgp._flight.frames import air_data, quaternion_to_euler
from skdgp.io._tables import check_magnitudes

LEAST_SAMPLES = 10  # records with fewer samples are not differentiated
DEGREE = 5
BANDS = 3 * (DEGREE + 1)
SMOOTHEST, ROUGHEST = (
    np.log(1e-12),
    np.log(1e2),
)  # bounds of log k: means of about 30 steps, or hardly any
MOST_LEARNED = 10000  # samples that k is learned from, about
DIFFERENCE = (
    1e-3  # relative step in the search for log k, as the last digits of the likelihood are rough
)
UPRIGHT, TURNED = Rotation.identity(), Rotation.from_euler("x", np.pi)
EARTH = {
    "NED": UPRIGHT,
    "NWU": TURNED,
    "ENU": Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
}
BODY = {"FRD": UPRIGHT, "FLU": TURNED}
FRAMES = {f"{earth}/{body}": (EARTH[earth], BODY[body]) for earth in EARTH for body in BODY}
"""Earth and body axes of the poses: their rotations to north-east-down and from forward-right-down.
"""
GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY])
UNIT = 1e-2  # quaternions are of length 1 but for this
MOST_REPEATS = (
    0.3  # share of rows that repeat the one before, from which poses are those of a slower sensor
)
LARGEST_FORCE = 300.0  # median of specific force [m/s^2] beyond which positions are not in metres
SLOW = 1.0  # mean speed [m/s] below which nothing flies
UNEXPLAINED, CLEARLY = 0.5, 0.5
"""A frame is refused if its side force is less well explained [m/s^2], and that of another by less
than this share.
"""
UNSURE = (
    0.05  # frames whose unexplained side forces differ by less [m/s^2] are named together; a guess
)


def flight_from_poses(
    time: ArrayLike,
    position: ArrayLike,
    quaternion: ArrayLike,
    *,
    frame: str,
    flight: ArrayLike | str = "flight",
    controls: Mapping[str, ArrayLike] | pd.DataFrame | None = None,
    wind: ArrayLike | None = None,
    altitude: float = 0.0,
) -> pd.DataFrame:
    r"""Return a flight table of poses: positions and attitudes, such as those of motion capture.

    A smoother without delay differentiates the poses; it learns their noise by maximum likelihood
    (Wahba 1985). Body rates are those of the rotation from each attitude to the next. With R from
    body to earth, gravity g, and wind W,

    .. math:: f = R^T (\dot v - g), \qquad v_a = R^T (v - W),

    f is the specific force, and the velocity through the air :math:`v_a` gives airspeed, alpha and
    beta. Each flight, and each part between gaps, is differentiated by itself; the first and last
    0.1 s are two to four times less accurate. Raises ValueError if shapes do not match, a value is
    not finite, time does not increase, quaternions are not of length 1, a flight has fewer than 10
    samples between gaps, poses repeat or leap, positions are not in metres, or the motion
    contradicts the frame: lift, forward flight, or the side to which it turns.

    Parameters
    ----------
    time : array-like of shape (n,)
        Time [s], increasing within a flight.
    position : array-like of shape (n, 3)
        Position of the centre of gravity along the earth axes [m].
    quaternion : array-like of shape (n, 4)
        Attitude, body to earth, scalar first; of either sign.
        :func:`skdgp.dynamics.euler_to_quaternion` gives it of Euler angles.
    frame : {"NED/FRD", "NED/FLU", "NWU/FRD", "NWU/FLU", "ENU/FRD", "ENU/FLU"}
        Earth and body axes of the poses: north, east, down, west, up; forward, right, down, left,
        up. Another horizontal direction may stand for north.
    flight : str or array-like of shape (n,), default="flight"
        Identifiers of flights.
    controls : mapping or DataFrame, optional
        Further columns (n,): surfaces, throttle, propeller speed, in the units and signs of the
        vocabulary.
    wind : array-like of 3 floats, optional
        Velocity of the air, north, east, down [m/s]. By default the air is still, as in a hall.
    altitude : float, default=0.0
        Altitude of the origin of the positions above mean sea level [m], for the density.

    Returns
    -------
    DataFrame
        ``time``, ``flight``, air data, rates and angular accelerations, specific force, velocities,
        Euler angles, position, altitude, density, and ``controls``. ``attrs["pose_noise"]``: noise
        of position [m], attitude [rad].

    Examples
    --------
    A turn to the left, recorded by motion capture:

    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> time = np.arange(0.0, 2.0, 0.01)
    >>> position = np.stack([5 * np.sin(time), 5 - 5 * np.cos(time), np.full(time.size, 1.5)], axis=-1)
    >>> bank = np.full(time.size, -np.arctan(5 / 9.80665))
    >>> attitude = Rotation.from_euler("ZX", np.stack([time, bank], axis=-1))
    >>> quaternion = attitude.as_quat()[:, [3, 0, 1, 2]]
    >>> flight = flight_from_poses(time, position, quaternion, frame="NWU/FLU")
    >>> flight[["airspeed", "beta", "phi", "q", "r", "ay", "az"]].iloc[100].round(3).abs().tolist()
    [5.0, 0.0, 0.472, 0.454, 0.891, 0.0, 11.008]
    """
    time, position, quaternion = _checked(time, position, quaternion)
    if frame not in FRAMES:
        raise ValueError(
            f"Got frame={frame!r}, but expected one of {list(FRAMES)}: earth axes, then body axes."
        )
    n = len(time)
    names = np.asarray(flight, dtype=object)
    if names.shape not in ((), (n,)):
        raise ValueError(f"Got flight of shape {names.shape}, but expected one name or {(n,)}.")
    names = np.broadcast_to(names, n)
    columns = {
        name: np.asarray(values)
        for name, values in dict(controls if controls is not None else {}).items()
    }
    for name, column in columns.items():
        if column.shape != (n,):
            raise ValueError(
                f"Got controls[{name!r}] of shape {column.shape}, but expected {(n,)}."
            )
    air = np.zeros(3) if wind is None else np.asarray(wind, dtype=float)
    if air.shape != (3,) or not np.isfinite(air).all():
        raise ValueError(
            f"Got wind={wind!r}, but expected three numbers: north, east and down [m/s]."
        )
    segments = flight_segments(time, names)
    for part in segments or [slice(0, 0)]:
        if part.stop - part.start < LEAST_SAMPLES:
            where = (
                f" of flight {str(names[part.start])!r} from {time[part.start]:g} s on, without a "
                f"gap"
                if n
                else ""
            )
            raise ValueError(
                f"Got {part.stop - part.start} samples{where}, but expected at least "
                f"{LEAST_SAMPLES} to differentiate: "
                "drop these rows."
            )

    earth, body = FRAMES[frame]
    position, attitude = (
        earth.apply(position),
        earth * Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]) * body,
    )
    _check_faults(time, names, position, attitude)
    rotation = smooth_rotation(time, attitude, segments)
    motion = smooth_motion(
        time, position, segments, axes=rotation.attitude, gravity=STANDARD_GRAVITY
    )
    size = np.median(np.linalg.norm(motion.f, axis=1))
    if size > LARGEST_FORCE:
        raise ValueError(
            f"Got positions whose specific force is {size:.3g} m/s^2 (median), but expected about "
            f"9.8: "
            "divide positions in millimetres by 1000, and give time in seconds."
        )
    _check_frame(frame, rotation.attitude, motion.v - air, rotation.attitude.apply(motion.f))

    to_body = rotation.attitude.inv()
    blocks = (
        (AIR_DATA, np.stack(air_data(to_body.apply(motion.v - air)), axis=-1)),
        (RATES, rotation.rates),
        ([f"{name}_dot" for name in RATES], rotation.accelerations),
        (SPECIFIC_FORCE, motion.f),
        (BODY_VELOCITY, to_body.apply(motion.v)),
        (EULER, _euler(rotation.attitude)),
        (POSITION, motion.x),
        (EARTH_VELOCITY, motion.v),
    )
    values: dict[str, Any] = {"time": time, "flight": names}
    values |= {
        name: column for group, block in blocks for name, column in zip(group, block.T, strict=True)
    }
    values |= dict(zip(WIND, air, strict=True)) if wind is not None else {}
    values["altitude"] = altitude - motion.x[:, 2]
    values["density"] = standard_density(values["altitude"])
    twice = sorted(values.keys() & columns.keys())
    if twice:
        raise ValueError(
            f"Got controls with the columns {twice}, which the poses give: leave them out."
        )
    table = pd.DataFrame(values | columns)
    check_magnitudes(table)
    table.attrs["pose_noise"] = (motion.noise, rotation.noise)
    return table


def _checked(time: ArrayLike, position: ArrayLike, quaternion: ArrayLike) -> list[np.ndarray]:
    """Return time (n,), position (n, 3) and unit quaternions (n, 4) as finite floats."""
    arrays = [np.asarray(each, dtype=float) for each in (time, position, quaternion)]
    n = arrays[0].size
    for name, array, shape in zip(
        ("time", "position", "quaternion"), arrays, ((n,), (n, 3), (n, 4)), strict=True
    ):
        if array.shape != shape:
            raise ValueError(
                f"Got {name} of shape {array.shape}, but expected {shape}, one row per sample."
            )
        lost = np.flatnonzero(~np.isfinite(array.reshape(n, -1)).all(axis=1))
        if lost.size:
            raise ValueError(
                f"Got {name} that is not finite in {lost.size} of {n} rows (the first is row "
                f"{lost[0]}), but expected "
                "numbers: drop these rows from time, position, quaternion and controls."
            )
    length = np.linalg.norm(arrays[2], axis=1)
    wrong = np.flatnonzero(np.abs(length - 1) > UNIT)
    if wrong.size:
        raise ValueError(
            f"Got a quaternion of length {length[wrong[0]]:.4g} at row {wrong[0]} ({wrong.size} "
            f"such rows), but "
            "expected length 1: choose the four columns of the quaternion, scalar first, and drop "
            "rows without an "
            "attitude."
        )
    return arrays


def _check_faults(
    time: np.ndarray, flight: np.ndarray, position: np.ndarray, attitude: Rotation
) -> None:
    """Raise ValueError if poses were not measured: repeated, or far from their neighbours."""
    for what, values in (
        ("position", position),
        ("quaternion", attitude.as_matrix().reshape(-1, 9)),
    ):
        repeats = np.mean(np.diff(values, axis=0) == 0, axis=0).min()
        if repeats > MOST_REPEATS:
            raise ValueError(
                f"Got {what} that repeats the row before in {100 * repeats:.0f} % of the rows, "
                f"but expected each row "
                "measured: keep the rows in which it changes."
            )
    columns = dict(
        zip((*POSITION, *EULER), np.column_stack([position, _euler(attitude)]).T, strict=True)
    )
    poses = pd.DataFrame({"time": time, "flight": flight} | columns)
    faults = [fault for fault in find_faults(poses) if fault.kind in NOT_MEASURED]
    if faults:
        raise ValueError(
            faults_message(faults, "Drop these rows from time, position, quaternion and controls.")
        )


def _euler(attitude: Rotation) -> np.ndarray:
    return quaternion_to_euler(attitude.as_quat()[:, [3, 0, 1, 2]])


def _check_frame(frame: str, attitude: Rotation, velocity: np.ndarray, force: np.ndarray) -> None:
    """Raise ValueError if lift, the nose or banked turns contradict the frame.

    Air velocity and specific force (n, 3) are along north, east, down if the frame is right.
    """
    earth, body = FRAMES[frame]
    poses = earth.inv() * attitude * body.inv()
    fits, conjugate = {}, {}
    for name, (its_earth, its_body) in FRAMES.items():
        turn = its_earth * earth.inv()
        motion = turn.apply(velocity), turn.apply(force + GRAVITY_NED) - GRAVITY_NED
        fits[f"frame={name!r}"] = _fit(its_earth * poses * its_body, *motion)
        conjugate[f"frame={name!r} and conjugate quaternions"] = _fit(
            its_earth * poses.inv() * its_body, *motion
        )
    lift, forward, side_force = fits[f"frame={frame!r}"]
    fits = {words: fit for words, fit in fits.items() if min(fit[:2]) > 0}
    least = min((fit[2] for fit in fits.values()), default=np.inf)
    if lift <= 0:
        reason = f"a mean specific force of {-lift:+.3g} m/s^2 along the body's z axis, but expected about -9.8"
    elif forward <= 0 and np.linalg.norm(velocity, axis=1).mean() > SLOW:
        reason = f"a mean velocity of {forward:.3g} m/s along the nose, but expected flight forward"
    elif side_force > UNEXPLAINED and least < CLEARLY * side_force:
        reason = (
            f"a side force of which sideslip leaves {side_force:.3g} m/s^2 unexplained, but "
            f"expected {least:.3g}, "
            "as the aircraft turns to the side to which it banks"
        )
    else:
        return
    fits = fits or {words: fit for words, fit in conjugate.items() if min(fit[:2]) > 0}
    least = min((fit[2] for fit in fits.values()), default=np.inf)
    likely = [words for words, fit in fits.items() if fit[2] <= least + UNSURE]
    remedy = "look at the quaternions, which must be scalar first, body to earth, and at the body's axes: no frame fits"
    remedy = f"try {' or '.join(likely)}" if likely else remedy
    raise ValueError(f"Got frame={frame!r} and poses with {reason}: {remedy}.")


def _fit(attitude: Rotation, velocity: np.ndarray, force: np.ndarray) -> tuple[float, float, float]:
    """Return how well motion fits an attitude: mean lift, mean velocity along the nose, and unexplained side force.

    The side force of an aircraft is near V^2 (c + k beta). If the vertical has the wrong sense,
    twice the side component of gravity is added, which changes with bank.
    """
    velocity, force = attitude.inv().apply(velocity), attitude.inv().apply(force)
    airspeed, _, beta = air_data(velocity)
    shapes = np.stack([airspeed**2, airspeed**2 * beta], axis=-1)
    left = force[:, 1] - shapes @ np.linalg.lstsq(shapes, force[:, 1], rcond=None)[0]
    return (
        -float(force[:, 2].mean()),
        float(velocity[:, 0].mean()),
        float(np.sqrt(np.mean(left**2))),
    )


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

    The turns from each sample to the next, log(R_k^-1 R_k+1), add up to coordinates whose rate is
    that of the body. They are those of the smoothed attitude, to which the measured one adds noise;
    so they are found in two passes.
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
    time: np.ndarray,
    x: np.ndarray,
    segments: list[slice],
    *,
    axes: Rotation | None = None,
    gravity: float = 0.0,
) -> Motion:
    """Return the motion of coordinates x (n, 3) at times (n,), each segment by itself.

    ``axes`` turn f into the axes of x, by default they are the same; ``gravity`` acts along the
    third of x.
    """
    step = float(np.median(np.concatenate([np.diff(time[each]) for each in segments])))
    axes = Rotation.identity(len(time)) if axes is None else axes
    records = [
        Record(time[each] / step, x[each], axes[each], gravity * step**2) for each in segments
    ]
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
    return optimize.minimize(
        cost, start, method="L-BFGS-B", jac="3-point", bounds=bounds, options=options
    ).x


def minus_log_likelihood(records: list[Record], log_k: np.ndarray) -> float:
    """Return minus twice the log likelihood of log k (3,) but for a constant."""
    fits = [record.fit(log_k) for record in records]
    degrees = sum(record.degrees for record in records)
    misfit = sum(fit.misfit for fit in fits) + np.finfo(float).tiny
    differences = sum(record.counts[1] for record in records)
    return float(
        degrees * np.log(misfit)
        + sum(fit.log_determinant for fit in fits)
        + differences * np.sum(log_k)
    )


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
        return [
            Record(self.time[rows], self.x[rows], self.axes[rows], self.gravity) for rows in cuts
        ]

    def fit(self, log_k: np.ndarray) -> PoseFit:
        """Return the coefficients of the least misfit |x - B c|^2 + sum_i |D_i c - d_i|^2 / k_i."""
        weights = [1.0, *np.exp(-np.asarray(log_k))]
        precision = sum(weight * bands for weight, bands in zip(weights, self._bands, strict=True))
        factor = linalg.cholesky_banded(
            precision, lower=True, overwrite_ab=True, check_finite=False
        )
        found, left, of_row = (
            np.zeros(self._rows.shape[1]),
            self._values,
            np.repeat(weights, self.counts),
        )
        for _ in range(3):  # refined, as the precision may be ill-conditioned
            target = self._columns @ (of_row * left)
            found = found + linalg.cho_solve_banded((factor, True), target, check_finite=False)
            left = self._values - self._rows @ found
        misfit = float(of_row @ left**2)
        return PoseFit(
            found.reshape(-1, 3) + self.x[0], misfit, float(2 * np.sum(np.log(factor[0])))
        )

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
