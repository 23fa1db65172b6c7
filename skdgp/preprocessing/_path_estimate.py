"""Flight-path reconstruction: the most likely path and the noise of its sensors, by Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, LEAST_GUST
from skdgp.preprocessing._path_equations import (
    CONSTANTS,
    LAGS,
    PLACE,
    Equations,
    FlightPath,
    Log,
    air_data_equations,
    measurement_equations,
    process_equations,
)

NOISE = {
    "accelerometer": 0.05, "gyro": 0.003, "airspeed": 0.5, "alpha": 0.01, "beta": 0.01, "v_horizontal": 0.2,
    "v_down": 0.2, "tilt": 0.01, "heading": 0.02,
}  # fmt: skip
"""Initial noise of the sensors: standard deviation of a sample, SI."""
GUSTS = {"gust_horizontal": 0.2, "gust_vertical": 0.2}  # initial standard deviation of a change in 1 s [m/s]
PROCESS = (*["accelerometer"] * 3, *["gyro"] * 3, "gust_horizontal", "gust_horizontal", "gust_vertical")
MEASUREMENTS = ("airspeed", "alpha", "beta", "v_horizontal", "v_horizontal", "v_down", "tilt", "tilt", "heading")
"""The noise of each process equation and each measurement equation."""
MIN_NOISE = 1e-9
PRIOR_COUNT = 10  # residuals that the initial noise of a sensor is worth; it decides where a flight tells nothing
START_PRECISION = np.repeat([1e-4, 1.0], 3)  # prior precision of velocity [m/s] and attitude [rad] at a segment's begin
WINDOW = 4096  # samples whose equations are in memory at a time
DELAY_STEPS = 6  # Gauss-Newton steps in which lags may change by whole samples; then these are fixed, to converge
MAX_STEPS = 40
OVERSHOOT = 0.5
"""Share of a step that the next one takes back, from which steps are halved.

The crosswind of a straight flight has curved residuals, and full steps would swing ever wider.
"""
TOLERANCE = 0.02
N_DRAWS = 32
MIRROR = (1, -1, 1, -1, 1, -1, 1, -1, 1)
ODD = frozenset(("ay_bias", "p_bias", "r_bias", "beta_bias", "wind_east"))
"""Signs of a state's errors in a mirror at the x-z plane (NED velocity, body rotation, NED gust); odd constants."""


Windows: TypeAlias = Iterable[tuple[int, Equations, Equations]]
"""The number of the first state, the process and the measurement equations of consecutive windows."""


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
    air_std: Vector  # (3,) root mean square of the standard deviations of airspeed, alpha, beta
    converged: bool


