"""Alpha and beta by specific force, of flights without vanes: the aircraft is its own vane."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.atmosphere import SEA_LEVEL_DENSITY
from skdgp._flight.channels import ELEVONS, RATES, VANES
from skdgp._flight.checks import numeric
from skdgp._flight.frames import air_data
from skdgp.preprocessing._path import MIN_AIRSPEED, FlightPath, Log
from skdgp.preprocessing._table import has_values, interpolate_missing

FORCES = {"alpha": "az", "beta": "ay"}
OTHERS = {"alpha": ("q", "elevator", *ELEVONS), "beta": ("p", "r", "aileron", "rudder", *ELEVONS)}
"""What else makes the force, of a symmetric aircraft."""
BLOCK, LEAST_BLOCKS = (
    10.0,
    6,
)  # s of a flight that count as one sample of a slope, and how many there must be
FASTER = 2.0
"""Cutoff over the rate at which the aircraft follows gusts.

Of 1.5, 2 and 3, errors of slopes are least with 2 on five
aircraft of JSBSim on which nothing was chosen."""
START, LOWEST, OF_RATE = (
    0.5,
    0.2,
    0.125,
)  # cutoff [Hz]: first, lowest, and highest over the rate of the log
PASSES = 20
WIDER = 2.6
"""True errors of slopes over those of the jackknife, root mean square over 59 slopes of ten aircraft of JSBSim. Any
nine of them give 2.4 to 2.8, and 95 % of slopes of the tenth lie within two deviations."""
MAX_STD = 0.4  # relative deviation of the slope, from which a flight does not tell it


Piece: TypeAlias = tuple[Vector, Indices, Matrix]
"""Time, number of the segment, and f / (rho V^2), angle, others (n, 2 + k) of a flight."""


class ForceVane(NamedTuple):
    """A coefficient of force over the air, f / (rho V^2) = zero + slope angle + others (p/V, ..., surfaces)."""

    force: str
    slope: float
    others: dict[str, float]
    zero: float
    std: float  # of the slope, relative
    cutoff: float  # above which it was found [Hz]


def force_vanes(
    table: pd.DataFrame, flights: Iterable[tuple[Indices, Log, FlightPath]]
) -> dict[str, ForceVane]:
    """Return what makes specific force a vane of alpha, beta, where the table has none and its flights tell.

    Alpha of attitude and velocity lacks the gusts, which a force contains. Slow gusts lift the
    aircraft, so that this alpha falls while the true one stays: least squares takes that for a weak
    lift slope. A force f = m^-1 qbar S C follows gusts at the rate -f_w = -slope rho V [rad/s].
    Above twice that rate the motion is that of the controls, and gusts are noise: slopes are of
    what a high-pass filter leaves there. The mean of gusts is taken as zero.
    """
    whole = [
        (table.iloc[rows], log, path) for rows, log, path in flights if np.ptp(log.time) >= BLOCK
    ]
    parts = [each for each in whole if np.nanmax(each[1].air[:, 0]) > MIN_AIRSPEED]
    found: dict[str, ForceVane] = {}
    for name, force in FORCES.items():
        if has_values(table, name) or not parts:
            continue
        others = [
            other for other in OTHERS[name] if all(has_values(part, other) for part, *_ in parts)
        ]
        pieces = []
        for part, log, path in parts:
            values = interpolate_missing(log.time, _terms(part, force, others))
            angle = air_data(path.air_velocity())[1 + VANES.index(name)]
            pieces.append((log.time, log.segment, np.insert(values, 1, angle, axis=1)))
        flow = np.concatenate([_density(part) * log.air[:, 0] for part, log, _ in parts])
        slopes, std, cutoff = _fast_slopes(pieces, float(np.nanmean(flow)))
        if std < MAX_STD and slopes[0] < 0:
            rest = np.concatenate(
                [values[:, 0] - values[:, 1:] @ slopes for _, _, values in pieces]
            )
            by_others = dict(zip(others, slopes[1:].tolist(), strict=True))
            found[name] = ForceVane(
                force, float(slopes[0]), by_others, float(rest.mean()), std, cutoff
            )
    return found


def with_force_vanes(table: pd.DataFrame, vanes: dict[str, ForceVane]) -> pd.DataFrame:
    """Return the table with angles of those vanes that it lacks, where it has what they need."""
    new = {}
    for name, vane in vanes.items():
        if not has_values(table, name) and {*vane.others} <= {*table}:
            force, *others = _terms(table, vane.force, [*vane.others]).T
            new[name] = (
                force - vane.zero - np.array([*vane.others.values()]) @ others
            ) / vane.slope
    return table.assign(**new)


def _terms(table: pd.DataFrame, force: str, others: Sequence[str]) -> Matrix:
    """Return f / (rho V^2), rates / V, surfaces, (n, 1 + k); NaN in too slow air."""
    speed = numeric(table, ["airspeed"])[:, 0]
    speed = np.where(speed > MIN_AIRSPEED, speed, np.nan)
    columns = numeric(table, [force, *others])
    scale = [
        _density(table) * speed**2,
        *(speed if name in RATES else np.ones(len(table)) for name in others),
    ]
    return columns / np.column_stack(scale)


def _density(table: pd.DataFrame) -> Vector:
    return (
        numeric(table, ["density"])[:, 0]
        if has_values(table, "density")
        else np.full(len(table), SEA_LEVEL_DENSITY)
    )


def _fast_slopes(pieces: list[Piece], flow: float) -> tuple[Vector, float, float]:
    """Return the slopes, the deviation of the first, and the cutoff, `FASTER` times -f_w by the mean of rho V."""
    highest = OF_RATE / max(float(np.median(np.diff(time))) for time, *_ in pieces)
    cutoff = START
    for _ in range(PASSES):
        cutoff = float(np.clip(cutoff, LOWEST, highest))
        slopes, std = _slopes(pieces, cutoff)
        wanted = -FASTER * slopes[0] * flow / (2 * np.pi)
        if not std < MAX_STD or abs(wanted - cutoff) < 0.01 * cutoff:
            break
        cutoff = wanted
    return slopes, std, cutoff


def _slopes(pieces: list[Piece], cutoff: float) -> tuple[Vector, float]:
    """Return the slopes (1 + k,) of the force above a frequency, and the relative deviation of the first one.

    The deviation is that of a jackknife over blocks of some seconds, as what is left of gusts is
    correlated.
    """
    grams = []
    for time, segment, values in pieces:
        for number in np.unique(segment):
            rows = segment == number
            seconds = time[rows] - time[rows][0]
            if seconds[-1] >= BLOCK:
                step = float(np.median(np.diff(seconds)))
                fast = sosfiltfilt(
                    butter(2, cutoff, "high", fs=1 / step, output="sos"), values[rows], axis=0
                )
                blocks = np.array_split(fast, int(seconds[-1] / BLOCK))
                grams += [block.T @ block for block in blocks]
    if len(grams) < LEAST_BLOCKS:
        return np.zeros(pieces[0][2].shape[1] - 1), np.inf
    total, n = np.sum(grams, axis=0), len(grams)
    whole, *without = (
        np.linalg.lstsq(G[1:, 1:], G[1:, 0], rcond=None)[0]
        for G in (total, *(total - np.array(grams)))
    )
    return whole, float(
        WIDER * np.std([each[0] for each in without]) * np.sqrt(n - 1) / abs(whole[0])
    )
