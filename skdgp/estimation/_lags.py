r"""Lags of air data, surfaces, attitude and GPS against the inertial sensors.

Attitude and GPS velocity are late by constants of the path over the ground (``_path.py``). Vanes and
surfaces are related to rates :math:`\omega` and specific force f by local linear models,

.. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
          (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

within a band of frequencies. The lag maximises the profile likelihood
:math:`-\frac{1}{2} \sum n \log \mathrm{RSS}` (Jategaonkar 2006, chapter 10). Over a short record a lag looks like a
sum of rates and forces, as :math:`\dot\alpha = q + (a_z + g_z) / V`. There the vanes are compared with the
motion of the aircraft alone, the integrals of this rate and of
:math:`\dot\beta = p \sin\alpha - r \cos\alpha + (a_y + g_y) / V`; gusts are then part of the error.

Surfaces that are early are commands. Then their servos have a first-order lag T,
:math:`T \dot\delta = c - \delta`, besides a delay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy import linalg, optimize, signal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.stats import norm as normal
from scipy.stats import sem
from scipy.stats import t as student

from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, ELEVONS, MIXED, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.clock import flight_codes, uniform_grid
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp._flight.sensor_position import at_centre_of_gravity
from skdgp._flight.smoothing import low_pass
from skdgp._flight.tables import FlightTable, has_values, interpolate_missing, numeric
from skdgp._flight.units import check_radians
from skdgp.estimation._path import estimate_path
from skdgp.estimation._sensors import (
    GUSTS,
    MEAN_WIND,
    PATH_CONSTANTS,
    PATH_NOISE,
    flights_of,
    missing_channels,
)
from skdgp.estimation._servos import servo_output
from skdgp.estimation._settings import LAG_SETTINGS as SETTINGS

INERTIAL = (*SPECIFIC_FORCE, *RATES)
ATTITUDE = ("phi", "theta")
# angles of the flow by the motion of the aircraft alone
MOTION = ("alpha_of_motion", "beta_of_motion")
ACCELERATIONS = tuple(f"{name}_dot" for name in RATES)
# Largest lag and delay of servos, over the lag without servos, and number of lags that are tried
LONGEST_LAG = 3.5
LONGEST_DELAY = 1.5
N_SERVO_LAGS = 29
# Factor by which correlated residuals make differences of twice the log likelihood too large: errors over their
# standard deviations were then 0.8, 0.8, 0.8 and 1.2, of a flying wing with four pairs of lag and delay
INFLATION = 3.0
PATH_LAGS = {"attitude": "attitude_lag", "gps": "velocity_lag"}
"""Constants of a path by group of channels."""


class Lag(NamedTuple):
    """A lag [s], positive if late, and its standard deviation [s]; NaN if the lag is unknown."""

    value: float
    std: float
    removal: float | None = None  #: What to remove [s]; None: the lag, where it is significant
    rate_limit: float = np.inf  #: Of servos, in the unit of the surfaces per second
    delay_std: float = 0.0  #: Of the delay beside the lag of servos [s]

    def is_significant(self) -> bool:
        """Return whether the lag exceeds ``significance`` standard deviations."""
        return abs(self.value) > SETTINGS.significance * self.std


UNKNOWN = Lag(0.0, np.nan)
SURE = 2.0  # standard deviations


def removable(lag: Lag) -> float:
    """Return the lag to remove [s], zero where it is not significant or too small to change a model."""
    if lag.removal is not None:
        return lag.removal
    is_large = abs(lag.value) >= SETTINGS.least_lag
    return lag.value if lag.is_significant() and is_large else 0.0


def estimate_lags(table: pd.DataFrame) -> dict[str, Lag]:
    r"""Return the lags of air data, surfaces, servos, attitude and GPS by group, against inertial sensors.

    Lags of surfaces, servos and air data maximise the profile likelihood
    :math:`-\frac{1}{2} \sum n \log \mathrm{RSS}` of local linear models (Jategaonkar 2006, chapter
    10); that of servos is the time constant of a first-order lag, of surfaces that are early, and
    that of surfaces is then the delay that they are early by. Lags of attitude and GPS are constants of
    the path over the ground. A lag of std NaN is unknown. Without vanes the lag of servos is not
    removed, as it is a parameter of `estimate_air_motion`, and a delay only from a step of the log on.
    """
    segments = _segments_of(at_centre_of_gravity(table))
    long_segments = [segment for segment in segments if segment.seconds > SETTINGS.long]
    servos = UNKNOWN
    surfaces = _most_likely_lag(long_segments, ALL_SURFACES, _turning_by_surfaces)
    servos_and_delay = None
    if removable(surfaces) < 0:
        servos_and_delay = _most_likely_servos(segments, surfaces)
    if servos_and_delay is not None:
        servos, surfaces = servos_and_delay
        lag = removable(servos)
        segments = [segment.behind_servos(lag) for segment in segments]
    surface_lag = removable(surfaces)

    vanes = _most_likely_lag(
        long_segments,
        VANES,
        lambda segment, lag: (segment.channels(VANES, lag), segment.predictors(surface_lag)),
    )
    by_motion = _lag_behind_motion(segments)
    if np.isnan(vanes.std) or by_motion.std < vanes.std:
        vanes = by_motion
    of_path = dict.fromkeys(PATH_LAGS, UNKNOWN)
    if segments and not missing_channels(table):
        of_path = _lags_of_path(table)
        if not has_values(table, *VANES):
            log_step = max(segment.log_step for segment in segments)
            servos, surfaces = _left_to_filter(servos_and_delay, log_step)
    return {"air": vanes, "surfaces": surfaces, "servos": servos} | of_path


def _left_to_filter(servos_and_delay: tuple[Lag, Lag] | None, log_step: float) -> tuple[Lag, Lag]:
    """Return the lags of servos and of their commands, with what is removed before `estimate_air_motion`.

    Its lag of servos takes in the half step by which commands are late that hold between samples, and
    what is left of the delay. Two standard deviations less than the delay are removed, but at most 10 ms
    less: surfaces that are too late follow the motion that an autopilot answers, and slopes are too small.
    """
    if servos_and_delay is None:
        return UNKNOWN, UNKNOWN
    servos, commands = servos_and_delay
    delay = commands.removal or 0.0
    margin = min(SURE * servos.delay_std, SETTINGS.least_lag)
    removed = delay + margin if abs(delay) >= log_step else 0.0
    return servos._replace(removal=0.0), commands._replace(removal=removed)


def _lags_of_path(table: pd.DataFrame) -> dict[str, Lag]:
    """Return the lags of attitude and GPS velocity against gyros and accelerometers, over all flights.

    Vanes are left out, as gusts would resemble a lag. Flights are weighted by their precision, with
    the prior counted once.
    """
    check_radians(table, ("theta", *RATES))
    lags = list(PATH_LAGS.values())
    free = ["p_bias", "q_bias", "r_bias", *lags, *MEAN_WIND]
    places = [free.index(name) for name in lags]
    noise = PATH_NOISE | GUSTS
    prior_precision = np.diag([PATH_CONSTANTS[name] ** -2 for name in lags])
    precision = prior_precision.copy()
    weighted = np.zeros(len(lags))
    first = _first_rows(table).drop(columns=[*VANES], errors="ignore")
    for flight in flights_of(first):
        solved = estimate_path(flight.sensors, noise, learn=noise, free=free)
        flight_precision = np.linalg.inv(solved.covariance[np.ix_(places, places)])
        weighted += flight_precision @ solved.path.constant(*lags)
        precision += flight_precision - prior_precision
    covariance = np.linalg.inv(precision)
    values = covariance @ weighted
    stds = np.sqrt(np.diag(covariance))
    return dict(zip(PATH_LAGS, map(Lag, values.tolist(), stds.tolist()), strict=True))


def _first_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the first minutes of each flight."""
    codes = flight_codes(table["flight"])[0] if "flight" in table else np.zeros(len(table))
    flights = table.groupby(codes)
    elapsed = table["time"] - flights["time"].transform("min")
    is_early = elapsed < SETTINGS.path_seconds
    return table[is_early & (flights.cumcount() < SETTINGS.path_rows)]


