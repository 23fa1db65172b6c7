"""LagCorrector: estimates and removes lags of air data, surfaces, attitude and GPS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import linalg, signal
from scipy.interpolate import CubicSpline
from scipy.stats import norm as normal
from scipy.stats import t as student

from skdgp._compute.sklearn_compat import StrOptions
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    MIXED,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    VANES,
)
from skdgp._flight.checks import WRAPPED, check_columns, check_radians, numeric, unwrapped
from skdgp._flight.clock import (
    check_clock,
    flight_codes,
    flight_segments,
    runs_by_flight,
    uniform_grid,
)
from skdgp.preprocessing._path import (
    CONSTANTS,
    GUSTS,
    MEAN_WIND,
    NOISE,
    estimate,
    flight_logs,
    missing_channels,
)
from skdgp.preprocessing._table import (
    TableTransformer,
    has_values,
    interpolate_missing,
    with_columns,
    wrapped_near,
)

GROUPS = {
    "air": AIR_DATA,
    "surfaces": ALL_SURFACES,
    "attitude": EULER,
    "gps": (*EARTH_VELOCITY, *POSITION),
}
INERTIAL = (*SPECIFIC_FORCE, *RATES)
CONTROLS = (
    *ALL_SURFACES,
    "throttle",
    "propeller_speed",
)  # channels without noise, in which steps are common
PADDING = 64
MIN_SIGNIFICANCE = 3.0  # standard deviations
MIN_LAG = 0.01  # lags below this [s] do not change a model
KINEMATIC = {"attitude": "attitude_lag", "gps": "velocity_lag"}
KINEMATIC_SECONDS = 120.0  # of each flight, which show these lags to the millisecond
KINEMATIC_ROWS = 32768  # at most of them, of 20 kB each
BAND = (0.3, 4.0)  # frequencies [Hz] of the response to surfaces and gusts, between trim and noise
# airspeed below this frequency [Hz] scales accelerations to coefficients, independent of its lag
STEADY = 0.2
EDGE = 1.5  # seconds at either end of a segment that the filter or a lag may distort
SHORTEST = 20.0  # least length of a segment [s]
RANGE, COARSE, FINE = 0.3, 0.02, 0.01  # largest lag, steps of the scan and of the parabolas [s]
RANK_TOLERANCE = 1e-6  # predictors nearer than this to a combination of others are left out
OVERSAMPLING = 6.0  # samples of a period of the upper end of the band
PIECES, LEAST_PIECES = 8, 3  # number of pieces of all flights, each with a lag of its own
SHORTEST_PIECE = 10.0  # [s]
ACCELERATIONS = tuple(f"{name}_dot" for name in RATES)


class Lag(NamedTuple):
    """A lag [s], positive if late, and its standard deviation."""

    lag: float
    std: float


UNKNOWN = Lag(0.0, np.nan)


class LagCorrector(TableTransformer):
    r"""Estimate the lags of air data, surfaces, attitude and GPS against the inertial unit, and remove them.

    A channel with lag tau shows at t its value at t - tau, so it is replaced by its value at t +
    tau, segment by segment. Beyond the end of a segment attitude and GPS are NaN, and the last value
    of others is repeated. Sensors are shifted in the frequency domain, which keeps white noise white
    for :class:`FlightSmoother`; controls, and channels of a jittered clock, by cubic splines. Use
    full-rate flights, before smoothing.

    Attitude and GPS follow from gyros and accelerometers by kinematics, as in
    :class:`FlightPathReconstruction`. Surfaces and vanes are related to them by a local linear
    model, without assumed derivatives: at the same time

    .. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
              (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

    all within the band from 0.3 to 4 Hz. The lag maximises the profile likelihood of the residuals
    (Jategaonkar 2006, chapter 10). About eight pieces of the flights, each with its own B, C and
    lag, give its standard error: an error of the linear model moves their lags apart. Lags of
    throttle and propeller speed can be given, not estimated: engines respond slowly. Raises
    ValueError if ``time`` is missing; if the table has no column of the groups; if ``lags`` names
    neither a group nor a column, or is not finite.

    Parameters
    ----------
    lags : {"auto"}, dict or None, default="auto"
        Estimated in ``fit``; or given [s], positive where late, by group (air: airspeed, alpha,
        beta; surfaces; attitude; gps) or column; or None for no change.

    Attributes
    ----------
    lags_ : DataFrame
        By group or column: ``lag`` and ``std`` [s], ``applied`` (the removed lag [s]) and
        ``remark``. A lag below 3 standard deviations (a third of Student's quantile of equal
        probability for few pieces) or below 10 ms is not removed.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(0, 4, 0.02)
    >>> flight = pd.DataFrame({"time": t, "alpha": np.sin(t - 0.08), "q": np.cos(t)})
    >>> on_time = LagCorrector(lags={"air": 0.08}).fit_transform(flight)
    >>> bool(np.allclose(on_time.alpha[:-4], np.sin(t)[:-4], atol=1e-4))
    True
    """

    _parameter_constraints: dict = {"lags": [StrOptions({"auto"}), dict, None]}

    def __init__(self, lags: Any = "auto") -> None:
        self.lags = lags

    @property
    def servo_lag_(self) -> float:
        """How late the surfaces follow their logged commands [s], zero where they do not."""
        return max(0.0, -float(self.lags_["applied"].get("surfaces", 0.0)))

    def _fit_table(self, table):
        check_columns(table, ["time"])
        if isinstance(self.lags, str):
            self._check_any(table, _columns_of(GROUPS))
            segments = segments_of(table)
            found = _lags_of_motion(segments) | dict.fromkeys(KINEMATIC, UNKNOWN)
            complete = bool(segments) and not missing_channels(table)
            if complete and not has_values(table, *VANES):
                found["surfaces"] = UNKNOWN  # a parameter of the motion of the air
            if complete:
                found |= _lags_of_path(table)
            rows = {group: (*lag, *_applied(lag)) for group, lag in found.items()}
        else:
            lags = self.lags or {}
            unknown = [name for name in lags if name not in GROUPS and name not in table]
            if unknown:
                raise ValueError(
                    f"Got lags of {unknown}, but expected groups {list(GROUPS)} or columns of the "
                    f"table."
                )
            wrong = {
                name: each
                for name, each in lags.items()
                if not (isinstance(each, Real) and np.isfinite(float(each)))
            }
            if wrong:
                raise ValueError(f"Got lags {wrong}, but expected finite numbers of seconds.")
            if lags:
                self._check_any(table, _columns_of(lags))
            rows = {
                name: (float(each), np.nan, float(each), "given") for name, each in lags.items()
            }
        columns = [*Lag._fields, "applied", "remark"]
        self.lags_ = pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis(
            "group"
        )

    def _transform_table(self, table):
        check_columns(table, ["time"])
        time, new = numeric(table, ["time"])[:, 0], {}
        lags: dict[Any, float] = self.lags_["applied"].to_dict()
        for group, lag in lags.items():
            for name in GROUPS.get(group, (group,)):
                if lag and name in table:
                    values, noisy = unwrapped(table, [name])[:, 0], name not in CONTROLS
                    repeats = not any(name in GROUPS[each] for each in KINEMATIC)
                    new[name] = _shifted(
                        time, values, lag, table.get("flight"), noisy=noisy, repeats=repeats
                    )
                    if name in WRAPPED:
                        new[name] = wrapped_near(new[name], table[name])
        return with_columns(table, new)


def _columns_of(names: Iterable[str]) -> list[str]:
    """Return the columns of groups and of single columns."""
    return [column for name in names for column in GROUPS.get(name, (name,))]


def _shifted(
    time: Vector, values: Vector, lag: float, flight: Any, *, noisy: bool, repeats: bool
) -> Vector:
    """Return a channel without its lag, on the rows where it was sampled; beyond its end the last value, or NaN."""
    out, rows = values.copy(), np.flatnonzero(np.isfinite(values))
    for run in flight_segments(time[rows], None if flight is None else np.asarray(flight)[rows]):
        here = rows[run]
        if len(here) < 2:
            continue
        grid, jittered = uniform_grid(time[here])
        clock = time[here] if jittered else grid
        later = clock + lag
        if noisy and not jittered:
            shifted = _advanced(values[here], lag * (len(grid) - 1) / (grid[-1] - grid[0]))
        else:
            shifted = CubicSpline(clock, values[here])(np.clip(later, clock[0], clock[-1]))
        shifted[later > clock[-1]] = values[here[-1]] if repeats else np.nan
        shifted[later < clock[0]] = values[here[0]] if repeats else np.nan
        out[here] = shifted
    return out


def _advanced(values: Vector, steps: float) -> Vector:
    """Return equidistant values a fraction of steps later: every frequency's phase is shifted, white noise stays white.

    They are continued oddly beyond both ends, and the line between these is shifted by itself, so
    that the periodic signal is continuous (Oppenheim & Schafer 2010, section 4.5).
    """
    margin = min(len(values) - 1, PADDING + int(np.ceil(abs(steps))))
    padded = np.pad(values, margin, mode="reflect", reflect_type="odd")
    n = len(padded)
    slope = (padded[-1] - padded[0]) / (n - 1)
    line = padded[0] + slope * np.arange(n)
    spectrum = np.fft.rfft(padded - line) * np.exp(2j * np.pi * np.fft.rfftfreq(n) * steps)
    return (np.fft.irfft(spectrum, n) + line + slope * steps)[margin : n - margin]


def _applied(estimate: Lag) -> tuple[float, str]:
    """Return the lag to remove, and a remark."""
    if not abs(estimate.lag) > MIN_SIGNIFICANCE * estimate.std:
        return 0.0, "not shown by these flights"
    return (0.0, "negligible") if abs(estimate.lag) < MIN_LAG else (estimate.lag, "removed")


class Segment:
    """A gap-free segment: splines of its channels within the band, rates over V, accelerations over V^2."""

    def __init__(self, time: Vector, table: pd.DataFrame) -> None:
        clock = uniform_grid(time)[0]
        rate_hz = (len(time) - 1) / (time[-1] - time[0])
        band = BAND[0], min(BAND[1], 0.2 * rate_hz)
        names = [
            name
            for name in (*INERTIAL, *VANES, *ALL_SURFACES, "airspeed")
            if has_values(table, name)
        ]
        values = interpolate_missing(time, numeric(table, names))
        channels = {
            name: CubicSpline(time, column)(clock)
            for name, column in zip(names, values.T, strict=True)
        }
        speed = np.ones(len(clock))
        if "airspeed" in names:
            speed = _low_pass(channels["airspeed"], STEADY, rate_hz)
            speed = np.maximum(speed, 0.1 * np.median(speed))
        for name in RATES:
            rate = CubicSpline(clock, _low_pass(channels[name], 2 * band[1], rate_hz))
            channels[f"{name}_dot"] = rate(clock, 1) / speed**2
            channels[name] = channels[name] / speed
        for name in SPECIFIC_FORCE:
            channels[name] = channels[name] / speed**2
        sections = signal.butter(2, band, "bandpass", fs=rate_hz, output="sos")
        self.splines = {
            name: CubicSpline(clock, signal.sosfiltfilt(sections, values))
            for name, values in channels.items()
        }
        step = 1 / min(rate_hz, OVERSAMPLING * band[1])
        self.time = np.arange(clock[0] + EDGE, clock[-1] - EDGE, step)

    def present(self, names: Sequence[str]) -> list[str]:
        """Return the names that this segment has; elevons in place of elevator and aileron."""
        here = [name for name in names if name in self.splines]
        return [name for name in here if name not in MIXED] if {*ELEVONS} <= {*here} else here

    def channels(self, names: Sequence[str], lag: float = 0.0) -> Matrix:
        """Return channels (n, k) within the band, corrected for a lag."""
        present = self.present(names)
        return (
            np.column_stack([self.splines[name](self.time + lag) for name in present])
            if present
            else np.empty((len(self.time), 0))
        )


def _low_pass(values: Vector, frequency: float, rate_hz: float) -> Vector:
    sections = signal.butter(2, frequency, fs=rate_hz, output="sos")
    padding = min(len(values) - 1, round(2 * rate_hz / frequency))
    return signal.sosfiltfilt(sections, values, padlen=padding)


def segments_of(table: pd.DataFrame) -> list[Segment]:
    """Return the segments that are long enough and have all inertial sensors."""
    if not has_values(table, *INERTIAL):
        return []
    time, codes = check_clock(numeric(table, ["time"])[:, 0], table.get("flight"))
    runs = [run for runs in runs_by_flight(time, codes) for run in runs]
    return [
        Segment(time[run], table.iloc[run])
        for run in runs
        if np.ptp(time[run]) > SHORTEST and has_values(table.iloc[run], *INERTIAL)
    ]


def _lags_of_path(table: pd.DataFrame) -> dict[str, Lag]:
    """Return the lags of attitude and GPS velocity against gyros and accelerometers, over all flights.

    Vanes are left out, as gusts would resemble a lag. Flights are weighted by their precision, with
    the prior counted once.
    """
    check_radians(table, ("theta", *RATES))
    codes = flight_codes(table["flight"])[0] if "flight" in table else np.zeros(len(table))
    flights = table.groupby(codes)
    since = table["time"] - flights["time"].transform("min")
    first = (since < KINEMATIC_SECONDS) & (flights.cumcount() < KINEMATIC_ROWS)
    inertial = table[first].drop(columns=[*VANES], errors="ignore")
    lags, biases = list(KINEMATIC.values()), ("p_bias", "q_bias", "r_bias")
    free = [*biases, *lags, *MEAN_WIND]
    at = slice(len(biases), len(biases) + len(lags))
    prior = np.diag([CONSTANTS[name] ** -2 for name in lags])
    precision, weighted = prior.copy(), np.zeros(len(lags))
    for _, _, log in flight_logs(inertial):
        solved = estimate(log, NOISE | GUSTS, learn=NOISE | GUSTS, free=free)
        of_flight = np.linalg.inv(solved.covariance[at, at])
        weighted += of_flight @ solved.path.constant(*lags)
        precision += of_flight - prior
    values, stds = np.linalg.solve(precision, weighted), np.diag(np.linalg.inv(precision)) ** 0.5
    rows = zip(KINEMATIC, values.tolist(), stds.tolist(), strict=True)
    return {group: Lag(value, std) for group, value, std in rows}


def _lags_of_motion(segments: list[Segment]) -> dict[str, Lag]:
    """Return the lags of vanes and surfaces by their groups, by the two local linear models of `LagCorrector`."""

    def moments(segment: Segment, lag: float) -> tuple[Matrix, Matrix]:
        surfaces = segment.channels(ALL_SURFACES, lag)
        return segment.channels(ACCELERATIONS), np.hstack([surfaces, segment.channels(INERTIAL)])

    def angles(segment: Segment, lag: float) -> tuple[Matrix, Matrix]:
        moved = segment.channels(ALL_SURFACES, _applied(surfaces)[0])
        return segment.channels(VANES, lag), np.hstack([segment.channels(INERTIAL), moved])

    surfaces = _profile_estimate(segments, ALL_SURFACES, moments)
    return {"air": _profile_estimate(segments, VANES, angles), "surfaces": surfaces}


def _profile_estimate(
    segments: list[Segment],
    names: Sequence[str],
    equation: Callable[[Segment, float], tuple[Matrix, Matrix]],
) -> Lag:
    """Return the lag that maximises the likelihood of the responses, -1/2 sum n log RSS over segments.

    RSS is the residual sum of squares of n samples over that of the response. Each piece of a
    segment has its own least squares and lag. The standard deviation is the standard error of the
    mean of their lags, by Student's quantile at `MIN_SIGNIFICANCE`, and the distance to that mean.
    """
    segments = [segment for segment in segments if segment.present(names)]
    if not segments:
        return UNKNOWN
    seconds = max(SHORTEST_PIECE, sum(np.ptp(each.time) for each in segments) / PIECES)

    def profile(lag: float) -> Vector:
        """Return n log RSS of each segment, summed, and of each piece, (1 + pieces,)."""
        rows = [_profile(*equation(segment, lag), segment, seconds) for segment in segments]
        return np.concatenate([[sum(row[0] for row in rows)], *(row[1:] for row in rows)])

    steps = np.arange(-RANGE, RANGE + COARSE / 2, COARSE)
    lag, *pieces = (_minimum(steps, values) for values in np.transpose([*map(profile, steps)]))
    if abs(lag) >= RANGE or len(pieces) < LEAST_PIECES:
        return UNKNOWN
    for _ in range(2):
        lag += _vertex([profile(lag + step)[0] for step in (-FINE, 0, FINE)], FINE)
    quantile = student.isf(normal.sf(MIN_SIGNIFICANCE), len(pieces) - 1) / MIN_SIGNIFICANCE
    error = np.std(pieces, ddof=1) / np.sqrt(len(pieces))
    std = np.hypot(quantile * error, lag - np.mean(pieces))
    return Lag(lag, float(std))


def _profile(response: Matrix, predictors: Matrix, segment: Segment, seconds: float) -> list[float]:
    """Return n log RSS of a segment, and of each of its pieces."""
    count = max(1, round(np.ptp(segment.time) / seconds))
    pieces = zip(np.array_split(response, count), np.array_split(predictors, count), strict=True)
    return [
        len(y) * float(np.log(_unexplained(y, X)).sum())
        for y, X in [(response, predictors), *pieces]
    ]


def _unexplained(response: Matrix, predictors: Matrix) -> Vector:
    """Return the residual sum of squares of each response by least squares, over its sum of squares."""
    scale = np.linalg.norm(predictors, axis=0)
    Q, R, _ = linalg.qr(
        predictors / np.where(scale > 0, scale, 1.0), mode="economic", pivoting=True
    )
    Q = Q[:, np.abs(np.diag(R)) > RANK_TOLERANCE]
    residuals = response - Q @ (Q.T @ response)
    return np.sum(residuals**2, axis=0) / np.sum(response**2, axis=0)


def _minimum(steps: Vector, values: Vector) -> float:
    """Return the place of the least of the values, by a parabola through its neighbours unless at either end."""
    place = int(np.argmin(values))
    if place in (0, len(steps) - 1):
        return float(steps[place])
    return float(steps[place] + _vertex(values[place - 1 : place + 2], COARSE))


def _vertex(values: Any, step: float) -> float:
    """Return where the parabola through three values, a step apart, is smallest."""
    before, here, after = values
    curvature = before - 2 * here + after
    return (
        float(np.clip(step * (before - after) / (2 * curvature), -step, step))
        if curvature > 0
        else 0.0
    )
