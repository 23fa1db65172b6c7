r"""Lags of air data, surfaces, attitude and GPS against the inertial sensors.

Attitude and GPS velocity are late by constants of the path over the ground (``_path.py``). Vanes and
surfaces are related to rates :math:`\omega` and specific force f by local linear models,

.. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
          (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

within a band of frequencies, the former with the vanes beside f where there are any. The lag maximises the
profile likelihood :math:`-\frac{1}{2} \sum n \log \mathrm{RSS}` (Jategaonkar 2006, chapter 10). Over a short
record a lag looks like a sum of rates and forces, as :math:`\dot\alpha = q + (a_z + g_z) / V`. There the vanes
are compared with the motion of the aircraft alone, the integrals of this rate and of
:math:`\dot\beta = p \sin\alpha - r \cos\alpha + (a_y + g_y) / V`; gusts are then part of the error.

Surfaces that are early are commands. Then their servos have a first-order lag T,
:math:`T \dot\delta = c - \delta`, besides a delay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy import linalg, optimize, signal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.stats import norm as normal
from scipy.stats import t as student

from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    ELEVONS,
    RATES,
    SPECIFIC_FORCE,
    SURFACES,
    VANES,
)
from skdgp._flight.clock import uniform_grid
from skdgp._flight.frames import air_velocity, flow_angle_rates
from skdgp._flight.sensor_position import at_centre_of_gravity
from skdgp._flight.smoothing import low_pass
from skdgp._flight.tables import FlightTable, has_values, interpolate_missing, numeric
from skdgp._flight.units import check_radians
from skdgp.estimation._path import ground_path
from skdgp.estimation._sensors import LAGS, flights_of, missing_channels, moving
from skdgp.estimation._servos import servo_output

ATTITUDE = ("phi", "theta")
INERTIAL = (*SPECIFIC_FORCE, *RATES)
# Factor by which correlated residuals make differences of twice the log likelihood too large: errors over their
# standard deviations were then 0.8, 0.8, 0.8 and 1.2, of a flying wing with four pairs of lag and delay
INFLATION = 3.0
# Time within which surfaces explain a response, and length of the ends of a segment that are left out [s]
MEMORY = 1.5
# Lags are removed from this many standard deviations on; convention
SIGNIFICANCE = 3.0
# Lags below this do not change a model [s]; trials
LEAST_LAG = 0.01
# Longest times by which surfaces and vanes are early, and servos late [s]
LARGEST = 0.3
# Lags of surfaces and vanes that are tried [s]; beyond the second and the last but one a lag is unknown
TRIED = np.arange(-LARGEST - 0.02, 0.63, 0.02)
# Precision of the lag of servos and their delay [s]; far below the step of a log
PRECISION = 1e-3
# Predictors nearer than this to a combination of others are left out, relative
RANK_TOLERANCE = 1e-6


class Lag(NamedTuple):
    """A lag [s], positive if late, and its standard deviation [s]; NaN if the lag is unknown."""

    value: float
    std: float
    removal: float | None = None  #: What to remove [s]; None: the lag, where it is significant
    rate_limit: float = np.inf  #: Of servos, in the unit of the surfaces per second
    delay_std: float = 0.0  #: Of the delay beside the lag of servos, or of what is left of it [s]

    def is_significant(self) -> bool:
        """Return whether the lag exceeds some standard deviations."""
        return abs(self.value) > SIGNIFICANCE * self.std


UNKNOWN = Lag(0.0, np.nan)


def removable(lag: Lag) -> float:
    """Return the lag to remove [s], zero where it is not significant or too small to change a model."""
    if lag.removal is not None:
        return lag.removal
    is_large = abs(lag.value) >= LEAST_LAG
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
    surfaces = _most_likely_lag(
        segments, "surfaces", lambda part: _loss_of_surfaces(part, part.earlier_surfaces())
    )
    servos = UNKNOWN
    servos_and_delay = None
    if removable(surfaces) < 0:
        servos_and_delay = _most_likely_servos(segments, surfaces)
    if servos_and_delay is not None:
        servos, surfaces = servos_and_delay
        segments = [segment.behind_servos(removable(servos)) for segment in segments]
    surface_lag = removable(surfaces)

    def loss_of_vanes(segment: _Segment) -> Loss:
        predictors = segment.predictors(surface_lag)
        return lambda lag: _log_rss(segment.at("vanes", lag), predictors)

    vanes = _most_likely_lag(segments, "vanes", loss_of_vanes)
    by_motion = _lag_behind_motion(segments)
    if np.isnan(vanes.std) or by_motion.std < vanes.std:
        vanes = by_motion
    attitude, gps = UNKNOWN, UNKNOWN
    if segments and not missing_channels(table):
        attitude, gps = _lags_of_path(table)
        if not has_values(table, *VANES):
            log_step = max(segment.log_step for segment in segments)
            servos, surfaces = _left_to_filter(servos_and_delay, log_step)
    return {
        "air": vanes,
        "surfaces": surfaces,
        "servos": servos,
        "attitude": attitude,
        "gps": gps,
    }


def _left_to_filter(servos_and_delay: tuple[Lag, Lag] | None, log_step: float) -> tuple[Lag, Lag]:
    """Return the lags of servos and of their commands, with what is removed before `estimate_air_motion`.

    Its lag of servos takes in the half step by which commands are late that hold between samples, and
    what is left of the delay. Two standard deviations less than the delay are removed, but at most 10 ms
    less: surfaces that are too late follow the motion that an autopilot answers, and slopes are too small.
    What is left beyond that is an error of the commands' delay.
    """
    if servos_and_delay is None:
        return UNKNOWN, UNKNOWN
    servos, commands = servos_and_delay
    delay = commands.removal or 0.0
    margin = min(2.0 * servos.delay_std, LEAST_LAG)
    removed = delay + margin if abs(delay) >= log_step else 0.0
    left = max(0.0, removed - commands.value - margin)
    error = float(np.hypot(left, servos.delay_std))
    return servos._replace(removal=0.0), commands._replace(removal=removed, delay_std=error)


def _lags_of_path(table: pd.DataFrame) -> list[Lag]:
    """Return the lags of attitude and GPS velocity against gyros and accelerometers, over all flights.

    Of the first minutes of each flight, weighted by their precision.
    """
    check_radians(table, ("theta", *RATES))
    n_lags = len(LAGS)
    precision = np.zeros(n_lags)
    weighted = np.zeros(n_lags)
    for flight in flights_of(table):
        time = flight.sensors.time
        # first seconds of each flight that show lags of attitude and GPS to the millisecond [s]; trials
        end = np.searchsorted(time, time[0] + 120.0)
        # first rows of each flight, of 20 kB each, for these lags
        first = flight.sensors.part(0, min(int(end), 32768))
        solved = ground_path(first)
        of_flight = 1 / np.diag(solved.covariance)[-n_lags:]
        precision += of_flight
        weighted += of_flight * solved.path.constant(*LAGS)
    gps, attitude = map(Lag, weighted / precision, precision**-0.5)
    return [attitude, gps]


@dataclass(frozen=True)
class _Segment:
    """A gap-free segment: groups of channels within the band, rates over V, accelerations over V^2."""

    splines: dict[str, CubicSpline]  # of each group
    time: Vector  # (n,) at which groups are compared, without the ends of the segment [s]
    log_step: float  # step of the log [s]
    commands: Matrix  # (n', k) of the surfaces on the clock of the splines, with all frequencies
    band: Matrix  # second-order sections of the filter of the band

    @classmethod
    def of(cls, time: Vector, table: pd.DataFrame) -> _Segment | None:
        """Return the segment of a table at increasing times, None if its samples are too slow for the band."""
        clock, _ = uniform_grid(time)
        rate_hz = (len(clock) - 1) / np.ptp(clock)
        # frequencies of the response to surfaces and gusts, between trim and noise [Hz]; trials
        low, high = 0.3, 4.0
        # upper end of the band at most, over the rate of the samples
        high = min(high, 0.2 * rate_hz)
        if high <= low:
            return None
        band = signal.butter(2, (low, high), "bandpass", fs=rate_hz, output="sos")

        def on_clock(names: Sequence[str]) -> Matrix:
            """Return channels (n', k), zero where there is none."""
            values = interpolate_missing(time, numeric(table.reindex(columns=list(names)), names))
            return CubicSpline(time, np.nan_to_num(values))(clock)

        force = on_clock(SPECIFIC_FORCE)
        rates = on_clock(RATES)
        commands = on_clock(_moving_surfaces(table))
        vanes = moving(table, VANES)
        speed = np.ones((len(clock), 1))
        groups = {"surfaces": commands, "vanes": on_clock(vanes)}
        if has_values(table, "airspeed"):
            # airspeed below this frequency scales accelerations to coefficients [Hz]; below the band
            steady = low_pass(on_clock(["airspeed"]), rate_hz, 0.2)
            # airspeed at least, over its median: none in which rates over V diverge
            speed = np.maximum(steady, 0.1 * np.median(steady))
            velocity = air_velocity(speed[:, 0], np.mean(on_clock(["alpha"])), 0.0)
            angle_rates = flow_angle_rates(velocity, force, rates, on_clock(ATTITUDE))
            motion = cumulative_trapezoid(angle_rates, clock, axis=0, initial=0)
            groups["motion"] = motion[:, np.isin(VANES, vanes)]
        smooth_rates = low_pass(rates, rate_hz, 2 * high)
        groups["accelerations"] = CubicSpline(clock, smooth_rates)(clock, 1) / speed**2
        groups["inertial"] = np.hstack([force / speed**2, rates / speed])
        splines = {}
        for name, values in groups.items():
            if values.shape[1]:
                splines[name] = CubicSpline(clock, signal.sosfiltfilt(band, values, axis=0))
        # samples in a period of the upper end of the band
        step = 1 / min(rate_hz, 6.0 * high)
        # either end of a segment may be distorted by the filter or a lag [s]
        inner = np.arange(clock[0] + MEMORY, clock[-1] - MEMORY, step)
        return cls(splines, inner, 1 / rate_hz, commands, band)

    def deflections(self, lag: float, rate_limit: float = np.inf) -> Matrix:
        """Return the deflections (n', k) of servos of a first-order lag [s], with all their frequencies."""
        return servo_output(self.commands, lag, self.log_step, rate_limit)

    def behind_servos(self, lag: float, rate_limit: float = np.inf) -> _Segment:
        """Return the segment with the deflections of servos of a first-order lag [s], in place of their commands."""
        if "surfaces" not in self.splines:
            return self
        within_band = signal.sosfiltfilt(self.band, self.deflections(lag, rate_limit), axis=0)
        surfaces = CubicSpline(self.splines["surfaces"].x, within_band)
        return replace(self, splines=self.splines | {"surfaces": surfaces})

    def largest_rate(self, lag: float) -> float:
        """Return the largest rate of the surfaces behind servos of a first-order lag [s]."""
        return float(np.abs(np.diff(self.deflections(lag), axis=0)).max() / self.log_step)

    def earlier_surfaces(self) -> Matrix:
        """Return an orthonormal basis (n, k) of the surfaces of the last seconds."""
        # by half a period of the upper end of the band [s]
        delays = np.arange(0.0, MEMORY + 0.0625, 0.125)
        columns = [self.at("surfaces", -delay) for delay in delays]
        return linalg.orth(np.hstack(columns), RANK_TOLERANCE)

    @property
    def seconds(self) -> float:
        """Length of the segment without its ends [s]."""
        return np.ptp(self.time)

    def at(self, group: str, lag: float = 0.0) -> Matrix:
        """Return a group of channels (n, k) within the band, corrected for a lag."""
        return self.splines[group](self.time + lag)

    def predictors(self, surface_lag: float) -> Matrix:
        """Return specific force, rates and surfaces (n, p), surfaces corrected for a lag."""
        inertial = self.at("inertial")
        if "surfaces" not in self.splines:
            return inertial
        return np.hstack([inertial, self.at("surfaces", surface_lag)])


def _moving_surfaces(table: pd.DataFrame) -> list[str]:
    """Return the names of surfaces that move, elevons in place of elevator and aileron."""
    elevons = moving(table, ELEVONS)
    return elevons + moving(table, SURFACES if len(elevons) < len(ELEVONS) else ["rudder"])


def _segments_of(table: pd.DataFrame) -> list[_Segment]:
    """Return the segments that are long and fast enough and have all inertial sensors."""
    if not has_values(table, *INERTIAL):
        return []
    flights = FlightTable.of(table)
    segments = []
    for run in flights.segments:
        time = flights.time[run]
        part = table.iloc[run]
        if np.ptp(time) > 6.0 and has_values(part, *INERTIAL):
            segments.append(_Segment.of(time, part))
    return [segment for segment in segments if segment is not None]


Loss: TypeAlias = Callable[[float], float]
"""n log RSS of a segment at a lag [s]."""


def _loss_of_surfaces(segment: _Segment, instruments: Matrix) -> Loss:
    """Return n log RSS of the angular accelerations by a lag of surfaces, projected on instruments (n, k).

    Instruments are earlier deflections (Söderström & Stoica 1989, section 8.1), as noise of rates and forces
    makes surfaces seem later: by 10 ms for small aircraft in calm air.
    """
    response = instruments.T @ segment.at("accelerations")
    others = [segment.at(group) for group in ("inertial", "vanes") if group in segment.splines]
    predictors = instruments.T @ np.hstack(others)

    def loss(lag: float) -> float:
        surfaces = instruments.T @ segment.at("surfaces", lag)
        return _log_rss(response, np.hstack([predictors, surfaces]))

    return loss


def _sum_of(losses: Iterable[Loss]) -> Loss:
    """Return the sum of losses by lag."""
    kept = list(losses)
    return lambda lag: sum(loss(lag) for loss in kept)


def _most_likely_lag(
    segments: list[_Segment], group: str, loss_of: Callable[[_Segment], Loss]
) -> Lag:
    """Return the lag of a group that maximises the likelihood of the responses, -1/2 sum n log RSS.

    RSS is the residual sum of squares of n samples over the sum of squares of the response, by least squares
    in each segment. The standard deviation is the distance to the lag of pieces of the segments, each with a
    least squares of its own, and the error of that lag by the jackknife over the pieces (Efron 1982), by
    Student's quantile at the significance.
    """
    segments = [segment for segment in segments if group in segment.splines]
    pieces = _pieces(segments)
    # least number of pieces that show a standard error
    if len(pieces) < 3:
        return UNKNOWN
    lag, _ = _least(_sum_of(map(loss_of, segments)), TRIED)
    if not TRIED[1] < lag < TRIED[-2]:
        return UNKNOWN
    of_pieces = [loss_of(piece) for piece in pieces]
    tried = np.array([[loss(lag) for lag in TRIED] for loss in of_pieces])
    # without one of the pieces
    lags = [_minimum(TRIED, losses) for losses in tried.sum(axis=0) - tried]
    jackknife = np.sqrt(len(pieces) - 1) * np.std(lags)
    quantile = student.isf(normal.sf(SIGNIFICANCE), len(pieces) - 1) / SIGNIFICANCE
    return Lag(
        lag, float(np.hypot(quantile * jackknife, lag - _least(_sum_of(of_pieces), TRIED)[0]))
    )


def _pieces(segments: list[_Segment]) -> list[_Segment]:
    """Return pieces of segments that are long enough for linear models of their own."""
    long = [segment for segment in segments if segment.seconds > 17.0]
    # pieces of all flights, each with a lag of its own
    seconds = sum(segment.seconds for segment in long) / 8
    # least length of a piece [s]
    seconds = max(10.0, seconds)
    pieces = []
    for segment in long:
        count = max(1, round(segment.seconds / seconds))
        pieces += [replace(segment, time=time) for time in np.array_split(segment.time, count)]
    return pieces


def _lag_behind_motion(segments: list[_Segment]) -> Lag:
    r"""Return the lag of vanes behind the motion of the aircraft, with the least sum n log RSS.

    With residuals e and slopes g of the fitted response by time, in units of the residuals, its variance is the
    sum of (g e)^2 over that of g^2 squared, with the autocorrelation time of g e; gusts add an error in
    proportion to the part of the vanes that is not explained.
    """
    segments = [segment for segment in segments if {"vanes", "motion"} <= segment.splines.keys()]
    if not segments:
        return UNKNOWN

    def loss(lag: float) -> float:
        pairs = _vanes_and_motion(segments, lag)
        return sum(len(y) * float(np.log1p(-((x @ y) ** 2) / (y @ y))) for y, x, _ in pairs)

    lag, _ = _least(loss, TRIED)
    if not TRIED[1] < lag < TRIED[-2]:
        return UNKNOWN
    variance: Any = 0.0
    information: Any = 0.0
    unexplained: Any = 0.0
    for y, x, time in _vanes_and_motion(segments, lag):
        fitted = x * (x @ y)
        e = y - fitted
        slope = np.gradient(fitted, time)
        g = slope - x * (x @ slope)
        scale = np.mean(e**2)
        score = g * e / scale
        variance += autocorrelation_time(score) * (score @ score)
        information += (g @ g) / scale
        unexplained += (g @ g) / scale * (e @ e) / (y @ y)
    # of vanes behind the motion: factor of the standard deviation by the residuals, and error [s] for vanes that
    # motion does not explain; trials on 54 flights of small aircraft in gusts
    of_residuals = 3.0 * np.sqrt(variance) / information
    of_gusts = 0.1 * unexplained / information
    return Lag(lag, float(np.hypot(of_residuals, of_gusts)))


def _vanes_and_motion(segments: list[_Segment], lag: float) -> list[tuple[Vector, Vector, Vector]]:
    """Return each vane of a lag (n,), its angle by the motion of the aircraft, of length one, and the times."""
    pairs = []
    for segment in segments:
        motion = segment.at("motion")
        motion /= np.linalg.norm(motion, axis=0)
        columns = zip(segment.at("vanes", lag).T, motion.T, strict=True)
        pairs += [(y, x, segment.time) for y, x in columns]
    return pairs


def _most_likely_servos(segments: list[_Segment], surfaces: Lag) -> tuple[Lag, Lag] | None:
    """Return the lags of servos and of their commands, the latter by a delay; None if neither is significant.

    They maximise the likelihood of the part of the responses that earlier commands explain. Lag and delay
    replace each other: their errors are opposite, and their standard deviations are of the profile likelihood
    over the lag, whose logarithm counts a third, as residuals are correlated, and of ``surfaces``, the lag
    without servos. That one is the error of the time of the commands behind both, and decides whether a lag
    is removed. Without evidence of a delay the lag without one is removed: slow inputs tell it better than
    either.
    A servo that reaches a limit of its rate seems to lag the more the larger its steps are.
    """
    segments = [segment for segment in segments if "surfaces" in segment.splines]
    loss_of = partial(_loss_by_delay, segments, [part.earlier_surfaces() for part in segments])
    # least gain in twice the log likelihood by a delay of servos that is removed, or a limit of their rate:
    # delays of 30 to 60 ms gain 260 to 440, limits that are reached 60 to 196, others 3, vibration 18 at most;
    # trials on four aircraft
    least_gain = 40.0
    early = abs(surfaces.value)
    lags = np.linspace(0.0, min(3.5 * early, LARGEST), 29)
    delays = np.linspace(0.0, min(1.5 * early, LARGEST), 4)

    @cache
    def best_delay(lag: float) -> tuple[float, float]:
        return _least(loss_of(lag), delays)

    lag, least = _least(lambda lag: best_delay(lag)[1], lags)
    delay, _ = best_delay(lag)
    of_lags, losses = np.transpose([best_delay(lag) for lag in lags])
    lag_std = _std_of_profile(lags - lag, losses, surfaces.std)
    delay_std = _std_of_profile(of_lags - delay, losses, surfaces.std)
    sum_std = _std_of_profile(lags + of_lags - lag - delay, losses, surfaces.std)

    alone, loss_alone = _least(lambda lag: loss_of(lag)(0.0), lags)
    removed, removed_delay = lag, removable(Lag(delay, surfaces.std))
    if not removed_delay or loss_alone - least < least_gain:
        removed, removed_delay = alone, 0.0
    is_significant = removable(Lag(removed, surfaces.std)) or removed_delay
    if not is_significant or removed + PRECISION >= LARGEST:
        return None
    rate_limit = np.inf
    limited = []
    # fractions of the lag and of the largest rate without a limit that are scanned
    for fraction in (1.0, 0.75, 0.5):
        shorter = fraction * lag
        fastest = max(segment.largest_rate(shorter) for segment in segments)
        for limit in fastest * np.array([0.8, 0.62, 0.47, 0.37, 0.28, 0.22, 0.17, 0.13, 0.1]):
            limited.append((loss_of(shorter, limit)(delay), shorter, limit))
    least_limited, shorter, limit = min(limited)
    if least - least_limited >= least_gain:
        removed, removed_delay = shorter, delay
        lag, rate_limit = shorter, float(limit)
    servos = Lag(lag, lag_std, removed, rate_limit, delay_std)
    return servos, Lag(-delay, sum_std, -removed_delay)


def _loss_by_delay(
    segments: list[_Segment], instruments: list[Matrix], lag: float, rate_limit: float = np.inf
) -> Callable[[float], float]:
    """Return n log RSS of the responses behind servos, projected on instruments, as a function of the delay."""
    losses = [
        _loss_of_surfaces(segment.behind_servos(lag, rate_limit), Q)
        for segment, Q in zip(segments, instruments, strict=True)
    ]
    of_lag = _sum_of(losses)
    return lambda delay: of_lag(-delay)


def _std_of_profile(errors: Vector, losses: Vector, std: float) -> float:
    """Return the standard deviation of a parameter by its errors (n,) along a profile, with one [s] besides."""
    weights = np.exp(-0.5 * (losses - losses.min()) / INFLATION)
    return float(np.sqrt(np.average(errors**2, weights=weights) + std**2))


def _least(loss: Callable[[float], float], tried: Vector) -> tuple[float, float]:
    """Return the time [s] with the least loss, between the neighbours of the best that is tried, and the loss."""
    best = int(np.argmin([loss(time) for time in tried]))
    bounds = (tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)])
    options: Any = {"xatol": PRECISION}
    found = optimize.minimize_scalar(loss, bounds=bounds, options=options)
    return float(found.x), float(found.fun)


def _log_rss(response: Matrix, predictors: Matrix) -> float:
    """Return n log RSS, summed over responses that move, of least squares; RSS is relative to their sums of squares."""
    squares = np.sum(response**2, axis=0)
    response = response[:, squares > 0]
    weights = np.linalg.lstsq(predictors, response, rcond=RANK_TOLERANCE)[0]
    rss = np.sum((response - predictors @ weights) ** 2, axis=0) / squares[squares > 0]
    return float(len(response) * np.log(rss).sum())


def _minimum(steps: Vector, values: Vector) -> float:
    """Return the place of the least of the values, by a parabola through its neighbours unless at either end."""
    place = int(np.argmin(values))
    if place in (0, len(steps) - 1):
        return float(steps[place])
    before, least, after = values[place - 1 : place + 2]
    curvature = before - 2 * least + after
    if not curvature > 0:
        return float(steps[place])
    return float(steps[place] + (steps[1] - steps[0]) * (before - after) / (2 * curvature))
