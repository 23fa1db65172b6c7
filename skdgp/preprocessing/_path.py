"""Flight-path reconstruction: the most likely path and the noise of its sensors, by Gauss-Newton steps.

The process equations relate neighbouring samples: specific force, angular rate and gusts. The
measurement equations relate a state to airspeed, alpha, beta, GPS velocity and attitude at one
sample.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    EARTH_VELOCITY,
    EULER,
    LEAST_GUST,
    RATES,
    SPECIFIC_FORCE,
)
from skdgp._flight.checks import numeric
from skdgp._flight.clock import check_clock, flight_rows, runs_by_flight
from skdgp._flight.frames import STANDARD_GRAVITY, air_data, air_data_slopes, cross_matrix
from skdgp.preprocessing._table import has_values, interpolate_missing

NEEDED = (
    *RATES,
    *SPECIFIC_FORCE,
    *EULER,
    *EARTH_VELOCITY,
    "airspeed",
)  # alpha and beta are optional

# Places in a state's errors: NED velocity, rotation vector in body axes, NED gust
VELOCITY, ATTITUDE, GUST = slice(0, 3), slice(3, 6), slice(6, 9)

INERTIAL = {
    "ax_bias": 0.3, "ay_bias": 0.3, "az_bias": 0.3, "p_bias": 0.02, "q_bias": 0.02, "r_bias": 0.02,
}  # fmt: skip
MEAN_WIND = dict.fromkeys(("wind_north", "wind_east"), 30.0)
# Prior deviations (SI) of: truth + bias; truth a lag [s] ago; the mean wind
GUST_TIME = 10.0  # correlation time of gusts [s]
CONSTANTS = INERTIAL | {"velocity_lag": 0.1, "attitude_lag": 0.1} | MEAN_WIND
PLACE = {name: place for place, name in enumerate(CONSTANTS)}
LAGS = (*["velocity_lag"] * 3, *["attitude_lag"] * 3)  # of the measurements after air data
GRAVITY = np.array(
    [0.0, 0.0, STANDARD_GRAVITY]
)  # NED; what it is more here is in the accelerometers' biases
MIN_AIRSPEED = 3.0  # m/s, below which vanes show no angle
# Initial noise of the sensors: standard deviation of a sample, SI
NOISE = {
    "accelerometer": 0.05, "gyro": 0.003, "airspeed": 0.5, "alpha": 0.01, "beta": 0.01, "v_horizontal": 0.2,
    "v_down": 0.2, "tilt": 0.01, "heading": 0.02,
}  # fmt: skip
GUSTS = {
    "gust_horizontal": 0.2,
    "gust_vertical": 0.2,
}  # initial standard deviation of a change in 1 s [m/s]
PROCESS = (
    *["accelerometer"] * 3,
    *["gyro"] * 3,
    "gust_horizontal",
    "gust_horizontal",
    "gust_vertical",
)
# Noise of each measurement equation, as PROCESS of each process equation
MEASUREMENTS = (
    "airspeed",
    "alpha",
    "beta",
    "v_horizontal",
    "v_horizontal",
    "v_down",
    "tilt",
    "tilt",
    "heading",
)
MIN_NOISE = 1e-9
# residuals that the initial noise of a sensor is worth; it decides where a flight tells nothing
PRIOR_COUNT = 10
START_PRECISION = np.repeat(
    [1e-4, 1.0], 3
)  # prior precision of velocity [m/s] and attitude [rad] at a segment's begin
# Gauss-Newton steps in which lags may change by whole samples; then these are fixed, to converge
DELAY_STEPS = 6
MAX_STEPS = 40
# Fraction of a step that the next one takes back, from which steps are halved
OVERSHOOT = 0.5
TOLERANCE = 0.02
N_DRAWS = 32
MIRROR = (1, -1, 1, -1, 1, -1, 1, -1, 1)
# As MIRROR, the signs of a state's errors in a mirror at the x-z plane: odd constants
ODD = frozenset(("ay_bias", "p_bias", "r_bias", "wind_east"))


class Equations(NamedTuple):
    """Linear equations residual + d_state x_k + d_next x_{k+1} + d_constants c = 0, m for each of n samples k."""

    residual: Matrix  # (n, m)
    d_state: Array  # (n, m, s)
    d_next: Array | None  # (n, m, s); None for measurement equations
    d_constants: Array  # (n, m, c)

    def whitened(self, noise: Matrix, places: list[int]) -> Equations:
        """Return the equations in units of their noise, (n, m), by the constants at some places."""
        each = noise[..., None]
        d_next = None if self.d_next is None else self.d_next / each
        d_constants = self.d_constants[..., places] / each
        return Equations(self.residual / noise, self.d_state / each, d_next, d_constants)

    def changes(self, states: Array, constants: Matrix) -> Array:
        """Return the changes of the residuals, (n, m, k), by k sets of states (N, s, k) and constants (c, k)."""
        total = self.d_state @ states[: len(self.d_state)] + self.d_constants @ constants
        return total if self.d_next is None else total + self.d_next @ states[1:]


class Log(NamedTuple):
    """The sensors of one flight, n samples."""

    time: Vector  # (n,) [s]
    segment: Indices  # (n,) number of the gap-free segment of a sample
    force: Matrix  # (n, 3) accelerometers [m/s^2]
    rate: Matrix  # (n, 3) gyros [rad/s]
    air: Matrix  # (n, 3) airspeed [m/s], alpha, beta [rad]; NaN where not sampled
    velocity: Matrix  # (n, 3) GPS velocity, NED [m/s]; NaN where not sampled
    attitude: Rotation  # n attitudes, body to NED
    attitude_sampled: Mask  # (n,) where the attitude was sampled
    delays: tuple[int, ...] = (0,) * 6  # `LAGS` in whole samples

    def part(self, first: int, last: int) -> Log:
        """Return the samples from first to before last."""
        return Log._make([*(values[first:last] for values in self[:-1]), self.delays])

    def segments(self) -> list[Indices]:
        """Return the rows of each gap-free segment."""
        return [np.flatnonzero(self.segment == number) for number in np.unique(self.segment)]

    @property
    def joined(self) -> Mask:
        """Whether a sample and the next are in one segment, (n - 1,)."""
        return self.segment[1:] == self.segment[:-1]


class FlightPath(NamedTuple):
    """The states of a flight, one for every sample, and its constants."""

    velocity: Matrix  # (n, 3) over the ground, NED [m/s]
    attitude: Rotation  # n attitudes, body to NED
    gust: Matrix  # (n, 3) the air's velocity minus the mean wind, NED [m/s]
    constants: Vector  # (c,) in the order of CONSTANTS

    def part(self, first: int, last: int) -> FlightPath:
        """Return the states from first to before last."""
        return FlightPath(
            self.velocity[first:last],
            self.attitude[first:last],
            self.gust[first:last],
            self.constants,
        )

    def moved(self, states: Matrix, constants: Any) -> FlightPath:
        """Return the path with errors (n, 9), (c,) added."""
        turned = self.attitude * Rotation.from_rotvec(states[:, ATTITUDE])
        velocity, gust = self.velocity + states[:, VELOCITY], self.gust + states[:, GUST]
        return FlightPath(velocity, turned, gust, self.constants + constants)

    def constant(self, *names: str) -> Vector:
        """Return constants by name."""
        return self.constants[[PLACE[name] for name in names]]

    def wind(self) -> Matrix:
        """Return the air's velocity (n, 3), NED [m/s]."""
        return self.gust + np.append(self.constant(*MEAN_WIND), 0.0)

    def air_velocity(self) -> Matrix:
        """Return the velocity relative to the air (n, 3), body axes [m/s]."""
        return self.attitude.inv().apply(self.velocity - self.wind())

    def force(self, log: Log) -> Matrix:
        """Return the specific force (n, 3), body axes, without the sensors' bias."""
        return log.force - self.constant("ax_bias", "ay_bias", "az_bias")

    def rate(self, log: Log) -> Matrix:
        """Return the angular rate (n, 3), body axes, without the sensors' bias."""
        return log.rate - self.constant("p_bias", "q_bias", "r_bias")


