"""Estimates of the lags of surfaces and air data: a profile likelihood over the lag.

At one and the same time the angular accelerations follow from surfaces, rates and specific force, and alpha and beta
from specific force, rates and surfaces, locally as linear functions. All signals pass one band, so that trim and noise
stay outside; shifting the channels of one group until the residual is least tells how late they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import linalg, signal
from scipy.interpolate import CubicSpline

from skdgp._flight.clock import check_clock, runs_by_flight, uniform_grid
from skdgp.preprocessing._table import numeric

Floats = NDArray[np.float64]

FORCE, RATE = ("ax", "ay", "az"), ("p", "q", "r")
VANES = ("alpha", "beta")
ELEVONS, MIXED = ("elevon_left", "elevon_right"), ("elevator", "aileron")
SURFACES = (*MIXED, "rudder", *ELEVONS)
BAND = (0.3, 4.0)
"""Frequencies [Hz] at which aircraft answer to surfaces and gusts, trim below, noise above."""
STEADY = 0.2
"""Below this frequency [Hz] airspeed scales accelerations to coefficients, whatever its lag."""
EDGE = 1.5
"""Seconds at either end of a stretch that the filter may have spoilt, or a lag emptied."""
SHORTEST = 20.0
"""Seconds of a stretch that is worth looking at."""
REACH, COARSE, FINE = 0.5, 0.04, 0.01
"""Lags looked at [s], and the steps in which they are."""
SAME = 1e-6
"""Predictors nearer than this to a combination of others add nothing."""
BLOCK = 5.0
"""Seconds over which residuals may be correlated."""


class Lag(NamedTuple):
    """A group's lag [s], positive: late; its standard deviation; the share of the response that the model explains."""

    lag: float
    std: float
    explained: float


UNKNOWN = Lag(0.0, np.nan, np.nan)


class Stretch:
    """A gap-free stretch on a uniform clock: scaled accelerations, and channels that can be shifted."""

    def __init__(self, time: Floats, table: pd.DataFrame):
        self.time = uniform_grid(time)[0]
        self.sampling = (len(time) - 1) / (time[-1] - time[0])
        names = [name for name in (*FORCE, *RATE, *VANES, *SURFACES, "airspeed") if _heard(table, name)]
        self._splines = {name: CubicSpline(time, _filled(time, numeric(table, [name])[:, 0])) for name in names}
        speed = self._below(self.channels(["airspeed"]), STEADY) if "airspeed" in names else np.ones((len(time), 1))
        speed = np.maximum(speed, 0.1 * np.median(speed))
        rates = self.channels(RATE)
        turning = CubicSpline(self.time, self._below(rates, 2 * self._band[1]))(self.time, 1)
        self.force = self.filtered(self.channels(FORCE) / speed**2)
        self.rate = self.filtered(rates / speed)
        self.turning = self.filtered(turning / speed**2)

    def present(self, names) -> list[str]:
        """Return those of the names that this stretch has heard; elevons instead of what they are mixed to."""
        here = [name for name in names if name in self._splines]
        return [name for name in here if name not in MIXED] if {*ELEVONS} <= {*here} else here

    def channels(self, names, lag: float = 0.0) -> Floats:
        """Return channels (n, k) as they are when their sensors' lag is taken away."""
        later = np.clip(self.time + lag, self.time[0], self.time[-1])
        return np.column_stack([self._splines[name](later) for name in names]) if names else np.empty((len(later), 0))

    def filtered(self, columns: Floats) -> Floats:
        """Return columns within the band, without delay."""
        sections = signal.butter(2, self._band, "bandpass", fs=self.sampling, output="sos")
        return signal.sosfiltfilt(sections, columns, axis=0) if columns.shape[1] else columns

    def inner(self, columns: Floats) -> Floats:
        """Return columns without the ends of the stretch."""
        cut = round(EDGE * self.sampling)
        return columns[cut:-cut]

    @property
    def _band(self):
        return BAND[0], min(BAND[1], 0.2 * self.sampling)

    def _below(self, columns, frequency):
        return signal.sosfiltfilt(
            signal.butter(2, frequency, fs=self.sampling, output="sos"), columns, axis=0, padlen=self._reach(frequency)
        )

    def _reach(self, frequency):
        return min(len(self.time) - 1, round(2 * self.sampling / frequency))


def stretches(table: pd.DataFrame) -> list[list[Stretch]]:
    """Return the stretches of each flight that are long enough to look at."""
    time, codes = check_clock(numeric(table, ["time"])[:, 0], table.get("flight"))
    flights = []
    for runs in runs_by_flight(time, codes):
        long = [run for run in runs if time[run][-1] - time[run][0] > SHORTEST]
        whole = [run for run in long if all(_heard(table.iloc[run], name) for name in (*FORCE, *RATE))]
        flights.append([Stretch(time[run], table.iloc[run]) for run in whole])
    return [flight for flight in flights if flight]