@dataclass(frozen=True)
class _Segment:
    """A gap-free segment: splines of its channels within the band, rates over V, accelerations over V^2."""

    splines: dict[str, CubicSpline]
    time: Vector  # (n,) without the ends of the segment [s]
    log_step: float  # step of the log [s]
    surfaces: dict[str, Vector]  # at the times of the splines, with all frequencies
    band: Matrix  # second-order sections of the filter of the band

    @classmethod
    def of(cls, time: Vector, table: pd.DataFrame) -> _Segment:
        """Return the segment of a table at increasing times."""
        clock = uniform_grid(time)[0]
        rate_hz = _rate_of(clock)
        low, high = _band_at(rate_hz)
        channels = _on_clock(time, table, clock)
        speed = _steady_speed(channels, rate_hz)
        if "airspeed" in channels:
            channels |= dict(zip(MOTION, _angles_of_motion(channels, speed, clock), strict=True))
        for name in RATES:
            rate = CubicSpline(clock, low_pass(channels[name], rate_hz, 2 * high))
            channels[f"{name}_dot"] = rate(clock, 1) / speed**2
            channels[name] /= speed
        for name in SPECIFIC_FORCE:
            channels[name] /= speed**2
        sections = signal.butter(2, (low, high), "bandpass", fs=rate_hz, output="sos")
        surfaces = {name: channels[name] for name in ALL_SURFACES if name in channels}
        splines = {}
        for name, values in channels.items():
            splines[name] = CubicSpline(clock, signal.sosfiltfilt(sections, values))
        step = 1 / min(rate_hz, SETTINGS.oversampling * high)
        inner = np.arange(clock[0] + SETTINGS.edge, clock[-1] - SETTINGS.edge, step)
        return cls(splines, inner, 1 / rate_hz, surfaces, sections)

    def deflections(self, lag: float, rate_limit: float = np.inf) -> Matrix:
        """Return the deflections (n, k) of servos of a first-order lag [s], with all their frequencies."""
        commands = np.column_stack([self.surfaces[name] for name in self.present(ALL_SURFACES)])
        return servo_output(commands, lag, self.log_step, rate_limit)

    def behind_servos(self, lag: float, rate_limit: float = np.inf) -> _Segment:
        """Return the segment with the deflections of servos of a first-order lag [s], in place of their commands."""
        splines = dict(self.splines)
        names = self.present(ALL_SURFACES)
        clock = splines[names[0]].x
        within_band = signal.sosfiltfilt(self.band, self.deflections(lag, rate_limit), axis=0)
        for name, values in zip(names, within_band.T, strict=True):
            splines[name] = CubicSpline(clock, values)
        return replace(self, splines=splines)

    def largest_rate(self, lag: float) -> float:
        """Return the largest rate of the surfaces behind servos of a first-order lag [s]."""
        return float(np.abs(np.diff(self.deflections(lag), axis=0)).max() / self.log_step)

    def earlier_surfaces(self) -> Matrix:
        """Return an orthonormal basis (n, k) of the surfaces of the last seconds."""
        delays = np.arange(0.0, SETTINGS.memory + SETTINGS.memory_step / 2, SETTINGS.memory_step)
        columns = [self.channels(ALL_SURFACES, -delay) for delay in delays]
        return _basis(np.hstack(columns), SETTINGS.rank_tolerance)

    @property
    def seconds(self) -> float:
        """Length of the segment without its ends [s]."""
        return np.ptp(self.time)

    def present(self, names: Sequence[str]) -> list[str]:
        """Return the names that this segment has; elevons in place of elevator and aileron."""
        left_out = MIXED if {*ELEVONS} <= {*self.splines} else ()
        return [name for name in names if name in self.splines and name not in left_out]

    def channels(self, names: Sequence[str], lag: float = 0.0) -> Matrix:
        """Return channels (n, k) within the band, corrected for a lag."""
        columns = [self.splines[name](self.time + lag) for name in self.present(names)]
        return np.reshape(columns, (len(columns), len(self.time))).T

    def predictors(self, surface_lag: float) -> Matrix:
        """Return specific force, rates and surfaces (n, p), surfaces corrected for a lag."""
        return np.hstack([self.channels(INERTIAL), self.channels(ALL_SURFACES, surface_lag)])