def flight_logs(table: pd.DataFrame) -> list[tuple[object, Indices, Log]]:
    """Return name, rows and log of every flight in the table.

    Raise ValueError if time does not increase, or a needed channel has no value in a flight.
    """
    names = (
        np.asarray(table["flight"], dtype=object)
        if "flight" in table
        else np.zeros(len(table), int)
    )
    time, codes = check_clock(numeric(table, ["time"])[:, 0], names)
    logs = []
    for runs in runs_by_flight(time, codes):
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        segment = np.repeat(np.arange(len(runs)), [run.stop - run.start for run in runs])
        logs.append((names[rows[0]], rows, _log(table.iloc[rows], time[rows], segment)))
    return logs


def missing_channels(table: pd.DataFrame) -> list[str]:
    """Return the needed channels that are absent, or have no value in some flight."""
    rows = flight_rows(table["flight"]).values() if "flight" in table else [slice(None)]
    empty = [
        name for name in NEEDED if not all(has_values(table.iloc[part], name) for part in rows)
    ]
    return empty if "time" in table else ["time", *empty]


def first_guess(log: Log, constants: Vector) -> FlightPath:
    """Return the path of GPS and attitude alone, in air at rest."""
    velocity = interpolate_missing(log.time, log.velocity)
    return FlightPath(velocity, log.attitude, np.zeros_like(velocity), constants)


