"""The most likely path of a flight given its sensors, and their noise, by Gauss-Newton steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skdgp._flight.channels import LEAST_GUST
from skdgp.preprocessing._reconstruction.bordered import Posterior, Prior, Rows, solve
from skdgp.preprocessing._reconstruction.kinematics import CONSTANTS, LAGS, PLACE, Log, Path, air_data_rows, looks, ties

Floats = NDArray[np.float64]

NOISE = {
    "accelerometer": 0.05,
    "gyro": 0.003,
    "airspeed": 0.5,
    "alpha": 0.01,
    "beta": 0.01,
    "v_horizontal": 0.2,
    "v_down": 0.2,
    "tilt": 0.01,
    "heading": 0.02,
}
"""Where the search for the sensors' noise starts: standard deviation of a sample, SI."""
GUSTS = {"gust_horizontal": 0.2, "gust_vertical": 0.2}
"""The same for gusts: standard deviation of their change in one second [m/s]."""
TIES = (*["accelerometer"] * 3, *["gyro"] * 3, "gust_horizontal", "gust_horizontal", "gust_vertical")
LOOKS = ("airspeed", "alpha", "beta", "v_horizontal", "v_horizontal", "v_down", "tilt", "tilt", "heading")
TINY = 1e-9
GUESSED = 10
"""So many residuals the starting value of a sensor's noise counts for: it decides where the flight tells nothing."""
LOOSE = np.repeat([1e-4, 1.0], 3)
"""Precision of what is known of a stretch's first velocity [m/s] and attitude [rad] before any sensor."""
WINDOW = 4096
"""So many samples are written out as equations at a time."""
WANDERS = 6
"""So many steps lags may change by whole samples."""
STEPS = 40
TOLERANCE = 0.02
N_DRAWS = 16


class Estimate(NamedTuple):
    """The path, what is known of it, the noise."""

    path: Path
    noise: dict[str, float]
    covariance: Floats
    """Of the free constants, (f, f)."""
    air_std: Floats
    """(3,) root mean square of the standard deviations of airspeed, alpha, beta."""
    converged: bool


def estimate(log: Log, start: Path, noise: dict, *, learn, free, gust_time: float) -> Estimate:
    """Return the most likely path, and the maximum-likelihood noise of the channels in ``learn``.

    Gauss-Newton on the path alternates with Foerstner's estimate of the variance components: a channel's variance is
    the sum of its squared residuals over its redundancy, the number of samples less what the path takes of them, the
    trace of J P J^T. At its fixed point the gradient of the marginal likelihood is zero (Searle, Casella & McCulloch
    1992, section 8.3). The traces are those of draws from the posterior.

    Parameters
    ----------
    log : Log
    start : Path
        Its constants are also those expected beforehand.
    noise : dict
        Standard deviations, of the names in NOISE and GUSTS, to start from.
    learn : collection of str
        Names in ``noise`` to be estimated.
    free : list of str
        Names of the constants to be estimated.
    gust_time : float
        Correlation time of gusts [s].
    """
    path, free = start, [PLACE[name] for name in free]
    draws = np.random.default_rng(0).standard_normal((9 * len(log.time) + len(free), N_DRAWS))
    off = pull = np.zeros(len(free))
    for step in range(STEPS):
        if step <= WANDERS:
            log = log._replace(late=_late(path, log))
        windows = _Windows(path, log, noise, free, gust_time)
        posterior = solve(windows, _prior(path, log, noise, free, off, pull, gust_time), draws)
        sums = _sums(_tie_names(log), windows, posterior)
        path = path.moved(posterior.states, _spread(posterior.constants, free))
        off = (path.constants - start.constants)[free]
        pull = _pull_of_scales(path, sums)[free]
        before, noise = noise, noise | _variance_components(sums, noise, learn, min(1.0, 10 / (step + 1)))
        settled = step > 0 and all(abs(np.log(noise[name] / before[name])) < TOLERANCE for name in learn)
        if settled and _small(posterior):
            break
    else:
        settled = False
    noise = noise | {kind: noise[alike] for kind, alike in zip(TIES[6:], _tie_names(log)[6:], strict=True)}
    return Estimate(path, noise, posterior.covariance, _air_std(path, posterior, free), settled)


def _late(path, log):
    """Return the lags in samples, rounded."""
    usual = np.median(np.diff(log.time)) if len(log.time) > 1 else np.inf
    return tuple(int(lag) for lag in np.round(path.of(*LAGS) / usual))


def _tie_names(log):
    """Without an alpha vane nothing tells vertical gusts from none: they are taken to be like horizontal ones."""
    return TIES if np.isfinite(log.air[:, 1]).any() else (*TIES[:-1], "gust_horizontal")


class _Windows:
    """Ties and looks in units of their noise, window by window; a flight of one window is written out once."""

    def __init__(self, path, log, noise, free, gust_time):
        self._arguments = path, log, noise, free, gust_time
        self._kept = None

    def __iter__(self):
        n = len(self._arguments[1].time)
        if n > WINDOW:
            yield from (self._window(first, min(first + WINDOW, n)) for first in range(0, n, WINDOW))
        else:
            self._kept = self._kept or self._window(0, n)
            yield self._kept

    def _window(self, first, last):
        path, log, noise, free, gust_time = self._arguments
        reach = 1 + max(map(abs, log.late))
        start, stop = max(first - reach, 0), min(last + reach, len(log.time))
        names = _tie_names(log)
        tied, seen = _rows(path.part(start, stop), log.part(start, stop), noise, free, gust_time, names)
        return first, tied.part(first - start, last - start), seen.part(first - start, last - start)


