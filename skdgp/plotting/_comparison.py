"""One panel that compares: measured, estimated with its band, and truth where it is known, against time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from skdgp.plotting._envelope import band_points, line_points, lonely, stretch_starts
from skdgp.plotting._style import ROLES

BAND_ROOM = 0.6
"""A band widens the vertical axis by at most this part of the lines' own range, so the lines stay readable."""


class Comparison(NamedTuple):
    """Columns of one quantity in the unit shown, and where their lines break."""

    time: np.ndarray
    measured: np.ndarray
    mean: np.ndarray
    std: np.ndarray | None = None
    truth: np.ndarray | None = None
    window: np.ndarray | None = None

    def within(self, time_span) -> Comparison:
        """Return the part between two times (None: everything)."""
        if time_span is None:
            return self
        begin, end = time_span
        inside = (self.time >= begin) & (self.time <= end)
        if not inside.any():
            raise ValueError(
                f"Got time_span {begin:g} to {end:g} s, but the samples run from {self.time.min():g} to "
                f"{self.time.max():g} s: choose a span inside."
            )
        return Comparison(*(None if values is None else values[inside] for values in self))

    def less_mean(self) -> Comparison:
        """Return everything relative to the estimate."""
        truth = None if self.truth is None else self.truth - self.mean
        return self._replace(measured=self.measured - self.mean, mean=0 * self.mean, truth=truth)


class Artists(NamedTuple):
    """What was drawn in one panel; None for what was not given."""

    measured: object
    mean: object
    band: object
    truth: object


def draw_comparison(ax, data: Comparison, *, level: float, n_bins: int) -> Artists:
    """Draw one panel and return its artists."""
    starts = stretch_starts(data.time, data.window)

    def line(values, **style):
        if values is None:
            return None
        t, v = line_points(data.time, values, n_bins=n_bins, starts=starts)
        dots = list(lonely(v))
        return ax.plot(t, v, marker="." if dots else None, markersize=3, markevery=dots, **style)[0]

    measured = line(data.measured, color=ROLES["measured"], linewidth=0.8, alpha=0.75, label="measured")
    band = _draw_band(ax, data, starts, level, n_bins)
    truth = line(data.truth, color=ROLES["truth"], linewidth=1.0, label="truth")
    mean = line(data.mean, color=ROLES["mean"], linewidth=1.0, label="estimated")
    _limit(ax, data)
    return Artists(measured, mean, band, truth)


def _draw_band(ax, data: Comparison, starts, level: float, n_bins: int):
    if data.std is None:
        return None
    half = norm.ppf(0.5 + level / 2) * data.std
    t, lower, upper = band_points(data.time, data.mean - half, data.mean + half, n_bins=n_bins, starts=starts)
    # The edge keeps a band of one sample, which has no width, visible.
    return ax.fill_between(t, lower, upper, color=ROLES["band"], alpha=0.35, linewidth=0.4, label=f"{level:.0%} band")


def _limit(ax, data: Comparison) -> None:
    """Fit the vertical axis to the lines; a band wider than that runs out of the picture."""
    lines = np.concatenate([v for v in (data.measured, data.mean, data.truth) if v is not None])
    lines = lines[np.isfinite(lines)]
    if lines.size == 0 or np.ptp(lines) == 0:
        return
    room = BAND_ROOM * np.ptp(lines)
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, lines.min() - room), min(high, lines.max() + room))


def check_level(level) -> float:
    """Return a probability strictly between 0 and 1."""
    if not 0 < level < 1:
        raise ValueError(f"Got level={level!r}, but expected a probability between 0 and 1, such as 0.95.")
    return float(level)
