r"""The most likely path of a flight, the noise of its sensors and its columns (flight-path reconstruction).

States, measurements and their equations stand in ``_path_equations.py``. Gauss-Newton steps on the path
alternate with Foerstner's estimate of the variance components (Foerstner 1979): with the residuals e
of a channel in n samples, and the covariance P of the path,

.. math:: \sigma^2 = \frac{\sum e^2}{n - \operatorname{tr} J P J^T}.

A step of it multiplies the variance by the ratio of the two sides to the power of ``stride``. The initial
noise of a sensor counts as some samples in numerator and denominator. Three numbers scale a step:
``fraction`` is of the step of the path, halved where the constants overshoot and doubled where they lag;
``pace`` is of the step of the noise, ever less in late steps; ``stride`` is ``pace`` over one minus the slope
of the plain iteration.
At the fixed point the gradient of the marginal likelihood is zero (Searle, Casella & McCulloch 1992,
section 8.3). The traces are estimated from draws of the posterior.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    EARTH_VELOCITY,
    EULER,
    RATES,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import air_data, rotation_to_euler
from skdgp._flight.sensor_position import acceleration_by_rotation
from skdgp._flight.smoothing import differentiate, smooth
from skdgp._flight.tables import interpolate_missing, unwrapped
from skdgp.estimation._least_squares import Equations, GaussianPrior, Posterior, solve
from skdgp.estimation._path_equations import (
    ATTITUDE_LAG,
    EQUATION_NOISE,
    FORCE_ROWS,
    GUST,
    GUST_ROWS,
    INERTIAL_ROWS,
    MIRROR,
    ODD,
    PLACE,
    VELOCITY_LAG,
    FlightPath,
    path_equations,
)
from skdgp.estimation._sensors import (
    AIR_READINGS,
    GUST_TIME,
    GUSTS,
    INERTIAL_BIASES,
    LAGS,
    MEAN_WIND,
    PATH_CONSTANTS,
    PATH_NOISE,
    READINGS_OF,
    FlightSensors,
    flights_of,
    noise_by_differences,
)

CALIBRATED = (*INERTIAL_BIASES, *MEAN_WIND)
"""Constants that are estimated where sensors have no lags."""
LEAST_NOISE = 0.2
"""Least noise of a sensor, as a fraction of the usual one: recorders smooth, and errors last; guess."""
ANGLE_RATES = ("alpha_dot", "beta_dot")
MOTION_COLUMNS = (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, *WIND)
RECONSTRUCTED = (*AIR_DATA, *ANGLE_RATES, *MOTION_COLUMNS)
"""Columns of a reconstructed flight."""
PRIOR_STD = np.array(list(PATH_CONSTANTS.values()))
"""Prior standard deviations of all constants (c,), of means of zero."""


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
        Whether the search converged; else the sensors may contradict one another.
    off_path : ndarray (n - 1, 6)
        Readings of accelerometers and gyros by the path less the measured ones, means of two samples [SI].
    """

    path: FlightPath
    noise: dict[str, float]
    covariance: Matrix
    converged: bool
    off_path: Matrix