def _log(table: pd.DataFrame, time: Vector, segment: Indices) -> Log:
    if empty := [name for name in NEEDED if not has_values(table, name)]:
        flight = f"flight {table['flight'].iloc[0]!r}" if "flight" in table else "the flight"
        raise ValueError(
            f"Got no value of {', '.join(empty)} in {flight}, but expected some: a path cannot be "
            f"reconstructed "
            "without them. Leave the flight out, or smooth it with FlightSmoother."
        )
    angles = numeric(table, EULER).copy()
    sampled = np.all(np.isfinite(angles), axis=1)
    angles[sampled] = np.unwrap(angles[sampled], axis=0)
    attitude = Rotation.from_euler("ZYX", interpolate_missing(time, angles)[:, ::-1])
    inertial = interpolate_missing(time, numeric(table, [*SPECIFIC_FORCE, *RATES]))
    air = numeric(table.reindex(columns=list(AIR_DATA)), AIR_DATA)
    return Log(
        time,
        segment,
        force=inertial[:, :3],
        rate=inertial[:, 3:],
        air=air,
        velocity=numeric(table, EARTH_VELOCITY),
        attitude=attitude,
        attitude_sampled=sampled,
    )


def process_equations(path: FlightPath, log: Log, correlation: Vector) -> Equations:
    """Return predicted - measured specific force and angular rate between samples, and the change of the gust."""
    n, c = len(log.time) - 1, len(CONSTANTS)
    residual, d_constants = np.zeros((n, 9)), np.zeros((n, 9, c))
    d_state, d_next = np.zeros((n, 9, 9)), np.zeros((n, 9, 9))
    step = np.diff(log.time)[:, None]
    back, turn = path.attitude[:-1].inv(), path.attitude[:-1].inv() * path.attitude[1:]
    turned = turn.as_matrix()

    # R_k^T ((v_{k+1} - v_k) / h - g - (R_k f_k + R_{k+1} f_{k+1}) / 2) over a step of h seconds.
    force = path.force(log)
    force_ned = path.attitude.apply(force)
    acceleration = np.diff(path.velocity, axis=0) / step
    residual[:, VELOCITY] = back.apply(
        acceleration - GRAVITY - (force_ned[:-1] + force_ned[1:]) / 2
    )
    d_next[:, VELOCITY, VELOCITY] = back.as_matrix() / step[..., None]
    d_state[:, VELOCITY, VELOCITY] = -d_next[:, VELOCITY, VELOCITY]
    d_next[:, VELOCITY, ATTITUDE] = turned @ cross_matrix(force[1:]) / 2
    d_state[:, VELOCITY, ATTITUDE] = cross_matrix(residual[:, VELOCITY] + force[:-1] / 2)
    d_constants[:, VELOCITY, PLACE["ax_bias"] : PLACE["az_bias"] + 1] = (np.eye(3) + turned) / 2

    # Log(R_k^T R_{k+1}) / h - (omega_k + omega_{k+1}) / 2 - (h / 12) omega_k x omega_{k+1}.
    rate = path.rate(log)
    angle = turn.as_rotvec()
    coning = np.cross(rate[:-1], rate[1:]) * step / 12
    residual[:, ATTITUDE] = angle / step - (rate[:-1] + rate[1:]) / 2 - coning
    d_next[:, ATTITUDE, ATTITUDE] = _log_gradient(angle) / step[..., None]
    d_state[:, ATTITUDE, ATTITUDE] = (
        -_log_gradient(angle) @ turn.inv().as_matrix() / step[..., None]
    )
    d_constants[:, ATTITUDE, PLACE["p_bias"] : PLACE["r_bias"] + 1] = np.eye(3)

    residual[:, GUST] = path.gust[1:] - correlation[:, None] * path.gust[:-1]
    d_state[:, GUST, GUST] = -correlation[:, None, None] * np.eye(3)
    d_next[:, GUST, GUST] = np.eye(3)
    return _without(
        Equations(residual, d_state, d_next, d_constants),
        np.repeat(~log.joined[:, None], 9, axis=1),
    )


