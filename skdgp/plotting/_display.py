"""Base of the displays: panels, and long records with few points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.messages import extra
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Indices, Vector
from skdgp.plotting._style import (
    legend_above,
    tidy,
)

BAND = half_width(0.95)  # in standard deviations


class Display(ABC):
    """Base of displays: ``keys`` name the panels, and ``draw`` draws a panel."""

    axes_: np.ndarray
    figure_: Any
    size: tuple[float, float] = (4.6, 1.5)  # of a panel [in]
    by_column = False  # whether panels follow each other column by column

    @property
    @abstractmethod
    def keys(self) -> Sequence:
        """The keys of all panels."""

    @property
    def n_columns(self) -> int:
        """Number of columns of panels."""
        return 1 if len(self.keys) <= 3 else 2

    @property
    def n_rows(self) -> int:
        """Number of rows of panels."""
        return -(-len(self.keys) // self.n_columns)

    @property
    def figsize(self) -> tuple[float, float]:
        """Width and height of a figure of all panels [in]."""
        width, height = self.size
        return self.n_columns * width, 1 + self.n_rows * height

    @abstractmethod
    def draw(self, ax: Any, key: Any) -> None:
        """Draw the panel of a key into an Axes."""

    def plot(self, ax: Any = None) -> Self:
        """Draw all panels; for ``ax`` see :mod:`skdgp.plotting`."""
        if ax is False:
            return self
        keys = list(self.keys)
        extra("matplotlib", "plot")
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.figure(figsize=self.figsize, layout="constrained")
        self.figure_ = ax
        self.axes_ = ax.subplots(self.n_rows, self.n_columns, squeeze=False)
        cells = list(self.axes_.T.flat if self.by_column else self.axes_.flat)
        for cell, key in zip(cells, keys, strict=False):
            tidy(cell)
            self.draw(cell, key)
        for cell in cells[len(keys) :]:
            cell.set_visible(False)
        legend_above(cells[0])
        return self


def segment_starts(time: Vector, window: np.ndarray | None = None, longest: float = 5.0) -> Indices:
    """Return the indices where a new segment begins: after a gap, when time goes back, at a new window.

    A gap is longer than ``longest`` times the usual step.
    """
    step = np.diff(time)
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= longest * usual))
    if window is not None:
        cut |= window[1:] != window[:-1]
    return np.flatnonzero(np.concatenate([[True], cut]))


def _slices(time: Vector, starts: Indices, n_slices: int = 300) -> Indices:
    """Return the number of each sample's slice of a record; it jumps by two where a line breaks."""
    new = np.zeros(len(time), dtype=int)
    new[:: max(1, len(time) // n_slices)] = 1
    new[starts] = 2
    return np.cumsum(new)


def line_points(time: Vector, values: Vector, starts: Indices) -> tuple[Vector, Vector]:
    """Return the lowest and the highest sample of each slice of a record, with NaN where the line breaks.

    It breaks at ``starts`` of segments, and at slices without a finite value.

    >>> t = np.arange(10_000) / 100.0
    >>> v = np.sin(t)
    >>> v[5000] = 7.0
    >>> few_t, few_v = line_points(t, v, segment_starts(t))
    >>> len(few_t) < 610, float(few_v.max())
    (True, 7.0)
    """
    number = _slices(time, starts)
    finite = pd.Series(values)[np.isfinite(values)]
    slices = finite.groupby(number[finite.index])
    rows = np.unique(np.concatenate([slices.idxmin(), slices.idxmax()])).astype(int)
    gaps = np.flatnonzero(np.diff(number[rows]) > 1) + 1
    return np.insert(time[rows], gaps, np.nan), np.insert(values[rows], gaps, np.nan)


def band_points(
    time: Vector, lower: Vector, upper: Vector, starts: Indices
) -> tuple[Vector, Vector, Vector]:
    """Return times, lower and upper edge of a band: in each slice the union of the samples' intervals."""
    band = pd.DataFrame({"time": time, "lower": lower, "upper": upper})
    finite = band[np.isfinite(band).all(axis=1)]
    slices = finite.groupby(_slices(time, starts)[finite.index])
    edges = pd.DataFrame({"lower": slices["lower"].min(), "upper": slices["upper"].max()})
    # A slice has the same edges from its first to its last time
    first = edges.assign(time=slices["time"].min())
    last = edges.assign(time=slices["time"].max())
    ends = pd.concat([first, last]).sort_index(kind="stable")
    gaps = np.flatnonzero(np.diff(ends.index) > 1) + 1
    low, high, times = np.insert(ends.to_numpy(float), gaps, np.nan, axis=0).T
    return times, low, high