def _angles_of_motion(
    channels: Mapping[str, Vector], speed: Vector | float, clock: Vector
) -> tuple[Vector, Vector]:
    """Return alpha and beta (n,) by the motion alone, but for a constant; gravity where the attitude is known."""
    phi, theta = (channels.get(name, np.zeros(len(clock))) for name in ATTITUDE)
    alpha = np.mean(channels.get("alpha", 0.0))
    g_y = STANDARD_GRAVITY * np.cos(theta) * np.sin(phi)
    g_z = STANDARD_GRAVITY * np.cos(theta) * np.cos(phi)
    alpha_dot = channels["q"] + (channels["az"] + g_z) / speed
    beta_dot = channels["p"] * np.sin(alpha) - channels["r"] * np.cos(alpha)
    beta_dot = beta_dot + (channels["ay"] + g_y) / speed
    alpha_of_motion = cumulative_trapezoid(np.asarray(alpha_dot), clock, initial=0)
    beta_of_motion = cumulative_trapezoid(np.asarray(beta_dot), clock, initial=0)
    return np.asarray(alpha_of_motion), np.asarray(beta_of_motion)


def _steady_speed(channels: dict[str, Vector], rate_hz: float) -> Vector | float:
    """Return the airspeed below the band, (n,) [m/s]; one where it is not measured."""
    if "airspeed" not in channels:
        return 1.0
    speed = low_pass(channels["airspeed"], rate_hz, SETTINGS.steady_frequency)
    return np.maximum(speed, SETTINGS.least_speed * np.median(speed))