def measurement_equations(path: FlightPath, log: Log) -> Equations:
    """Return predicted - measured airspeed, alpha, beta, GPS velocity, and attitude (rotation about NED axes).

    A sensor with a lag is compared with its value m samples later. Over the rest of the lag, less
    than a step, the prediction is continued by its rate of change.
    """
    n = len(log.time)
    residual, d_state = np.zeros((n, 9)), np.zeros((n, 9, 9))
    d_constants = np.zeros((n, 9, len(CONSTANTS)))

    velocity = path.air_velocity()
    gradient = air_data_slopes(velocity, MIN_AIRSPEED)
    by_ned = gradient @ path.attitude.as_matrix().swapaxes(1, 2)
    airspeed, alpha, beta = air_data(velocity)
    residual[:, :3] = np.column_stack([airspeed, alpha, beta]) - log.air
    residual[airspeed < MIN_AIRSPEED, 1:3] = np.nan
    turned = gradient @ cross_matrix(velocity)
    d_state[:, :3] = np.concatenate([by_ned, turned, -by_ned], axis=2)
    d_constants[:, :3, [PLACE[name] for name in MEAN_WIND]] = -by_ned[:, :, :2]

    later, offset = _lagged_rows(log, path.constant(*LAGS))
    residual[:, 3:6] = path.velocity - np.take_along_axis(log.velocity, later[:, :3], axis=0)
    d_state[:, 3:6, VELOCITY] = np.eye(3)
    angle = (path.attitude * log.attitude[later[:, 3]].inv()).as_rotvec()
    residual[:, 6:9] = angle
    residual[~log.attitude_sampled[later[:, 3]], 6:9] = np.nan
    d_state[:, 6:9, ATTITUDE] = _log_gradient(-angle) @ path.attitude.as_matrix()
    acceleration = path.attitude.apply(path.force(log)) + GRAVITY
    rates = np.concatenate([acceleration, path.attitude.apply(path.rate(log))], axis=1)
    residual[:, 3:] += offset * rates
    for row, name in enumerate(LAGS):
        d_constants[:, 3 + row, PLACE[name]] = -rates[:, row]
    return _without(Equations(residual, d_state, None, d_constants), np.isnan(residual))


def _lagged_rows(log: Log, lag: Vector) -> tuple[Indices, Matrix]:
    """Return the row of the log for each of `LAGS`, (n, 6), and its offset in time, NaN where there is none."""
    later = np.arange(len(log.time))[:, None] + np.array(log.delays)
    inside = np.clip(later, 0, len(log.time) - 1)
    offset = log.time[inside] - log.time[:, None] - lag
    return inside, np.where(
        (inside == later) & (log.segment[inside] == log.segment[:, None]), offset, np.nan
    )


