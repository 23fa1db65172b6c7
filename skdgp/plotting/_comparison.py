"""Panels of measured and estimated values with bands, and truth where it is known, against time."""

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
    # Where many samples share a pixel, thin lines show more.
    width = 1.0 if len(data.time) <= 4 * n_bins else 0.6

    def line(values, **style):
        if values is None:
            return None
        t, v = line_points(data.time, values, n_bins=n_bins, starts=starts)
        dots = list(lonely(v))
        return ax.plot(t, v, marker="." if dots else None, markersize=3, markevery=dots, **style)[0]

    # The thin measured line lies over the broad estimate: so both are seen where they agree.
    measured = line(data.measured, color=ROLES["measured"], linewidth=0.5 * width, zorder=2.2, label="measured")
    band = _draw_band(ax, data, starts, level, n_bins)
    truth = line(data.truth, color=ROLES["truth"], linewidth=0.7 * width, zorder=2.1, label="truth")
    mean = line(data.mean, color=ROLES["mean"], linewidth=1.8 * width, label="estimated")
    _limit(ax, data)
    return Artists(measured, mean, band, truth)


def _draw_band(ax, data: Comparison, starts, level: float, n_bins: int):
    if data.std is None:
        return None
    half = norm.ppf(0.5 + level / 2) * data.std
    t, lower, upper = band_points(data.time, data.mean - half, data.mean + half, n_bins=n_bins, starts=starts)
    # The edge keeps a band of one sample, which has no width, visible.
    style = {"color": ROLES["band"], "alpha": 0.5, "linewidth": 0.4, "label": f"{level:.0%} band"}
    band = ax.add_artist(_outline(t, lower, upper, **style))
    if t.size:
        # The corners suffice; add_patch would look along the whole outline.
        ax.update_datalim([(np.nanmin(t), np.nanmin(lower)), (np.nanmax(t), np.nanmax(upper))])
    return band


def _outline(t, lower, upper, **style):
    """Return one patch that runs around every stroke of a band: a picture of few elements, however many strokes."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    strokes = np.split(np.arange(len(t)), np.flatnonzero(np.isnan(t)))
    around, codes = [np.empty((0, 2))], [np.empty(0, dtype=Path.code_type)]
    for stroke in strokes:
        k = stroke[~np.isnan(t[stroke])]
        if k.size:
            there, back = np.column_stack([t[k], upper[k]]), np.column_stack([t[k], lower[k]])[::-1]
            around += [there, back, there[:1]]
            codes.append(np.full(2 * k.size + 1, Path.LINETO, dtype=Path.code_type))
            codes[-1][0], codes[-1][-1] = Path.MOVETO, Path.CLOSEPOLY
    return PathPatch(Path(np.concatenate(around), np.concatenate(codes)), **style)


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