def _on_clock(time: Vector, table: pd.DataFrame, clock: Vector) -> dict[str, Vector]:
    """Return the channels of a segment on a uniform clock; of vanes and surfaces those that move."""
    names = [name for name in (*INERTIAL, "airspeed", *ATTITUDE) if has_values(table, name)]
    for name in (*VANES, *ALL_SURFACES):
        if has_values(table, name) and table[name].max() > table[name].min():
            names.append(name)
    values = interpolate_missing(time, numeric(table, names))
    return dict(zip(names, CubicSpline(time, values)(clock).T, strict=True))


def _rate_of(clock: Vector) -> float:
    """Return the rate of a uniform clock [Hz]."""
    return (len(clock) - 1) / (clock[-1] - clock[0])


def _band_at(rate_hz: float) -> tuple[float, float]:
    """Return the band of frequencies at a rate of samples [Hz]; empty where samples are too slow."""
    low, high = SETTINGS.band
    return low, min(high, SETTINGS.highest * rate_hz)


def _segments_of(table: pd.DataFrame) -> list[_Segment]:
    """Return the segments that are long and fast enough and have all inertial sensors."""
    if not has_values(table, *INERTIAL):
        return []
    flights = FlightTable.of(table)
    segments = []
    for run in flights.segments:
        time = flights.time[run]
        part = table.iloc[run]
        if np.ptp(time) <= SETTINGS.shortest or not has_values(part, *INERTIAL):
            continue
        low, high = _band_at(_rate_of(uniform_grid(time)[0]))
        if low < high:
            segments.append(_Segment.of(time, part))
    return segments


Regression: TypeAlias = Callable[[_Segment, float], tuple[Matrix, Matrix]]
"""Responses (n, k) and predictors (n, p) of a segment at a lag."""