def _log_gradient(angle: Matrix) -> Array:
    """Return the derivative of Log(exp(angle) exp(x)) by x at 0, to second order in the angle: (n, 3, 3)."""
    half = cross_matrix(angle) / 2
    return np.eye(3) + half + half @ half / 3


def _without(equations: Equations, missing: Mask) -> Equations:
    """Return the equations with zeros for the missing ones."""
    for values in equations:
        if values is not None:
            values[missing] = 0.0
    return equations


class Prior(NamedTuple):
    """Prior knowledge: precision, and the expansion point minus the expected value."""

    states: Matrix  # (n, s) precision
    states_offset: Matrix  # (n, s)
    constants: Vector  # (c,) precision
    constants_offset: Vector  # (c,)


class Posterior(NamedTuple):
    """Solution of the bordered normal equations, and samples from the normal distribution around it."""

    states: Matrix  # (n, s)
    constants: Vector  # (c,)
    covariance: Matrix  # of the constants, (c, c)
    state_draws: Array  # (n, s, k), mean zero
    constant_draws: Matrix  # (c, k)


class Estimate(NamedTuple):
    """The path, its uncertainty, and the noise."""

    path: FlightPath
    noise: dict[str, float]
    covariance: Matrix  # of the free constants, (f, f)
    converged: bool


def estimate(
    log: Log,
    noise: dict[str, float],
    *,
    learn: Collection[str],
    free: Sequence[str],
) -> Estimate:
    """Return the most likely path, and the maximum-likelihood noise of the channels in ``learn``.

    Gauss-Newton on the path alternates with Foerstner's estimate of the variance components: a
    channel's variance is the sum of its squared residuals over its redundancy, the number of
    samples minus the trace of J P J^T. At its fixed point the gradient of the marginal likelihood
    is zero (Searle, Casella & McCulloch 1992, section 8.3). The traces are those of draws from the
    posterior. The constants in ``free`` are estimated, with prior means of zero. ``noise`` holds
    the initial standard deviations, by the names in NOISE and GUSTS.
    """
    path, places = first_guess(log, np.zeros(len(CONSTANTS))), [PLACE[name] for name in free]
    draws = _mirrored_pairs(len(log.time), free)
    process_names = _process_names(log)
    last = np.zeros(len(places))
    stride = 1.0
    interval = np.median(np.diff(log.time)) if len(log.time) > 1 else np.inf
    for step in range(MAX_STEPS):
        if step <= DELAY_STEPS:
            log = log._replace(
                delays=tuple(np.round(path.constant(*LAGS) / interval).astype(int).tolist())
            )
        equations = _equations(path, log, noise, places)
        prior = _prior(path, log, noise, places)
        posterior = solve(*equations, prior, draws)
        sums = _residual_sums((*process_names, *MEASUREMENTS), equations, posterior)
        move = posterior.constants / np.sqrt(
            np.diag(posterior.covariance)
        )  # the full step, in standard deviations
        if move @ last < -OVERSHOOT * last @ last:
            stride /= 2
        last = move
        change = np.zeros(len(CONSTANTS))
        change[places] = stride * posterior.constants
        path = path.moved(stride * posterior.states, change)
        before, noise = (
            noise,
            noise | _variance_components(sums, noise, learn, min(1.0, 10 / (step + 1))),
        )
        steady = all(abs(np.log(noise[name] / before[name])) < TOLERANCE for name in learn)
        moved, spread = (
            np.mean(np.square(each), axis=0) for each in (posterior.states, posterior.state_draws)
        )
        converged = (
            step > 0 and steady and bool(np.all(moved < TOLERANCE**2 * spread.mean(axis=-1)))
        )
        if converged:
            break
    noise = noise | {
        kind: noise[alike] for kind, alike in zip(PROCESS[6:], process_names[6:], strict=True)
    }
    return Estimate(path, noise, posterior.covariance, converged)


