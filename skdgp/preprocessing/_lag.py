"""LagCorrector: estimates and removes lags of air data, surfaces, attitude and GPS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import linalg, signal
from scipy.interpolate import CubicSpline

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
from skdgp._flight.checks import WRAPPED, check_columns, numeric, unwrapped
from skdgp._flight.clock import check_clock, flight_segments, runs_by_flight, uniform_grid
from skdgp.preprocessing._flight_path import MIN_LAG, MIN_SIGNIFICANCE, kinematic_lags
from skdgp.preprocessing._path import NEEDED
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
KINEMATIC = {"attitude": "attitude_lag", "gps": "velocity_lag"}
MIN_EXPLAINED = 0.8  # least share of the response that the local linear model must explain
BAND = (0.3, 4.0)  # frequencies [Hz] of the response to surfaces and gusts, between trim and noise
# airspeed below this frequency [Hz] scales accelerations to coefficients, independent of its lag
STEADY = 0.2
EDGE = 1.5  # seconds at either end of a segment that the filter or a lag may distort
SHORTEST = 20.0  # least length of a segment [s]
RANGE, COARSE, FINE = (
    0.5,
    0.04,
    0.01,
)  # largest lag, step of the scan, and step of the parabolas [s]
RANK_TOLERANCE = 1e-6  # predictors nearer than this to a combination of others are left out
BLOCK = 5.0  # seconds over which residuals may be correlated


class Lag(NamedTuple):
    """A lag [s], positive if late; its standard deviation; the share of the response that the model explains."""

    lag: float
    std: float
    explained: float


UNKNOWN = Lag(0.0, np.nan, np.nan)


class LagCorrector(TableTransformer):
    r"""Estimate the lags of air data, surfaces, attitude and GPS against the inertial unit, and remove them.

    A channel with lag tau shows at t its value at t - tau, so it is replaced by its value at t +
    tau, segment by segment; beyond the end of a segment the last value is repeated. Sensors are
    shifted in the frequency domain, which keeps white noise white for :class:`FlightSmoother`;
    controls, and channels of a jittered clock, by cubic splines. Use full-rate flights, before
    smoothing.

    Attitude and GPS follow from gyros and accelerometers by kinematics, through
    :class:`FlightPathReconstruction`. Surfaces and vanes are related to them by a local linear
    model, without assumed derivatives: at the same time

    .. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
              (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

    all within the band from 0.3 to 4 Hz. The lag has the least sum of squares, the maximum of the
    profile likelihood (Jategaonkar 2006, chapter 10). Its standard deviation allows for residuals
    that are correlated within 5 s (Liang & Zeger 1986). Lags of throttle and propeller speed can be
    given, not estimated: engines respond slowly. Raises ValueError if ``time``, an accelerometer or
    a gyro is missing; if ``lags`` names neither a group nor a column, or is not finite.

    Parameters
    ----------
    lags : {"auto"}, dict or None, default="auto"
        Estimated in ``fit``; or given [s], positive where late, by group (air: airspeed, alpha,
        beta; surfaces; attitude; gps) or column; or None for no change.

    Attributes
    ----------
    lags_ : DataFrame
        By group or column: ``lag`` and ``std`` [s], ``explained`` (share of the response that the
        local linear model explains), ``applied`` (the removed lag [s]) and ``remark``. A lag below
        3 standard deviations or 10 ms, or of a model that explains less than 0.8, is not removed.

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

    def _fit_table(self, table):
        check_columns(table, ["time"])
        if isinstance(self.lags, str):
            check_columns(table, INERTIAL)
            flights = flights_of(table)
            found = _lags_of_motion(flights) | dict.fromkeys(KINEMATIC, UNKNOWN)
            if flights and has_values(table, *NEEDED):
                of_path = kinematic_lags(
                    table
                )  # attitude and GPS against integrated gyros and accelerometers
                found |= {
                    group: Lag(*of_path[constant], np.nan) for group, constant in KINEMATIC.items()
                }
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
            rows = {
                name: (float(each), np.nan, np.nan, float(each), "given")
                for name, each in lags.items()
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
                    new[name] = _shifted(time, values, lag, table.get("flight"), noisy=noisy)
                    if name in WRAPPED:
                        new[name] = wrapped_near(new[name], table[name])
        return with_columns(table, new)


def _shifted(time: Vector, values: Vector, lag: float, flight: Any, *, noisy: bool) -> Vector:
    """Return a channel without its lag, on the rows where it was sampled."""
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
        shifted[later > clock[-1]], shifted[later < clock[0]] = values[here[-1]], values[here[0]]
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
    if not np.isfinite(estimate.std):
        return 0.0, "not shown by these flights"
    if estimate.explained < MIN_EXPLAINED:
        return 0.0, "not shown: the local linear model explains too little"
    if abs(estimate.lag) < MIN_SIGNIFICANCE * estimate.std:
        return 0.0, "not significant"
    return (0.0, "negligible") if abs(estimate.lag) < MIN_LAG else (estimate.lag, "removed")


class Segment:
    """A gap-free segment on a uniform clock: scaled accelerations, and channels that can be shifted."""

    def __init__(self, time: Vector, table: pd.DataFrame) -> None:
        self.time = uniform_grid(time)[0]
        self.rate_hz = (len(time) - 1) / (time[-1] - time[0])
        self.band = BAND[0], min(BAND[1], 0.2 * self.rate_hz)
        names = [
            name
            for name in (*INERTIAL, *VANES, *ALL_SURFACES, "airspeed")
            if has_values(table, name)
        ]
        values = interpolate_missing(time, numeric(table, names))
        self.splines = {
            name: CubicSpline(time, column) for name, column in zip(names, values.T, strict=True)
        }
        speed = np.ones((len(time), 1))
        if "airspeed" in names:
            speed = self._low_pass(self.channels(["airspeed"]), STEADY)
            speed = np.maximum(speed, 0.1 * np.median(speed))
        rates = self.channels(RATES)
        acceleration = CubicSpline(self.time, self._low_pass(rates, 2 * self.band[1]))(self.time, 1)
        self.force = self._within_band(self.channels(SPECIFIC_FORCE) / speed**2)
        self.rate, self.acceleration = (
            self._within_band(rates / speed),
            self._within_band(acceleration / speed**2),
        )

    def present(self, names: Sequence[str]) -> list[str]:
        """Return the names that this segment has; elevons in place of elevator and aileron."""
        here = [name for name in names if name in self.splines]
        return [name for name in here if name not in MIXED] if {*ELEVONS} <= {*here} else here

    def channels(self, names: Sequence[str], lag: float = 0.0) -> Matrix:
        """Return channels (n, k) without their lag."""
        later = np.clip(self.time + lag, self.time[0], self.time[-1])
        return (
            np.column_stack([self.splines[name](later) for name in names])
            if names
            else np.empty((len(later), 0))
        )

    def filtered(self, names: Sequence[str], lag: float) -> Matrix:
        """Return those of the channels that the segment has without their lag, within the band."""
        return self._within_band(self.channels(self.present(names), lag))

    def _within_band(self, columns: Matrix) -> Matrix:
        sections = signal.butter(2, self.band, "bandpass", fs=self.rate_hz, output="sos")
        return signal.sosfiltfilt(sections, columns, axis=0) if columns.shape[1] else columns

    def inner(self, columns: Matrix) -> Matrix:
        """Return columns without the ends of the segment."""
        cut = round(EDGE * self.rate_hz)
        return columns[cut:-cut]

    def _low_pass(self, columns: Matrix, frequency: float) -> Matrix:
        sections = signal.butter(2, frequency, fs=self.rate_hz, output="sos")
        padding = min(len(self.time) - 1, round(2 * self.rate_hz / frequency))
        return signal.sosfiltfilt(sections, columns, axis=0, padlen=padding)


Flights = list[list[Segment]]
Equation = Callable[[Segment, float], tuple[Matrix, Matrix]]


def flights_of(table: pd.DataFrame) -> Flights:
    """Return the segments of each flight that are long enough and have all inertial sensors."""
    time, codes = check_clock(numeric(table, ["time"])[:, 0], table.get("flight"))
    flights = []
    for runs in runs_by_flight(time, codes):
        long = [
            run
            for run in runs
            if np.ptp(time[run]) > SHORTEST and has_values(table.iloc[run], *INERTIAL)
        ]
        flights.append([Segment(time[run], table.iloc[run]) for run in long])
    return [flight for flight in flights if flight]


def _lags_of_motion(flights: Flights) -> dict[str, Lag]:
    """Return the lags of vanes and surfaces by their groups, by the two local linear models of `LagCorrector`."""

    def moments(segment: Segment, lag: float) -> tuple[Matrix, Matrix]:
        return segment.acceleration, np.hstack(
            [segment.filtered(ALL_SURFACES, lag), segment.rate, segment.force]
        )

    def angles(segment: Segment, lag: float) -> tuple[Matrix, Matrix]:
        moved = segment.filtered(ALL_SURFACES, surfaces.lag)
        return segment.filtered(VANES, lag), np.hstack([segment.force, segment.rate, moved])

    surfaces = _profile_estimate(flights, ALL_SURFACES, moments)
    return {"air": _profile_estimate(flights, VANES, angles), "surfaces": surfaces}


def _profile_estimate(flights: Flights, names: Sequence[str], equation: Equation) -> Lag:
    """Return the lag that maximises -n / 2 sum_i log RSS_i over the responses i, RSS_i the residual sum of squares."""
    flights = [[segment for segment in flight if segment.present(names)] for flight in flights]
    flights = [flight for flight in flights if flight]
    if not flights:
        return UNKNOWN

    def residuals(lag: float) -> list[Matrix]:
        return [_residual(flight, equation, lag) for flight in flights]

    def squares(columns: list[Matrix]) -> Vector:
        return np.sum([np.sum(part**2, axis=0) for part in columns], axis=0)

    lag = _minimum(lambda lag: np.log(squares(residuals(lag))).sum())
    if lag is None:
        return UNKNOWN
    final = residuals(lag)
    responses = [
        segment.inner(equation(segment, lag)[0]) for flight in flights for segment in flight
    ]
    slopes = [
        (b - a) / (2 * FINE)
        for a, b in zip(residuals(lag - FINE), residuals(lag + FINE), strict=True)
    ]
    blocks = [round(BLOCK * flight[0].rate_hz) for flight in flights]
    explained = float(1 - np.mean(squares(final) / squares(responses)))
    return Lag(lag, _standard_deviation(final, slopes, blocks), explained)


def _residual(flight: list[Segment], equation: Equation, lag: float) -> Matrix:
    """Return the residuals of the responses over a flight's segments, by least squares."""
    sides = [[segment.inner(side) for side in equation(segment, lag)] for segment in flight]
    response, predictors = map(np.concatenate, zip(*sides, strict=True))
    scale = np.linalg.norm(predictors, axis=0)
    Q, R, _ = linalg.qr(
        predictors / np.where(scale > 0, scale, 1.0), mode="economic", pivoting=True
    )
    Q = Q[:, np.abs(np.diag(R)) > RANK_TOLERANCE]
    return response - Q @ (Q.T @ response)


def _minimum(objective: Callable[[float], float]) -> float | None:
    """Return the lag of the least objective, by a scan and two parabolas; None at the edge of the range."""
    steps = np.arange(-RANGE, RANGE + COARSE / 2, COARSE)
    values = [objective(lag) for lag in steps]
    place = int(np.argmin(values))
    if place in (0, len(steps) - 1):
        return None
    lag = steps[place] + _vertex(values[place - 1], values[place], values[place + 1], COARSE)
    for _ in range(2):
        lag += _vertex(objective(lag - FINE), objective(lag), objective(lag + FINE), FINE)
    return float(lag)


def _vertex(before: float, here: float, after: float, step: float) -> float:
    curvature = before - 2 * here + after
    return (
        float(np.clip(step * (before - after) / (2 * curvature), -step, step))
        if curvature > 0
        else 0.0
    )


def _standard_deviation(residuals: list[Matrix], slopes: list[Matrix], blocks: list[int]) -> float:
    """Return the standard deviation of a lag, sqrt(sum_b S_b^2) / H (Liang & Zeger 1986).

    With e the residual of variance s^2 and g its derivative by the lag, S_b = sum_b g e / s^2 and H
    = sum g^2 / s^2.
    """
    variance = sum(np.sum(e**2, axis=0) for e in residuals) / sum(len(e) for e in residuals)
    scores = [np.sum(g * e / variance, axis=1) for g, e in zip(slopes, residuals, strict=True)]
    sums = [
        np.add.reduceat(s, np.arange(0, len(s), size))
        for s, size in zip(scores, blocks, strict=True)
    ]
    information = sum(np.sum(g**2 / variance) for g in slopes)
    return float(np.sqrt(sum(np.sum(s**2) for s in sums)) / information)
