"""Base of the displays: panels, and lines with gaps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Array, Matrix, Vector
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


def segments(
    time: Vector, values: Array, window: np.ndarray | None = None, longest: float = 5.0
) -> Matrix:
    """Return time and columns of values (n, ...), rows with NaN where a line breaks.

    Rows that are not known are left out. A line breaks at a gap longer than ``longest`` times the usual step, when
    time goes back, at a new window.

    >>> segments(np.array([0.0, 1.0, 2.0, 9.0]), np.array([5.0, 6.0, 7.0, 8.0]))[1]
    array([ 5.,  6.,  7., nan,  8.])
    """
    rows = np.column_stack([time, values])
    is_known = np.isfinite(rows).all(axis=1)
    rows = rows[is_known]
    step = np.diff(rows[:, 0])
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= longest * usual))
    if window is not None:
        cut |= np.diff(window[is_known]) != 0
    return np.insert(rows, np.flatnonzero(cut) + 1, np.nan, axis=0).T