def estimate(
    log: Log,
    start: FlightPath,
    noise: dict[str, float],
    *,
    learn: Collection[str],
    free: Sequence[str],
    gust_time: float,
) -> Estimate:
    """Return the most likely path, and the maximum-likelihood noise of the channels in ``learn``.

    Gauss-Newton on the path alternates with Foerstner's estimate of the variance components: a channel's variance is
    the sum of its squared residuals over its redundancy, the number of samples minus the trace of J P J^T. At its fixed
    point the gradient of the marginal likelihood is zero (Searle, Casella & McCulloch 1992, section 8.3). The traces
    are those of draws from the posterior. The constants of ``start`` are their prior means; those in ``free`` are
    estimated. ``noise`` holds the initial standard deviations, by the names in NOISE and GUSTS.
    """
    path, places = start, [PLACE[name] for name in free]
    draws = _mirrored_pairs(len(log.time), free)
    offset = pull = last = np.zeros(len(places))
    stride = 1.0
    interval = np.median(np.diff(log.time)) if len(log.time) > 1 else np.inf
    for step in range(MAX_STEPS):
        if step <= DELAY_STEPS:
            log = log._replace(delays=tuple(np.round(path.constant(*LAGS) / interval).astype(int).tolist()))
        problem = _Problem(path, log, noise, places, gust_time)
        posterior = solve(problem, problem.prior(offset, pull), draws)
        sums = _residual_sums(_process_names(log), problem, posterior)
        move = posterior.constants / np.sqrt(np.diag(posterior.covariance))  # the full step, in standard deviations
        if move @ last < -OVERSHOOT * last @ last:
            stride /= 2
        last = move
        change = np.zeros(len(CONSTANTS))
        change[places] = stride * posterior.constants
        path = path.moved(stride * posterior.states, change)
        offset = (path.constants - start.constants)[places]
        pull = _scale_gradient(path, sums)[places]
        before, noise = noise, noise | _variance_components(sums, noise, learn, min(1.0, 10 / (step + 1)))
        steady = all(abs(np.log(noise[name] / before[name])) < TOLERANCE for name in learn)
        moved, spread = (np.mean(np.square(each), axis=0) for each in (posterior.states, posterior.state_draws))
        converged = step > 0 and steady and bool(np.all(moved < TOLERANCE**2 * spread.mean(axis=-1)))
        if converged:
            break
    noise = noise | {kind: noise[alike] for kind, alike in zip(PROCESS[6:], _process_names(log)[6:], strict=True)}
    return Estimate(path, noise, posterior.covariance, _air_std(path, posterior, places), converged)