def _rows(path, log, noise, free, gust_time, names):
    step = np.diff(log.time)
    correlation = np.exp(-step / gust_time)
    scale = np.array([noise[name] for name in names]) * np.ones((len(step), 1))
    scale[:, 6:] *= np.sqrt(gust_time / 2 * (1 - correlation**2))[:, None]
    tied = _divided(ties(path, log, correlation), scale, free)
    return tied, _divided(looks(path, log), np.array([noise[name] for name in LOOKS]), free)


def _divided(rows, scale, free):
    each = scale[..., None]
    after = None if rows.after is None else rows.after / each
    return Rows(rows.residual / scale, rows.here / each, after, rows.shared[..., free] / each)


def _prior(path, log, noise, free, off, pull, gust_time):
    """Return what is known before any sensor: loosely where a stretch begins, and how large constants may be."""
    first = np.concatenate([[True], ~log.joined])[:, None]
    gusts = np.array([noise[name] for name in _tie_names(log)[6:]]) * np.sqrt(gust_time / 2)
    precision = first * np.concatenate([LOOSE, gusts**-2])
    states_off = np.zeros_like(precision)
    states_off[:, 6:] = path.gust
    stiffness = np.array(list(CONSTANTS.values()))[free] ** -2
    return Prior(precision, states_off, stiffness, off + pull / stiffness)


def _spread(values, free):
    constants = np.zeros(len(CONSTANTS))
    constants[free] = values
    return constants


class Sums(NamedTuple):
    """Over the samples of a channel, in units of its noise."""

    squares: float
    """Of the residuals."""
    trace: float
    """How many of its samples the path takes, J P J^T."""
    count: int


def _sums(tie_names, windows, posterior: Posterior):
    """Return the sums of each channel."""
    each = {name: np.zeros(3) for name in (*tie_names, *LOOKS)}
    for first, tied, seen in windows:
        for names, rows in ((tie_names, tied), (LOOKS, seen)):
            for name, sums in zip(names, _sums_of(rows, first, posterior), strict=True):
                each[name] += sums
    return {name: Sums(*sums) for name, sums in each.items()}


def _sums_of(rows, first, posterior):
    """Return squares, trace and count of each row of the batches, (m, 3)."""
    change = rows.changed(posterior.states[first:, :, None], posterior.constants[:, None])[..., 0]
    taken = np.square(rows.changed(posterior.state_draws[first:], posterior.constant_draws)).mean(axis=-1)
    used = np.any(rows.here != 0, axis=2)
    return np.column_stack([np.sum((rows.residual + change) ** 2, axis=0), taken.sum(axis=0), used.sum(axis=0)])


def _variance_components(sums, noise, learn, pace):
    """Return the new standard deviation of each channel in ``learn`` that was sampled.

    Of the noise of a random walk seen through other noise, residuals take a share that goes with the variance, and the
    redundancy goes with its root. Their fixed point would be approached by halves: the step is divided by one minus
    that slope. ``pace`` shortens it, should the search circle.
    """
    new = {}
    for name in learn:
        if name not in sums or not sums[name].count:
            continue
        squares, trace, count = sums[name]
        guessed, least = (GUESSED, TINY) if name in NOISE else (0, LEAST_GUST)
        redundancy = max(count - trace, 1.0)
        guess = guessed * (NOISE.get(name, 0.0) / noise[name]) ** 2
        ratio = (squares + guess) / (redundancy + guessed)
        slope = squares / (squares + guess + TINY) - redundancy / (redundancy + guessed) / 2
        stride = pace / (1 - min(slope, 0.5) * (1 - redundancy / count))
        new[name] = max(noise[name] * ratio ** (stride / 2), least)
    return new


def _pull_of_scales(path, sums):
    """Return the gradient by the scale factors that the most probable path alone does not feel.

    A larger scale lets smaller gusts explain the same air data, so the joint maximum of path and scale overestimates
    it. The marginal likelihood has the gradient of a determinant besides: trace / (1 + scale).
    """
    pull = np.zeros(len(CONSTANTS))
    for name in ("airspeed", "alpha", "beta"):
        place = PLACE[f"{name}_scale"]
        pull[place] = sums[name].trace / (1 + path.constants[place])
    return pull


def _small(posterior):
    """Whether the step was small beside the uncertainty of what it moved."""
    step = np.sqrt(np.mean(posterior.states**2, axis=0))
    return bool(np.all(step < TOLERANCE * np.sqrt(np.mean(posterior.state_draws**2, axis=(0, 2)))))


def _air_std(path, posterior, free):
    squares = np.zeros(3)
    for first in range(0, len(path.gust), WINDOW):
        rows = air_data_rows(path.part(first, first + WINDOW))
        rows = rows._replace(shared=rows.shared[..., free])
        errors = rows.changed(posterior.state_draws[first:], posterior.constant_draws)
        squares += np.square(errors).mean(axis=-1).sum(axis=0)
    return np.sqrt(squares / len(path.gust))