def surface_lag(flights: list[list[Stretch]]) -> Lag:
    """Return the lag of surfaces: angular acceleration / V^2 from surfaces, rates / V and specific force / V^2."""

    def equation(stretch, lag):
        surfaces = stretch.filtered(stretch.channels(stretch.present(SURFACES), lag))
        return stretch.turning, np.hstack([surfaces, stretch.rate, stretch.force])

    return _estimate(flights, SURFACES, equation)


def air_lag(flights: list[list[Stretch]], surfaces: float) -> Lag:
    """Return the lag of vanes: alpha, beta from specific force / V^2, rates / V and surfaces of a known lag."""

    def equation(stretch, lag):
        vanes = stretch.filtered(stretch.channels(stretch.present(VANES), lag))
        moved = stretch.filtered(stretch.channels(stretch.present(SURFACES), surfaces))
        return vanes, np.hstack([stretch.force, stretch.rate, moved])

    return _estimate(flights, VANES, equation)


def _estimate(flights, names: Sequence[str], equation: Callable) -> Lag:
    """Return the lag that maximises -n / 2 sum_i log RSS_i over the responses i, RSS_i left by least squares."""
    flights = [[each for each in flight if each.present(names)] for flight in flights]
    flights = [flight for flight in flights if flight]
    if not flights:
        return UNKNOWN

    def residuals(lag):
        return [_residual([equation(stretch, lag) for stretch in flight], flight) for flight in flights]

    def misfit(lag):
        return np.log(sum(np.sum(each**2, axis=0) for each in residuals(lag))).sum()

    lag = _least(misfit)
    if lag is None:
        return UNKNOWN
    left = residuals(lag)
    total = sum(
        np.sum(stretch.inner(equation(stretch, lag)[0]) ** 2, axis=0) for flight in flights for stretch in flight
    )
    rest = sum(np.sum(each**2, axis=0) for each in left)
    slopes = [(b - a) / (2 * FINE) for a, b in zip(residuals(lag - FINE), residuals(lag + FINE), strict=True)]
    size = [round(BLOCK * flight[0].sampling) for flight in flights]
    return Lag(lag, _deviation(left, slopes, size), float(1 - np.mean(rest / total)))


def _residual(equations, flight):
    """Return what least squares over a flight's stretches leaves of the responses."""
    response, predictors = (
        np.concatenate([stretch.inner(part) for stretch, part in zip(flight, parts, strict=True)])
        for parts in zip(*equations, strict=True)
    )
    scale = np.linalg.norm(predictors, axis=0)
    Q, R, _ = linalg.qr(predictors / np.where(scale > 0, scale, 1.0), mode="economic", pivoting=True)
    Q = Q[:, np.abs(np.diag(R)) > SAME]
    return response - Q @ (Q.T @ response)


def _least(misfit) -> float | None:
    """Return where the misfit is least, by a scan and two parabolas; None at the edge of what is looked at."""
    steps = np.arange(-REACH, REACH + COARSE / 2, COARSE)
    values = [misfit(lag) for lag in steps]
    place = int(np.argmin(values))
    if place in (0, len(steps) - 1):
        return None
    lag = steps[place] + _vertex(values[place - 1 : place + 2], COARSE)
    for _ in range(2):
        lag += _vertex([misfit(lag - FINE), misfit(lag), misfit(lag + FINE)], FINE)
    return float(lag)


def _vertex(values, step):
    before, here, after = values
    bend = before - 2 * here + after
    return float(np.clip(step * (before - after) / (2 * bend), -step, step)) if bend > 0 else 0.0


def _deviation(residuals, slopes, blocks) -> float:
    """Return the standard deviation that residuals correlated within blocks leave: sqrt(sum_b S_b^2) / H.

    With e the residual of variance s^2 and g its derivative by the lag, S_b = sum over a block of g e / s^2 and H = sum
    g^2 / s^2 (Liang & Zeger 1986).
    """
    variance = sum(np.sum(e**2, axis=0) for e in residuals) / sum(len(e) for e in residuals)
    scores = [np.sum(g * e / variance, axis=1) for g, e in zip(slopes, residuals, strict=True)]
    sums = [np.add.reduceat(s, np.arange(0, len(s), size)) for s, size in zip(scores, blocks, strict=True)]
    information = sum(np.sum(g**2 / variance) for g in slopes)
    return float(np.sqrt(sum(np.sum(s**2) for s in sums)) / information)


def _heard(table, name):
    return name in table and np.isfinite(numeric(table, [name])).any()


def _filled(time, values):
    known = np.isfinite(values)
    return values if known.all() else np.interp(time, time[known], values[known])