def _turning_by_surfaces(segment: _Segment, lag: float) -> tuple[Matrix, Matrix]:
    """Return the angular accelerations and their predictors, with surfaces of a lag."""
    return segment.channels(ACCELERATIONS), segment.predictors(lag)


def _most_likely_lag(segments: list[_Segment], names: Sequence[str], regression: Regression) -> Lag:
    """Return the lag that maximises the likelihood of the responses, -1/2 sum n log RSS over segments.

    RSS is the residual sum of squares of n samples over the sum of squares of the response. The
    standard deviation is the standard error of the mean lag of pieces of the segments, by Student's
    quantile at the significance, and the distance to that mean.
    """
    segments = [segment for segment in segments if segment.present(names)]
    if not segments:
        return UNKNOWN

    def profile(lag: float) -> Vector:
        return _profile(segments, regression, lag)

    steps = np.arange(-SETTINGS.largest, SETTINGS.largest + SETTINGS.coarse / 2, SETTINGS.coarse)
    profiles = np.array([profile(step) for step in steps])
    lag, *pieces = (_minimum(steps, values) for values in profiles.T)
    if abs(lag) >= SETTINGS.largest or len(pieces) < SETTINGS.least_pieces:
        return UNKNOWN
    for _ in range(2):
        around = [profile(lag + step)[0] for step in (-SETTINGS.fine, 0, SETTINGS.fine)]
        lag += _vertex(around, SETTINGS.fine)
    probability = normal.sf(SETTINGS.significance)
    quantile = student.isf(probability, len(pieces) - 1) / SETTINGS.significance
    std = np.hypot(quantile * sem(pieces), lag - np.mean(pieces))
    return Lag(float(lag), float(std))


def _lag_behind_motion(segments: list[_Segment]) -> Lag:
    """Return the lag of vanes behind the motion of the aircraft, which explains them but for gusts.

    It is that of the least sum n log RSS of alpha and beta over their motion.
    """
    pairs = [(segment, *pair) for segment in segments for pair in zip(VANES, MOTION, strict=True)]
    pairs = [pair for pair in pairs if {*pair[1:]} <= pair[0].splines.keys()]
    if not pairs:
        return UNKNOWN

    def loss(lag: float) -> float:
        total = 0.0
        for pair in pairs:
            y, fitted = _fitted_to_motion(*pair, lag)
            total += len(y) * float(np.log(np.sum((y - fitted) ** 2) / (y @ y)))
        return total

    most = SETTINGS.largest_of_vanes
    steps = np.arange(-SETTINGS.largest, most + SETTINGS.coarse / 2, SETTINGS.coarse)
    lag = float(_minimum(steps, np.array([loss(step) for step in steps])))
    if not steps[0] < lag < steps[-1]:
        return UNKNOWN
    return Lag(lag, _std_behind_motion(pairs, lag))


def _fitted_to_motion(
    segment: _Segment, vane: str, motion: str, lag: float
) -> tuple[Vector, Vector]:
    """Return a vane and its fit to the motion (n,)."""
    y = segment.channels([vane], lag)[:, 0]
    x = segment.channels([motion])[:, 0]
    return y, x * (x @ y) / (x @ x)


def _std_behind_motion(pairs: list[tuple[_Segment, str, str]], lag: float) -> float:
    """Return the standard deviation of a lag of vanes behind the motion [s].

    With residuals e and slopes g of the fitted response by time, in units of the residuals, its variance is the
    sum of (g e)^2 over that of g^2 squared, with the autocorrelation time of g e; gusts add an error in
    proportion to the part of the vanes that is not explained.
    """
    variance = 0.0
    information = 0.0
    unexplained = 0.0
    for pair in pairs:
        y, fitted = _fitted_to_motion(*pair, lag)
        time = pair[0].time
        e = y - fitted
        g = np.gradient(fitted, time[1] - time[0])
        g -= fitted * (fitted @ g) / (fitted @ fitted)
        scale = float(np.mean(e**2))
        products = g * e / scale
        variance += autocorrelation_time(products) * float(products @ products)
        information += float(g @ g) / scale
        unexplained += float(g @ g) / scale * float(e @ e) / float(y @ y)
    of_residuals = SETTINGS.lack_of_motion * np.sqrt(variance) / information
    of_gusts = SETTINGS.error_by_gusts * unexplained / information
    return float(np.hypot(of_residuals, of_gusts))