def estimate_path(
    sensors: FlightSensors,
    noise: dict[str, float],
    *,
    learn: Collection[str],
    free: Sequence[str] = CALIBRATED,
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

    Returns
    -------
    PathEstimate
    """
    places = np.array([PLACE[name] for name in free])
    # draws from the posterior that estimate traces, an even number; trials
    draws = _mirrored_draws(len(sensors.time), free, 32)
    time_step = np.diff(sensors.time)
    usual_step = np.median(time_step) if len(time_step) else np.inf
    correlation = np.exp(-time_step / GUST_TIME)  # of gusts over a step
    channels = list(EQUATION_NOISE)
    if not np.isfinite(sensors.readings[:, AIR_READINGS.start + 1]).any():
        # without an alpha vane vertical gusts are like horizontal ones
        channels[GUST_ROWS.stop - 1] = "gust_horizontal"
    path = FlightPath.initial(sensors)
    last_step = np.zeros(len(free))
    fraction = 1.0  # of a step of the path that is taken
    # Gauss-Newton steps at most; trials
    for number in range(40):
        # steps that may change lags by whole samples; trials
        if number <= 6:
            lags = path.constants[[VELOCITY_LAG, ATTITUDE_LAG]]
            delays = np.round(lags / usual_step).astype(int)
        stds = np.array([noise[name] for name in channels])
        equations = path_equations(path, sensors, correlation, delays)
        equations.whiten(_scales(stds, correlation))
        posterior = solve(equations, _prior(path, sensors, stds), places, draws)

        # the full step of the constants, in standard deviations
        step = posterior.constants[places] / np.sqrt(np.diag(posterior.covariance))
        # fraction of a step that the next one takes back or repeats, above which steps are halved or doubled; trials
        repeated = step @ last_step
        if abs(repeated) > 0.5 * last_step @ last_step:
            fraction = min(1.0, fraction * 2.0 ** np.sign(repeated))
        last_step = step
        path = path.moved(fraction * posterior.states, fraction * posterior.constants)

        # steps that change the noise in full; later ones ever less, so that the search does not oscillate; trials
        pace = min(1.0, 10.0 / (number + 1))
        sums = _residual_sums(equations, posterior, channels)
        noise, largest_change = _moved_noise(noise, sums, learn, pace)

        # largest change of the logarithm of a noise, and of a state in standard deviations
        tolerance = 0.02
        is_steady = largest_change < tolerance and _is_small(posterior, tolerance)
        converged = number > 0 and is_steady
        if converged:
            break
    noise = noise | {"gust_vertical": noise[channels[GUST_ROWS.stop - 1]]}
    # a copy, as a view would keep all equations of this part of the flight in memory
    equations = path_equations(path, sensors, correlation, delays)
    off_path = equations.residual[:-1, INERTIAL_ROWS].copy()
    return PathEstimate(path, noise, posterior.covariance, converged, off_path)


def ground_path(sensors: FlightSensors) -> PathEstimate:
    """Return the path without air data, with biases of the inertial sensors and lags of GPS and attitude."""
    learn = PATH_NOISE.keys() - {*AIR_DATA}
    free = [*INERTIAL_BIASES, *LAGS]
    return estimate_path(sensors.without_air_data(), PATH_NOISE | GUSTS, learn=learn, free=free)


def ground_paths(table: pd.DataFrame) -> list[PathEstimate]:
    """Return the path of each flight of a table without air data."""
    return [ground_path(flight.sensors) for flight in flights_of(table)]


def _scales(stds: Vector, correlation: Vector) -> Matrix:
    """Return the noise of the equations of each sample (n, m), by the noise of the channels."""
    scale = np.tile(stds, (len(correlation) + 1, 1))
    # change of a Gauss-Markov process of correlation time T in a step
    growth = GUST_TIME / 2 * (1 - correlation**2)
    scale[:-1, GUST_ROWS] *= np.sqrt(growth)[:, None]
    return scale


def _prior(path: FlightPath, sensors: FlightSensors, stds: Vector) -> GaussianPrior:
    """Return the prior of constants and gusts, and a wide one of velocity and attitude where segments begin.

    The mean of the latter is the path so far, by an offset of zero: it dampens steps and pulls to no value.
    """
    gust_std = stds[GUST_ROWS] * np.sqrt(GUST_TIME / 2)  # stationary
    # [m/s] and [rad]; wide
    start_std = np.repeat([100.0, 1.0], 3)
    begins = np.append(True, ~sensors.joined)[:, None]
    precision = begins * np.concatenate([start_std, gust_std]) ** -2.0
    offset = np.zeros_like(precision)
    offset[:, GUST] = path.gust
    return GaussianPrior(precision, offset, PRIOR_STD**-2, path.constants)


def _residual_sums(
    equations: Equations, posterior: Posterior, channels: Sequence[str]
) -> dict[str, Vector]:
    """Return sums over the residuals of each channel that was sampled, in units of its noise.

    Of squares, the trace of J P J^T, and their number.
    """
    squares = np.zeros(len(channels))
    traces = np.zeros(len(channels))
    states, constants = posterior.states[..., None], posterior.constants[:, None]
    for samples in equations.parts:
        change = equations.changes(samples, states, constants)[..., 0]
        squares += np.sum((equations.residual[samples] + change) ** 2, axis=0)
        draws = equations.changes(samples, posterior.state_draws, posterior.constant_draws)
        traces += np.einsum("lmk,lmk->m", draws, draws) / draws.shape[2]
    counts = np.any(equations.d_state != 0, axis=2).sum(axis=0)
    sums = np.column_stack([squares, traces, counts])
    by_channel = {}
    for name in dict.fromkeys(channels):
        total = sums[np.array(channels) == name].sum(axis=0)
        if total[-1]:
            by_channel[name] = total
    return by_channel


def _moved_noise(
    noise: dict[str, float], sums: dict[str, Vector], learn: Collection[str], pace: float
) -> tuple[dict[str, float], float]:
    """Return the noise, moved in the channels of ``learn`` that were sampled, and the largest change of a logarithm."""
    moved = noise.copy()
    largest_change = 0.0
    for name in sums.keys() & learn:
        moved[name] = _variance_component(name, noise[name], sums[name], pace)
        largest_change = max(largest_change, abs(np.log(moved[name] / noise[name])))
    return moved, largest_change


def _mirrored_draws(n_states: int, free: Sequence[str], n_draws: int) -> Matrix:
    """Return standard normal numbers (9 n + f, n_draws), a set that a mirror at the x-z plane does not change.

    So a mirrored flight, which is the same physics, has the same noise and the mirrored path up to
    rounding.
    """
    constants = [-1.0 if name in ODD else 1.0 for name in free]
    sign = np.append(np.tile(MIRROR, n_states), constants)
    half = np.random.default_rng(0).standard_normal((len(sign), n_draws // 2))
    # in the order that LAPACK takes without a transposition
    return np.asfortranarray(np.hstack([half, sign[:, None] * half]))


def _is_small(posterior: Posterior, tolerance: float) -> bool:
    """Return whether the mean square step of each state is below ``tolerance`` standard deviations."""
    moved = np.mean(posterior.states**2, axis=0)
    draws = posterior.state_draws
    variance = np.einsum("nsk,nsk->s", draws, draws) / (len(draws) * draws.shape[2])
    return bool(np.all(moved < tolerance**2 * variance))


def _variance_component(name: str, std: float, sums: Vector, pace: float) -> float:
    r"""Return the new standard deviation of a channel, whose residuals are in units of the one before, ``std``.

    With the redundancy :math:`\rho = n - \operatorname{tr} J P J^T` and prior samples of squares :math:`s_0`
    and number :math:`n_0`, the plain iteration is :math:`\sigma'^2 = (\sum e^2 + s_0) / (\rho + n_0)`. For a
    random walk measured with other noise, :math:`\sum e^2` grows with :math:`\sigma^2` and :math:`\rho`
    with :math:`\sigma`, so that

    .. math:: \frac{d \log \sigma'^2}{d \log \sigma^2} =
              \frac{\sum e^2}{\sum e^2 + s_0} - \frac{1}{2} \frac{\rho}{\rho + n_0},

    here times :math:`1 - \rho / n`. It would halve the error in each step, so the step is divided by one
    minus this slope. ``pace`` shortens it, so that the search does not oscillate.
    """
    squares, trace, n_samples = sums.tolist()
    # the initial noise of a sensor counts as some residuals; gusts have no such prior
    prior_count = 0.0
    prior_squares = 0.0
    least = 1e-3  # [m/s], of calm air
    if name in PATH_NOISE:
        # residuals that the initial noise of a sensor counts for, where a flight shows nothing; guess
        prior_count = 10.0
        prior_squares = prior_count * (PATH_NOISE[name] / std) ** 2
        least = LEAST_NOISE * PATH_NOISE[name]
    redundancy = max(n_samples - trace, 1.0)
    total = squares + prior_squares
    weight = redundancy + prior_count
    slope = squares / (total + np.finfo(float).tiny) - redundancy / weight / 2
    stride = pace / (1 - min(slope, 0.5) * (1 - redundancy / n_samples))
    return max(std * (total / weight) ** (stride / 2), least)


def contradictions(
    flights: Sequence[FlightSensors], residuals: Mapping[str, float]
) -> list[Finding]:
    """Return the sensors whose residuals along the path exceed their white noise by a ratio.

    ``residuals`` are the noises
    of `PathEstimate.noise` [SI]; white noise is estimated from third differences of the readings.
    A sensor that shows hardly any was smoothed, so its noise is not known.
    """
    contradicted = []
    for sensor, columns in READINGS_OF.items():
        # ratios by trials: 30 s of sound inertial sensors show up to 4.4
        largest = 1.4 if sensor in AIR_DATA else 6.0
        residual = residuals[sensor]
        noise = noise_by_differences(flights, columns)
        if residual > largest * noise:
            is_smoothed = noise < LEAST_NOISE * PATH_NOISE[sensor]
            numbers = {"residual": residual, "noise": noise, "is_smoothed": is_smoothed}
            contradicted.append(Finding(Code.SENSOR_CONTRADICTS, channel=sensor, **numbers))
    return contradicted


def apparent_arm(
    flights: Sequence[tuple[FlightSensors, PathEstimate]],
) -> tuple[Vector, float]:
    """Return the position (3,) of inertial sensors [m] by which they read most of what they read off their paths.

    And the share of this that it explains. Paths follow a part of the readings, so the true position is farther.
    """
    arms, readings = [], []
    for sensors, estimate in flights:
        _, measured = estimate.path.inertial(sensors)
        rates = smooth(measured, sensors.time, shrink=False, is_quiet=True)
        spin = differentiate(measured, sensors.time, shrink=False, is_quiet=True)
        axes = [acceleration_by_rotation(spin, rates, axis).ravel() for axis in np.eye(3)]
        off_path = np.zeros_like(measured)
        off_path[:-1] = -estimate.off_path[:, FORCE_ROWS]
        arms.append(np.column_stack(axes))
        readings.append(off_path.ravel())
    x, y = np.concatenate(arms), np.concatenate(readings)
    known = np.isfinite(x).all(axis=1)
    arm = np.asarray(np.linalg.lstsq(x[known], y[known])[0])
    return arm, 1.0 - float(np.sum((y - x @ arm)[known] ** 2) / np.sum(y[known] ** 2))


def path_columns(path: FlightPath, sensors: FlightSensors) -> dict[str, Vector]:
    """Return the columns `RECONSTRUCTED` (n,) by a flight's path, SI units and radians."""
    air = np.column_stack(air_data(path.air_velocity()))
    euler = rotation_to_euler(path.attitude)
    force, rate = path.inertial(sensors)
    return _columns(sensors, air, np.hstack([rate, force, euler, path.velocity, path.wind()]))


def air_columns(air: pd.DataFrame, sensors: FlightSensors) -> dict[str, Vector]:
    """Return reconstructed columns (n,) of a flight by ``air``, its n rows of `AirMotion.air`.

    Between the rows that records contain values are interpolated; rates of alpha and beta [rad/s]
    are the derivatives of cubic splines.
    """
    # angles of thinned rows: between pi and -pi is pi, not zero
    motion = unwrapped(air, [*AIR_DATA, *MOTION_COLUMNS])
    values = interpolate_missing(sensors.time, motion)
    return _columns(sensors, values[:, : len(AIR_DATA)], values[:, len(AIR_DATA) :])


def _columns(sensors: FlightSensors, air: Matrix, motion: Matrix) -> dict[str, Vector]:
    """Return the columns `RECONSTRUCTED` by air data (n, 3) and motion (n, k)."""
    rates = differentiate(air[:, 1:], sensors.time, cutoff=None)
    columns = np.hstack([air, rates, motion])
    return dict(zip(RECONSTRUCTED, columns.T, strict=True))
