"""Flight-path reconstruction: whether it or smoothing has the smaller errors of air data, by the flights themselves."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import AIR_DATA
from skdgp._flight.checks import numeric
from skdgp._flight.frames import air_data
from skdgp.preprocessing._path_equations import MIN_AIRSPEED, Log
from skdgp.preprocessing._path_estimate import Estimate
from skdgp.preprocessing._smoother import FlightSmoother

MAX_RATIO = 1.05  # largest error of reconstruction, relative to that of smoothing, with which it is used
MAX_AIR_NOISE = 1.4
"""Residual of an air data sensor, relative to its own noise, above which the sensor counts as free of noise."""
MAX_INERTIAL_NOISE = 4.0
"""Residual of gyros and accelerometers, relative to their own noise, above which the reason names them."""
DIFFERENCES = 3  # order of the differences that show noise; the sum of squares of their coefficients is 20
PROBE = 0.3  # size of the random change that shows the slope of a smoother, in units of noise
UNITS = {"airspeed": ("m/s", 1.0), "alpha": ("deg", 180 / np.pi), "beta": ("deg", 180 / np.pi)}
FOLLOWS = {
    "gyro": ("the attitude does not follow the gyros", "deg/s", 180 / np.pi),
    "accelerometer": ("the velocity does not follow the accelerometers", "m/s2", 1.0),
    **{name: (f"{name} does not follow the motion", *unit) for name, unit in UNITS.items()},
}
"""What contradicts itself if the residual of a sensor is large, its unit, and the factor to that unit."""

Flights = Sequence[tuple[Any, Indices, Log, Estimate]]


def expected_errors(table: pd.DataFrame, estimates: Flights, noise: Mapping[str, float]) -> pd.DataFrame:
    r"""Return noise, residual and expected errors of the sensors of a table, by the paths estimated from it.

    An estimate x of a channel from samples y of white noise :math:`\sigma` has the mean squared error

    .. math:: \overline{(y - x)^2} - \sigma^2 + 2 \sigma^2\, \overline{\partial x / \partial y}

    without knowledge of the truth (Stein 1981). The mean slope of the path is its variance over that of the noise; the
    slope of the smoother follows from a small random change of the samples (Ramani, Blu & Unser 2008). A constant
    error of a sensor, or a lag, is not seen. Third differences contain a little motion, so :math:`\sigma` is zero where
    the residual exceeds 1.4 times the noise. Of n samples the first term has the standard error
    :math:`\sigma^2 \sqrt{2 / n}`: a mean squared error below it cannot be told from zero. Columns are those of
    ``FlightPathReconstruction.errors_``.
    """
    raw = numeric(table, AIR_DATA)
    path, slope = _path_air(raw.shape, estimates)
    known = np.isfinite(raw) & np.isfinite(path)
    squares = {kind: _noise_squares(kind, estimates) for kind in ("air", "rate", "force")}
    stds = np.sqrt(squares["air"])
    learned = np.array([noise[name] for name in AIR_DATA])
    variance = np.where(learned > MAX_AIR_NOISE * stds, 0.0, stds**2)
    smoothed, smoother_slope = _smoothed(table, raw, stds)
    rows = {}
    for row, name in enumerate(AIR_DATA):
        here = known[:, row]
        measured = raw[here, row]
        errors = [
            np.mean((measured - estimate[here, row]) ** 2) + variance[row] * (2 * gain[row] - 1)
            for estimate, gain in ((path, slope), (smoothed, smoother_slope))
        ]
        least = variance[row] * np.sqrt(2 / max(len(measured), 1))
        rows[name] = (stds[row], noise[name], *np.sqrt(np.maximum(errors, least)), measured.std())
    for name, kind in (("gyro", "rate"), ("accelerometer", "force")):
        rows[name] = (float(np.sqrt(np.mean(squares[kind]))), noise[name], np.nan, np.nan, np.nan)
    columns = ["noise", "residual", "reconstruction", "smoothing", "deviation"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("sensor")


def decision(errors: pd.DataFrame) -> tuple[bool, str]:
    """Return whether the reconstruction is used, and why, in words.

    It is if the mean square of expected error / deviation of airspeed, alpha, beta is at most 1.05^2 that of smoothing.
    """
    air = errors.loc[list(AIR_DATA)]
    weights = np.divide(1.0, air.deviation**2, out=np.zeros(len(air)), where=air.deviation.to_numpy() > 0)
    path, smoothing = (float(np.sqrt(weights @ air[name] ** 2)) for name in ("reconstruction", "smoothing"))
    used = path <= MAX_RATIO * smoothing
    words = [f"expected errors {_listed(air.reconstruction)}; of smoothing {_listed(air.smoothing)}"]
    for name, (what, unit, factor) in FOLLOWS.items() if not used else ():
        residual, noise = factor * errors.residual[name], factor * errors.noise[name]
        if residual > (MAX_AIR_NOISE if name in AIR_DATA else MAX_INERTIAL_NOISE) * noise:
            words.append(f"{what} (residual {residual:.2g} {unit}, noise {noise:.2g})")
    return used, "; ".join(words)


def _listed(errors: pd.Series) -> str:
    return ", ".join(f"{name} {round(factor * errors[name], 6):.2g} {unit}" for name, (unit, factor) in UNITS.items())


def _path_air(shape: tuple[int, ...], estimates: Flights) -> tuple[Matrix, Vector]:
    """Return what airspeed and vanes should measure on the paths (n, 3), and the mean slope by their own samples."""
    values, slope = np.full(shape, np.nan), np.zeros(3)
    for _, rows, _, each in estimates:
        air = np.column_stack(air_data(each.path.air_velocity()))
        air[air[:, 0] < MIN_AIRSPEED] = np.nan
        scale = 1 + each.path.constant("airspeed_scale", "alpha_scale", "beta_scale")
        values[rows] = scale * air + [0.0, *each.path.constant("alpha_bias", "beta_bias")]
        learned = np.array([each.noise[name] for name in AIR_DATA])
        slope += len(rows) / shape[0] * (scale * each.air_std / learned) ** 2
    return values, slope


def _noise_squares(kind: str, estimates: Flights) -> Vector:
    """Return the variance of white noise in the columns of each flight's log, from their third differences."""
    total, count = np.zeros(3), np.zeros(3)
    for _, _, log, _ in estimates:
        for place, column in enumerate(getattr(log, kind).T):
            rows = np.flatnonzero(np.isfinite(column))
            if len(rows) > DIFFERENCES:
                joined = log.segment[rows[DIFFERENCES:]] == log.segment[rows[:-DIFFERENCES]]
                squares = np.diff(column[rows], DIFFERENCES)[joined] ** 2 / 20
                total[place], count[place] = total[place] + squares.sum(), count[place] + len(squares)
    return total / np.maximum(count, 1)


def _smoothed(table: pd.DataFrame, raw: Matrix, noise: Vector) -> tuple[Matrix, Vector]:
    """Return smoothed air data (n, 3), and their mean slope by their own samples."""
    probe = np.random.default_rng(0).standard_normal(raw.shape)
    moved = table.assign(**dict(zip(AIR_DATA, (raw + PROBE * noise * probe).T, strict=True)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of flights too short to smooth: the pipeline's smoother says it
        smoother = FlightSmoother(columns=list(AIR_DATA), derivatives=[])
        before, after = (numeric(smoother.fit_transform(one), AIR_DATA) for one in (table, moved))
    response = np.nanmean((after - before) * probe, axis=0)
    return before, np.divide(response, PROBE * noise, out=np.ones(3), where=noise > 0)