def _mirrored_pairs(n_states: int, free: Sequence[str]) -> Matrix:
    """Return standard normal numbers (9 n + f, N_DRAWS), a set that a mirror at the x-z plane does not change.

    So a mirrored flight, which is the same physics, has the same noise and the mirrored path up to rounding.
    """
    sign = np.append(np.tile(MIRROR, n_states), [-1.0 if name in ODD else 1.0 for name in free])
    half = np.random.default_rng(0).standard_normal((len(sign), N_DRAWS // 2))
    return np.column_stack([half, sign[:, None] * half])


def solve(windows: Windows, prior: Prior, draws: Matrix) -> Posterior:
    r"""Return the least-squares solution of process and measurement equations.

    With the states x (n s) and constants c, the normal equations

    .. math:: \begin{pmatrix} A & B \\ B^T & C \end{pmatrix} \begin{pmatrix} x \\ c \end{pmatrix} =
              - \begin{pmatrix} g \\ h \end{pmatrix}

    have a block-tridiagonal A, of half bandwidth 2 s - 1: A = L L^T in O(n s^3), and c from the small Schur complement
    C - B^T A^-1 B. The inverse of the whole matrix is the covariance; x = L^-T e - A^-1 B c with standard normal e and
    c from the inverse of the complement is a sample from it.

    ``draws`` are standard normal numbers, (n s + c, k).
    """
    n, s = prior.states.shape
    band, border, corner, g, h = _normal_equations(windows, prior)
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
    return Posterior(states.reshape(n, s), constants, covariance, state_draws.reshape(n, s, -1), constant_draws)


def _normal_equations(windows: Windows, prior: Prior) -> tuple[Matrix, Matrix, Matrix, Vector, Vector]:
    """Return A in lower banded storage, B, C, g and h."""
    (n, s), c = prior.states.shape, len(prior.constants)
    diagonal, coupling = prior.states[:, :, None] * np.eye(s), np.zeros((max(n - 1, 0), s, s))
    right, small = np.zeros((n, s, c + 1)), np.zeros((c, c + 1))
    right[..., -1] = prior.states * prior.states_offset
    small[:, :c], small[:, c] = np.diag(prior.constants), prior.constants * prior.constants_offset
    this, after, rest = slice(0, s), slice(s, 2 * s), slice(2 * s, None)
    for first, process, measurements in windows:
        measured, linked = _gram(measurements), _gram(process)
        at = slice(first, first + len(measured))
        here, there = slice(first, first + len(linked)), slice(first + 1, first + 1 + len(linked))
        diagonal[at] += measured[:, this, this]
        diagonal[here] += linked[:, this, this]
        diagonal[there] += linked[:, after, after]
        coupling[here] = linked[:, this, after]
        right[at] += measured[:, this, s:]
        right[here] += linked[:, this, rest]
        right[there] += linked[:, after, rest]
        small += measured[:, s:-1, s:].sum(axis=0) + linked[:, 2 * s : -1, rest].sum(axis=0)
    flat = right.reshape(n * s, c + 1)
    return _banded(diagonal, coupling), flat[:, :c], small[:, :c], flat[:, c], small[:, c]


def _gram(rows: Equations) -> Array:
    """Return J^T J of each sample, J = [d_state, d_next, d_constants, residual]."""
    parts = [rows.d_state, rows.d_next, rows.d_constants, rows.residual[..., None]]
    J = np.concatenate([part for part in parts if part is not None], axis=2)
    return J.swapaxes(1, 2) @ J


def _banded(diagonal: Array, coupling: Array) -> Matrix:
    """Return a block-tridiagonal matrix in the lower banded storage of LAPACK: row i - j, column j."""
    n, s, _ = diagonal.shape
    band = np.zeros((2 * s, n, s))
    for j in range(s):
        for i in range(j, s):
            band[i - j, :, j] = diagonal[:, i, j]
        for i in range(s):
            band[s + i - j, :-1, j] = coupling[:, j, i]
    return band.reshape(2 * s, n * s)


def _process_names(log: Log) -> tuple[str, ...]:
    """Return the noise of each process equation; without an alpha vane vertical gusts are like horizontal ones."""
    return PROCESS if np.isfinite(log.air[:, 1]).any() else (*PROCESS[:-1], "gust_horizontal")


class _Problem:
    """Process and measurement equations in units of their noise, by windows (a single one computed once), and prior."""

    def __init__(
        self, path: FlightPath, log: Log, noise: Mapping[str, float], places: list[int], gust_time: float
    ) -> None:
        self.path, self.log, self.noise, self.places, self.gust_time = path, log, noise, places, gust_time
        self.single: tuple[int, Equations, Equations] | None = None

    def __iter__(self) -> Iterator[tuple[int, Equations, Equations]]:
        n = len(self.log.time)
        if n > WINDOW:
            yield from (self._window(first, min(first + WINDOW, n)) for first in range(0, n, WINDOW))
        else:
            self.single = self.single or self._window(0, n)
            yield self.single

    def _window(self, first: int, last: int) -> tuple[int, Equations, Equations]:
        margin = 1 + max(map(abs, self.log.delays))
        start, stop = max(first - margin, 0), min(last + margin, len(self.log.time))
        path, log = self.path.part(start, stop), self.log.part(start, stop)
        step = np.diff(log.time)
        correlation = np.exp(-step / self.gust_time)
        scale = np.array([self.noise[name] for name in _process_names(self.log)]) * np.ones((len(step), 1))
        scale[:, 6:] *= np.sqrt(self.gust_time / 2 * (1 - correlation**2))[:, None]
        process = self._whitened(process_equations(path, log, correlation), scale)
        noise = np.array([self.noise[name] for name in MEASUREMENTS])
        measurements = self._whitened(measurement_equations(path, log), noise)
        return first, process.part(first - start, last - start), measurements.part(first - start, last - start)

    def _whitened(self, rows: Equations, scale: Array) -> Equations:
        each = scale[..., None]
        d_next = None if rows.d_next is None else rows.d_next / each
        return Equations(rows.residual / scale, rows.d_state / each, d_next, rows.d_constants[..., self.places] / each)

    def prior(self, offset: Vector, pull: Vector) -> Prior:
        """Return the prior: a wide one of the states where a segment begins, and that of the constants."""
        first = np.concatenate([[True], ~self.log.joined])[:, None]
        gusts = np.array([self.noise[name] for name in _process_names(self.log)[6:]]) * np.sqrt(self.gust_time / 2)
        precision = first * np.concatenate([START_PRECISION, gusts**-2])
        states_offset = np.zeros_like(precision)
        states_offset[:, 6:] = self.path.gust
        stiffness = np.array(list(CONSTANTS.values()))[self.places] ** -2
        return Prior(precision, states_offset, stiffness, offset + pull / stiffness)


class Sums(NamedTuple):
    """Sums over the samples of a channel, in units of its noise."""

    squares: float  # of the residuals
    trace: float  # of J P J^T, the number of samples that the path fits
    n_samples: int


def _residual_sums(process_names: Sequence[str], windows: Windows, posterior: Posterior) -> dict[str, Sums]:
    """Return the sums of each channel."""
    total = {name: np.zeros(3) for name in (*process_names, *MEASUREMENTS)}
    for first, process, measurements in windows:
        for names, rows in ((process_names, process), (MEASUREMENTS, measurements)):
            change = rows.changes(posterior.states[first:, :, None], posterior.constants[:, None])[..., 0]
            spread = np.square(rows.changes(posterior.state_draws[first:], posterior.constant_draws)).mean(axis=-1)
            used = np.any(rows.d_state != 0, axis=2)
            squares = np.sum((rows.residual + change) ** 2, axis=0)
            for name, sums in zip(names, np.column_stack([squares, spread.sum(axis=0), used.sum(axis=0)]), strict=True):
                total[name] += sums
    return {name: Sums(*sums) for name, sums in total.items()}


def _variance_components(
    sums: Mapping[str, Sums], noise: Mapping[str, float], learn: Collection[str], pace: float
) -> dict[str, float]:
    """Return the new standard deviation of each channel in ``learn`` that was sampled.

    For a random walk measured with other noise, the share of the residuals grows with the variance and the redundancy
    with its root. The plain iteration would halve the error in each step, so the step is divided by one minus that
    slope. ``pace`` shortens it, so that the search does not oscillate.
    """
    new = {}
    for name in learn:
        if name not in sums or not sums[name].n_samples:
            continue
        squares, trace, count = sums[name]
        guessed, least = (PRIOR_COUNT, MIN_NOISE) if name in NOISE else (0, LEAST_GUST)
        redundancy = max(count - trace, 1.0)
        guess = guessed * (NOISE.get(name, 0.0) / noise[name]) ** 2
        ratio = (squares + guess) / (redundancy + guessed)
        slope = squares / (squares + guess + MIN_NOISE) - redundancy / (redundancy + guessed) / 2
        stride = pace / (1 - min(slope, 0.5) * (1 - redundancy / count))
        new[name] = max(noise[name] * ratio ** (stride / 2), least)
    return new


def _scale_gradient(path: FlightPath, sums: Mapping[str, Sums]) -> Vector:
    """Return the gradient by the scale factors that the joint maximum of path and scales lacks.

    A larger scale lets smaller gusts explain the same air data, so the joint maximum overestimates it. The marginal
    likelihood adds the gradient of a determinant: trace / (1 + scale).
    """
    gradient = np.zeros(len(CONSTANTS))
    for name in AIR_DATA:
        place = PLACE[f"{name}_scale"]
        gradient[place] = sums[name].trace / (1 + path.constants[place])
    return gradient


def _air_std(path: FlightPath, posterior: Posterior, places: list[int]) -> Vector:
    squares = np.zeros(3)
    for first in range(0, len(path.gust), WINDOW):
        rows = air_data_equations(path.part(first, first + WINDOW))
        rows = rows._replace(d_constants=rows.d_constants[..., places])
        errors = rows.changes(posterior.state_draws[first:], posterior.constant_draws)
        squares += np.square(errors).mean(axis=-1).sum(axis=0)
    return np.sqrt(squares / len(path.gust))