def _most_likely_servos(segments: list[_Segment], surfaces: Lag) -> tuple[Lag, Lag] | None:
    """Return the lags of servos and of their commands, the latter by a delay; None if neither is significant.

    They maximise the likelihood of the part of the responses that earlier commands explain
    (instrumental variables: Söderström & Stoica 1989, section 8.1), as noise of the rates would make
    the lag of servos smaller. Lag and delay replace each other: their errors are opposite, and the standard
    deviations of `Servos` are of the profile likelihood over the lag, whose logarithm counts a third, as residuals are
    correlated, and of ``surfaces``, the lag without servos. That one is the error of the time of the
    commands behind both, and decides whether a lag is removed. Without
    evidence of a delay the lag without one is removed: slow inputs tell it better than either.
    """
    segments = [segment for segment in segments if segment.present(ALL_SURFACES)]
    instruments = [segment.earlier_surfaces() for segment in segments]

    @lru_cache(maxsize=1)
    def behind(servo_lag: float, rate_limit: float) -> list[_Segment]:
        return [segment.behind_servos(servo_lag, rate_limit) for segment in segments]

    def loss(servo_lag: float, delay: float, rate_limit: float = np.inf) -> float:
        """Return n log RSS of the responses projected on instruments."""
        total = 0.0
        for late, Q in zip(behind(servo_lag, rate_limit), instruments, strict=True):
            response, predictors = _turning_by_surfaces(late, -delay)
            total += _log_rss(Q.T @ response, Q.T @ predictors)
        return total

    (scan, delays, losses), best = _servo_profile(loss, abs(surfaces.value))
    servo_lag, delay, least = best
    alone, loss_alone = _least(lambda lag: loss(lag, 0.0), SETTINGS.largest)
    removed, removed_delay = servo_lag, removable(Lag(delay, surfaces.std))
    if not removed_delay or loss_alone - least < SETTINGS.delay_evidence:
        removed, removed_delay = alone, 0.0
    is_significant = removable(Lag(removed, surfaces.std)) or removed_delay
    if not is_significant or removed + SETTINGS.precision >= SETTINGS.largest:
        return None
    lag_std = _std_of_profile(scan, servo_lag, losses, surfaces.std)
    delay_std = _std_of_profile(delays, delay, losses, surfaces.std)
    rate_limit = np.inf
    limited_lag, limit, least_limited = _limited_servos(segments, loss, servo_lag, delay)
    if least - least_limited >= SETTINGS.delay_evidence:
        servo_lag, rate_limit = limited_lag, limit
        removed, removed_delay = servo_lag, delay
    servos = Lag(servo_lag, lag_std, removed, rate_limit, delay_std)
    return servos, Lag(-delay, surfaces.std, -removed_delay)


def _servo_profile(
    loss: Callable[[float, float], float], early: float
) -> tuple[Matrix, tuple[float, float, float]]:
    """Return lags with their most likely delays and losses, (3, n), and the best, of surfaces ``early`` [s]."""
    latest = min(LONGEST_DELAY * early, SETTINGS.largest)

    def with_delay(servo_lag: float) -> tuple[float, float]:
        return _least(lambda delay: loss(servo_lag, delay), latest)

    # the loss has several minima: lag and delay replace each other
    scan = np.linspace(0.0, min(LONGEST_LAG * early, SETTINGS.largest), N_SERVO_LAGS)
    delays, losses = np.transpose([with_delay(servo_lag) for servo_lag in scan])
    servo_lag = float(_minimum(scan, losses))
    return np.stack([scan, delays, losses]), (servo_lag, *with_delay(servo_lag))