def _mirrored_pairs(n_states: int, free: Sequence[str]) -> Matrix:
    """Return standard normal numbers (9 n + f, N_DRAWS), a set that a mirror at the x-z plane does not change.

    So a mirrored flight, which is the same physics, has the same noise and the mirrored path up to
    rounding.
    """
    sign = np.append(np.tile(MIRROR, n_states), [-1.0 if name in ODD else 1.0 for name in free])
    half = np.random.default_rng(0).standard_normal((len(sign), N_DRAWS // 2))
    return np.column_stack([half, sign[:, None] * half])


def solve(process: Equations, measurements: Equations, prior: Prior, draws: Matrix) -> Posterior:
    r"""Return the least-squares solution of process and measurement equations.

    With the states x (n s) and constants c, the normal equations

    .. math:: \begin{pmatrix} A & B \\ B^T & C \end{pmatrix} \begin{pmatrix} x \\ c \end{pmatrix} =
              - \begin{pmatrix} g \\ h \end{pmatrix}

    have a block-tridiagonal A, of half bandwidth 2 s - 1: A = L L^T in O(n s^3), and c from the
    small Schur complement C - B^T A^-1 B. The inverse of the whole matrix is the covariance; x =
    L^-T e - A^-1 B c with standard normal e and c from the inverse of the complement is a sample
    from it.

    ``draws`` are standard normal numbers, (n s + c, k).
    """
    n, s = prior.states.shape
    band, border, corner, g, h = _normal_equations(process, measurements, prior)
    factor = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    solved = cho_solve_banded((factor, True), np.column_stack([border, g]), check_finite=False)
    inner, shift = solved[:, :-1], solved[:, -1]
    covariance = np.linalg.inv(corner - border.T @ inner)
    covariance = (covariance + covariance.T) / 2
    constants = -covariance @ (h - border.T @ shift)
    states = -shift - inner @ constants
    constant_draws = np.linalg.cholesky(covariance) @ draws[n * s :]
    free_draws = lapack.dtbtrs(factor, draws[: n * s], uplo="L", trans="T")[0]  # L^-T e
    state_draws = free_draws - inner @ constant_draws
    return Posterior(
        states.reshape(n, s), constants, covariance, state_draws.reshape(n, s, -1), constant_draws
    )


def _normal_equations(
    process: Equations, measurements: Equations, prior: Prior
) -> tuple[Matrix, Matrix, Matrix, Vector, Vector]:
    """Return A in lower banded storage, B, C, g and h."""
    (n, s), c = prior.states.shape, len(prior.constants)
    this, after, rest = slice(0, s), slice(s, 2 * s), slice(2 * s, None)
    measured, linked = _gram(measurements), _gram(process)
    diagonal = prior.states[:, :, None] * np.eye(s) + measured[:, this, this]
    diagonal[:-1] += linked[:, this, this]
    diagonal[1:] += linked[:, after, after]
    right = measured[:, this, s:].copy()
    right[:-1] += linked[:, this, rest]
    right[1:] += linked[:, after, rest]
    right[..., -1] += prior.states * prior.states_offset
    small = measured[:, s:-1, s:].sum(axis=0) + linked[:, 2 * s : -1, rest].sum(axis=0)
    small[:, :c] += np.diag(prior.constants)
    small[:, c] += prior.constants * prior.constants_offset
    flat = right.reshape(n * s, c + 1)
    return (
        _banded(diagonal, linked[:, this, after]),
        flat[:, :c],
        small[:, :c],
        flat[:, c],
        small[:, c],
    )


def _gram(rows: Equations) -> Array:
    """Return J^T J of each sample, J = [d_state, d_next, d_constants, residual]."""
    parts = [rows.d_state, rows.d_next, rows.d_constants, rows.residual[..., None]]
    J = np.concatenate([part for part in parts if part is not None], axis=2)
    return J.swapaxes(1, 2) @ J


def _banded(diagonal: Array, coupling: Array) -> Matrix:
    """Return a block-tridiagonal matrix in the lower banded storage of LAPACK: row i - j, column j."""
    n, s, _ = diagonal.shape
    band = np.zeros((2 * s, n, s))
    i, j = np.tril_indices(s)
    band[i - j, :, j] = diagonal[:, i, j].T
    i, j = np.indices((s, s)).reshape(2, -1)
    band[s + i - j, :-1, j] = coupling[:, j, i].T
    return band.reshape(2 * s, n * s)


def _process_names(log: Log) -> tuple[str, ...]:
    """Return the noise of each process equation; without an alpha vane vertical gusts are like horizontal ones."""
    return PROCESS if np.isfinite(log.air[:, 1]).any() else (*PROCESS[:-1], "gust_horizontal")


def _equations(
    path: FlightPath, log: Log, noise: Mapping[str, float], places: list[int]
) -> tuple[Equations, Equations]:
    """Return process and measurement equations in units of their noise, by the constants at some places."""
    step = np.diff(log.time)
    correlation = np.exp(-step / GUST_TIME)
    scale = np.tile([noise[name] for name in _process_names(log)], (len(step), 1))
    scale[:, GUST] *= np.sqrt(GUST_TIME / 2 * (1 - correlation**2))[:, None]
    sensors = np.array([noise[name] for name in MEASUREMENTS])
    return (
        process_equations(path, log, correlation).whitened(scale, places),
        measurement_equations(path, log).whitened(sensors, places),
    )


def _prior(path: FlightPath, log: Log, noise: Mapping[str, float], places: list[int]) -> Prior:
    """Return the prior: a wide one of the states where a segment begins, and that of the constants."""
    first = np.concatenate([[True], ~log.joined])[:, None]
    gusts = np.array([noise[name] for name in _process_names(log)[GUST]]) * np.sqrt(GUST_TIME / 2)
    precision = first * np.concatenate([START_PRECISION, gusts**-2])
    states_offset = np.zeros_like(precision)
    states_offset[:, GUST] = path.gust
    return Prior(
        states=precision,
        states_offset=states_offset,
        constants=np.array(list(CONSTANTS.values()))[places] ** -2,
        constants_offset=path.constants[places],
    )


def _residual_sums(
    names: Sequence[str], equations: tuple[Equations, Equations], posterior: Posterior
) -> dict[str, Vector]:
    """Return of each channel, in units of its noise, the sum of squared residuals, the trace of J P J^T, the samples.

    The trace is the number of samples that the path fits.
    """
    sums = []
    for rows in equations:
        change = rows.changes(posterior.states[..., None], posterior.constants[:, None])[..., 0]
        spread = rows.changes(posterior.state_draws, posterior.constant_draws)
        fitted = np.square(spread).mean(axis=-1).sum(axis=0)
        sampled = np.any(rows.d_state != 0, axis=2).sum(axis=0)
        squares = np.sum((rows.residual + change) ** 2, axis=0)
        sums += np.column_stack([squares, fitted, sampled]).tolist()
    total = pd.DataFrame(sums, index=list(names)).groupby(level=0).sum()
    return dict(zip(total.index, total.to_numpy(), strict=True))


def _variance_components(
    sums: Mapping[str, Vector], noise: Mapping[str, float], learn: Collection[str], pace: float
) -> dict[str, float]:
    """Return the new standard deviation of each channel in ``learn`` that was sampled.

    For a random walk measured with other noise, the share of the residuals grows with the variance
    and the redundancy with its root. The plain iteration would halve the error in each step, so the
    step is divided by one minus that slope. ``pace`` shortens it, so that the search does not
    oscillate.
    """
    new = {}
    for name in learn:
        squares, trace, count = sums.get(name, np.zeros(3))
        if not count:
            continue
        guessed, least = (PRIOR_COUNT, MIN_NOISE) if name in NOISE else (0, LEAST_GUST)
        redundancy = max(count - trace, 1.0)
        guess = guessed * (NOISE.get(name, 0.0) / noise[name]) ** 2
        ratio = (squares + guess) / (redundancy + guessed)
        slope = squares / (squares + guess + MIN_NOISE) - redundancy / (redundancy + guessed) / 2
        stride = pace / (1 - min(slope, 0.5) * (1 - redundancy / count))
        new[name] = max(noise[name] * ratio ** (stride / 2), least)
    return new
