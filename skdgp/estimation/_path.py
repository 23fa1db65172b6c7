r"""The most likely path of a flight and the noise of its sensors (flight-path reconstruction).

States, measurements and their equations stand in ``_path_equations.py``. Gauss-Newton steps on the path
alternate with Foerstner's estimate of the variance components (Foerstner 1979): with the residuals e
of a channel in n samples, and the covariance P of the path,

.. math:: \sigma^2 = \frac{\sum e^2}{n - \operatorname{tr} J P J^T}.

At the fixed point the gradient of the marginal likelihood is zero (Searle, Casella & McCulloch 1992,
section 8.3). The traces are estimated from draws of the posterior.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import LEAST_GUST
from skdgp.estimation._least_squares import Equations, GaussianPrior, Posterior, solve
from skdgp.estimation._path_equations import (
    GUST,
    LATE,
    MEASUREMENT_NOISE,
    MIRROR,
    ODD,
    PLACE,
    PROCESS_NOISE,
    FlightPath,
    measurement_equations,
    process_equations,
)
from skdgp.estimation._sensors import (
    AIR,
    FORCE,
    INERTIAL_BIASES,
    MEAN_WIND,
    PATH_CONSTANTS,
    PATH_NOISE,
    RATE,
    FlightSensors,
    white_noise,
)
from skdgp.estimation._settings import PATH_SETTINGS, PathSettings

CALIBRATED = (*INERTIAL_BIASES, *MEAN_WIND)
"""Constants that are estimated where sensors have no lags."""


class PathEstimate(NamedTuple):
    """The path, the noise of the sensors, and the uncertainty of the constants.

    Attributes
    ----------
    path : FlightPath
    noise : dict of str to float
        Standard deviations [SI].
    covariance : ndarray (f, f)
        Of the free constants.
    converged : bool
        Whether the search converged; else the sensors contradict one another.
    """

    path: FlightPath
    noise: dict[str, float]
    covariance: Matrix
    converged: bool


def estimate_path(
    sensors: FlightSensors,
    noise: dict[str, float],
    *,
    learn: Collection[str],
    free: Sequence[str] = CALIBRATED,
    settings: PathSettings = PATH_SETTINGS,
) -> PathEstimate:
    """Return the most likely path, and the maximum-likelihood noise of the channels in ``learn``.

    The path minimises the squared residuals of its equations in units of their noise (data
    compatibility check: Klein & Morelli 2006, chapter 10; Jategaonkar 2006, chapter 10).

    Parameters
    ----------
    sensors : FlightSensors
    noise : dict of str to float
        Initial standard deviations, by the names in PATH_NOISE and GUSTS.
    learn : collection of str
        Channels whose noise is estimated.
    free : sequence of str
        Constants that are estimated, with prior means of zero.
    settings : PathSettings

    Returns
    -------
    PathEstimate
    """
    search = _Search(sensors, free, settings)
    path = FlightPath.initial(sensors)
    delays = np.zeros(len(LATE), dtype=int)
    stride = 1.0
    last = np.zeros(len(free))
    for number in range(settings.max_steps):
        if number <= settings.delay_steps:
            delays = search.delays(path)
        equations = search.equations(path, noise, delays)
        posterior = solve(*equations, search.prior(path, noise), search.draws)
        # the full step of the constants, in standard deviations
        move = posterior.constants / np.sqrt(np.diag(posterior.covariance))
        if move @ last < -settings.overshoot * last @ last:
            stride /= 2
        last = move
        path = path.moved(stride * posterior.states, search.spread(stride * posterior.constants))
        before = noise
        pace = min(1.0, 10 / (number + 1))
        sums = search.residual_sums(equations, posterior)
        noise = noise | _variance_components(sums, noise, learn, pace, settings)
        changes = [abs(np.log(noise[name] / before[name])) for name in learn]
        steady = all(change < settings.tolerance for change in changes)
        converged = number > 0 and steady and _is_small(posterior, settings.tolerance)
        if converged:
            break
    if not search.has_alpha:
        noise = noise | {"gust_vertical": noise["gust_horizontal"]}
    return PathEstimate(path, noise, posterior.covariance, converged)


class _Search:
    """Equations, prior and draws of the path of one flight with some free constants."""

    def __init__(self, sensors: FlightSensors, free: Sequence[str], settings: PathSettings) -> None:
        self.sensors = sensors
        self.settings = settings
        self.places = [PLACE[name] for name in free]
        self.draws = _mirrored_draws(len(sensors.time), free, settings.n_draws)
        self.step = np.diff(sensors.time)
        self.correlation = np.exp(-self.step / settings.gust_time)  # of gusts over a step
        self.has_alpha = bool(np.isfinite(sensors.readings[:, AIR.start + 1]).any())
        # without an alpha vane vertical gusts are like horizontal ones
        gust_down = PROCESS_NOISE[-1] if self.has_alpha else "gust_horizontal"
        self.process_noise = (*PROCESS_NOISE[:-1], gust_down)

    def delays(self, path: FlightPath) -> Indices:
        """Return the lags of GPS and attitude in whole samples, (6,)."""
        interval = np.median(self.step) if len(self.step) else np.inf
        return np.round(path.constants[LATE] / interval).astype(int)

    def spread(self, constants: Vector) -> Vector:
        """Return all constants, zeros but for the free ones."""
        every = np.zeros(len(PATH_CONSTANTS))
        every[self.places] = constants
        return every

    def equations(
        self, path: FlightPath, noise: Mapping[str, float], delays: Indices
    ) -> tuple[Equations, Equations]:
        """Return process and measurement equations in units of their noise, by the free constants."""
        scale = np.tile([noise[name] for name in self.process_noise], (len(self.step), 1))
        # change of a Gauss-Markov process of correlation time T in a step
        growth = self.settings.gust_time / 2 * (1 - self.correlation**2)
        scale[:, GUST] *= np.sqrt(growth)[:, None]
        process = process_equations(path, self.sensors, self.correlation)
        measured = measurement_equations(path, self.sensors, delays, self.settings.least_airspeed)
        sensor_noise = np.array([noise[name] for name in MEASUREMENT_NOISE])
        return process.whitened(scale, self.places), measured.whitened(sensor_noise, self.places)

    def prior(self, path: FlightPath, noise: Mapping[str, float]) -> GaussianPrior:
        """Return the prior of the constants, and a wide one of states where segments begin."""
        begins = np.append(True, ~self.sensors.joined)[:, None]
        walk = np.array([noise[name] for name in self.process_noise[GUST]])
        gust_std = walk * np.sqrt(self.settings.gust_time / 2)  # stationary
        start_std = np.repeat([self.settings.start_velocity, self.settings.start_attitude], 3)
        precision = begins * np.concatenate([start_std**-2.0, gust_std**-2])
        offset = np.zeros_like(precision)
        offset[:, GUST] = path.gust
        constant_std = np.array(list(PATH_CONSTANTS.values()))[self.places]
        return GaussianPrior(precision, offset, constant_std**-2, path.constants[self.places])

    def residual_sums(
        self, equations: tuple[Equations, Equations], posterior: Posterior
    ) -> dict[str, Vector]:
        """Return sum of squared residuals, trace of J P J^T and samples of each channel, in units of its noise."""
        states = posterior.states[..., None]
        constants = posterior.constants[:, None]
        sums: dict[str, Vector] = {}
        names = (self.process_noise, MEASUREMENT_NOISE)
        for channels, rows in zip(names, equations, strict=True):
            residual = rows.residual + rows.changes(states, constants)[..., 0]
            squares = np.sum(residual**2, axis=0)
            draws = rows.changes(posterior.state_draws, posterior.constant_draws)
            trace = np.square(draws).mean(axis=-1).sum(axis=0)
            count = np.any(rows.d_state != 0, axis=2).sum(axis=0)
            for name, *values in zip(channels, squares, trace, count, strict=True):
                sums[name] = sums.get(name, 0.0) + np.array(values)
        return sums


def _mirrored_draws(n_states: int, free: Sequence[str], n_draws: int) -> Matrix:
    """Return standard normal numbers (9 n + f, n_draws), a set that a mirror at the x-z plane does not change.

    So a mirrored flight, which is the same physics, has the same noise and the mirrored path up to
    rounding.
    """
    constants = [-1.0 if name in ODD else 1.0 for name in free]
    sign = np.append(np.tile(MIRROR, n_states), constants)
    half = np.random.default_rng(0).standard_normal((len(sign), n_draws // 2))
    return np.column_stack([half, sign[:, None] * half])


def _is_small(posterior: Posterior, tolerance: float) -> bool:
    """Return whether the mean square step of each state is below ``tolerance`` standard deviations."""
    moved = np.mean(posterior.states**2, axis=0)
    variance = np.mean(posterior.state_draws**2, axis=(0, 2))
    return bool(np.all(moved < tolerance**2 * variance))


def _variance_components(
    sums: Mapping[str, Vector],
    noise: Mapping[str, float],
    learn: Collection[str],
    pace: float,
    settings: PathSettings,
) -> dict[str, float]:
    """Return the new standard deviation of each channel in ``learn`` that was sampled.

    For a random walk measured with other noise, the fraction of the residuals grows with the
    variance and the redundancy with its root. The plain iteration would halve the error in each
    step, so the step is divided by one minus that slope. ``pace`` shortens it, so that the search
    does not oscillate.
    """
    new = {}
    for name in learn:
        squares, trace, count = sums.get(name, np.zeros(3))
        if not count:
            continue
        # the initial noise of a sensor counts as some residuals; gusts have no such prior
        is_sensor = name in PATH_NOISE
        prior_count = settings.prior_count if is_sensor else 0.0
        least = settings.least_noise if is_sensor else LEAST_GUST
        prior_squares = prior_count * (PATH_NOISE.get(name, 0.0) / noise[name]) ** 2
        redundancy = max(count - trace, 1.0)
        total = squares + prior_squares
        ratio = total / (redundancy + prior_count)
        slope = squares / (total + settings.least_noise)
        slope -= redundancy / (redundancy + prior_count) / 2
        stride = pace / (1 - min(slope, 0.5) * (1 - redundancy / count))
        new[name] = max(noise[name] * ratio ** (stride / 2), least)
    return new


def overlapping_parts(
    n: int, most: int, settings: PathSettings = PATH_SETTINGS
) -> list[tuple[slice, slice]]:
    """Return overlapping slices of n rows, and in each slice the rows between the overlaps.

    Slices are equally long, at most ``most`` rows and one part in ``settings.overlap`` more on
    either side.
    """
    margin = most // settings.overlap
    n_parts = -(-n // most)
    edges = np.linspace(0, n, n_parts + 1).round().astype(int).tolist()
    parts = []
    for first, last in pairwise(edges):
        start = max(first - margin, 0)
        part = slice(start, min(last + margin, n))
        inner = slice(first - start, last - start)
        parts.append((part, inner))
    return parts


class Contradiction(NamedTuple):
    """A sensor whose residuals along the path exceed its white noise, standard deviations [SI]."""

    sensor: str
    residual: float
    noise: float


INERTIAL_SENSORS = {"gyro": RATE, "accelerometer": FORCE}
AIR_SENSORS = {"airspeed": slice(6, 7), "alpha": slice(7, 8), "beta": slice(8, 9)}


def contradictions(
    flights: Sequence[FlightSensors],
    residuals: Mapping[str, float],
    settings: PathSettings = PATH_SETTINGS,
) -> list[Contradiction]:
    """Return the sensors whose residuals along the path exceed their white noise by a ratio.

    The ratio is ``air_ratio`` or ``inertial_ratio`` of the settings. ``residuals`` are the noises
    of `PathEstimate.noise` [SI]; white noise is estimated from third differences of the readings.
    """
    contradicted = []
    for sensor, columns in (INERTIAL_SENSORS | AIR_SENSORS).items():
        is_inertial = sensor in INERTIAL_SENSORS
        largest = settings.inertial_ratio if is_inertial else settings.air_ratio
        residual = residuals[sensor]
        noise = white_noise(flights, columns)
        if residual > largest * noise:
            contradicted.append(Contradiction(sensor, residual, noise))
    return contradicted