def _std_of_profile(values: Vector, best: float, losses: Vector, std: float) -> float:
    """Return the standard deviation of a parameter, (n,) along a profile of losses, with one [s] besides."""
    weights = np.exp(-0.5 * (losses - losses.min()) / INFLATION)
    weights /= weights.sum()
    return float(np.sqrt(weights @ (values - best) ** 2 + std**2))


def _least(loss: Callable[[float], float], largest: float) -> tuple[float, float]:
    """Return the time up to the ``largest`` [s] with the least loss, and the loss."""
    options: Any = {"xatol": SETTINGS.precision}
    found = optimize.minimize_scalar(loss, bounds=(0.0, largest), options=options)
    return float(found.x), float(found.fun)


def _limited_servos(
    segments: list[_Segment], loss: Callable[..., float], lag: float, delay: float
) -> tuple[float, float, float]:
    """Return the most likely lag and rate limit of servos by their lag and delay without a limit, and the loss.

    A servo that reaches its limit seems to lag the more the larger its steps are.
    """
    found = []
    for fraction, relative in product(SETTINGS.limited_lags, SETTINGS.limits):
        shorter = fraction * lag
        limit = relative * max(segment.largest_rate(shorter) for segment in segments)
        found.append((loss(shorter, delay, limit), shorter, limit))
    least, shorter, limit = min(found)
    return shorter, limit, least


def _profile(segments: list[_Segment], regression: Regression, lag: float) -> Vector:
    """Return n log RSS of all segments, summed, and of each piece by its own least squares, (1 + pieces,)."""
    seconds = sum(segment.seconds for segment in segments) / SETTINGS.n_pieces
    seconds = max(SETTINGS.shortest_piece, seconds)
    total = 0.0
    pieces = []
    for segment in segments:
        response, predictors = regression(segment, lag)
        total += _log_rss(response, predictors)
        count = max(1, round(segment.seconds / seconds))
        parts = np.array_split(response, count), np.array_split(predictors, count)
        for y, X in zip(*parts, strict=True):
            pieces.append(_log_rss(y, X))
    return np.array([total, *pieces])


def _log_rss(response: Matrix, predictors: Matrix) -> float:
    """Return n log RSS, summed over responses that move, of least squares; RSS is relative to their sums of squares."""
    squares = np.sum(response**2, axis=0)
    response = response[:, squares > 0]
    Q = _basis(predictors, SETTINGS.rank_tolerance)
    residuals = response - Q @ (Q.T @ response)
    rss = np.sum(residuals**2, axis=0) / squares[squares > 0]
    return len(response) * np.log(rss).sum()


def _basis(columns: Matrix, tolerance: float) -> Matrix:
    """Return an orthonormal basis (n, r) of columns (n, k), without those near a combination of others."""
    scale = np.linalg.norm(columns, axis=0)
    Q, R, _ = linalg.qr(columns / np.where(scale > 0, scale, 1.0), mode="economic", pivoting=True)
    independent = np.abs(np.diag(R)) > tolerance
    return np.asarray(Q[:, independent], dtype=float)


def _minimum(steps: Vector, values: Vector) -> float:
    """Return the place of the least of the values, by a parabola through its neighbours unless at either end."""
    place = int(np.argmin(values))
    if place in (0, len(steps) - 1):
        return steps[place]
    return steps[place] + _vertex(values[place - 1 : place + 2], steps[1] - steps[0])


def _vertex(values: Sequence[float] | Vector, step: float) -> float:
    """Return where the parabola through three values, a step apart, is smallest, relative to the middle."""
    before, centre, after = values
    curvature = before - 2 * centre + after
    if not curvature > 0:
        return 0.0
    return np.clip(step * (before - after) / (2 * curvature), -step, step)
