"""Base of the displays: panels, their artists, checks of what is drawn, and long records with few points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from skdgp._compute.predicting import predict_with_noise
from skdgp._compute.typing import ArrayLike, Indices, Mask, Matrix, Vector
from skdgp._display.style import check_matplotlib, legend_above, tidy
from skdgp._flight.clock import true_runs

Names: TypeAlias = "str | Sequence[str] | None"
GAP = 5.0  # usual steps; no line is drawn across a longer one


class Display:
    """Base of displays: draws panels and keeps their axes."""

    axes_: np.ndarray
    figure_: Any

    def _draw_panels(
        self,
        ax,
        draw,
        keys,
        n_cols,
        figsize,
        *,
        xlabel=None,
        by_column=False,
        legend=False,
        **subplots,
    ) -> list[list]:
        """Draw a tidy panel per key with ``draw(axes, key)``, and return the artists: a list over panels of each kind.

        ``figsize`` is that of one panel [inch]; ``by_column`` fills the panels column by column.
        """
        n_rows = -(-len(keys) // n_cols)
        figsize = (n_cols * figsize[0], 1 + n_rows * figsize[1])
        self.axes_ = panels(ax, n_rows, n_cols, figsize=figsize, **subplots)
        self.figure_ = self.axes_.flat[0].figure
        cells = list(self.axes_.T.flat if by_column else self.axes_.flat)
        for k, one in enumerate(cells):
            tidy(one)
            one.set_visible(k < len(keys))
        artists = [draw(one, key) for one, key in zip(cells, keys, strict=False)]
        if xlabel is not None:
            for bottom in self.axes_[-1]:
                bottom.set_xlabel(xlabel)
        if legend:
            legend_above(self.axes_.flat[0])
        return [list(kind) for kind in zip(*artists, strict=True)]


def panels(
    ax: Any, n_rows: int, n_cols: int, *, figsize: tuple[float, float], **subplots: Any
) -> np.ndarray:
    """Return an ``(n_rows, n_cols)`` array of axes.

    ``ax`` is None (a new pyplot figure), a Figure or SubFigure (filled), an array of as many axes
    as panels, or one Axes, which is divided when there are several panels.
    """
    check_matplotlib("skdgp.plotting")
    from matplotlib.axes import Axes

    shape = (n_rows, n_cols)
    if ax is None:
        import matplotlib.pyplot as plt

        return plt.subplots(
            *shape, figsize=figsize, layout="constrained", squeeze=False, **subplots
        )[1]
    if hasattr(ax, "subplots"):
        return ax.subplots(*shape, squeeze=False, **subplots)
    if isinstance(ax, Axes) and shape != (1, 1):
        ax.set_axis_off()
        if (spec := ax.get_subplotspec()) is None:
            raise ValueError(
                f"Got one free-standing Axes for {n_rows} x {n_cols} panels, but expected one "
                f"made by subplots, "
                "which can be divided: give a Figure instead."
            )
        return spec.subgridspec(*shape).subplots(squeeze=False, **subplots)
    given = np.asarray(ax, dtype=object)
    if given.size != n_rows * n_cols or not all(isinstance(one, Axes) for one in given.flat):
        raise ValueError(
            f"Got {given.size} axes, but expected {n_rows * n_cols} (or one Axes, a Figure, or "
            f"None): "
            f"use fig, axes = plt.subplots({n_rows}, {n_cols})."
        )
    return given.reshape(shape)


def as_columns(values: ArrayLike, what: str, shape: tuple[int, ...] | None = None) -> Matrix:
    """Return ``values`` as floats ``(n, P)``, NaN allowed; a vector is one column."""
    values = np.asarray(values, dtype=float)
    values = values[:, np.newaxis] if values.ndim == 1 else values
    if values.ndim != 2:
        raise ValueError(
            f"Got {what} of shape {values.shape}, but expected (n_samples, n_outputs)."
        )
    if shape is not None and values.shape != shape:
        raise ValueError(
            f"Got {what} of shape {values.shape}, but expected {shape}, like the values it is "
            f"compared with."
        )
    return values


def check_std(std: Any, shape: tuple[int, ...]) -> Any:
    """Return standard deviations ``(n, P)``, none negative; None for None."""
    if std is None:
        return None
    std = as_columns(std, "std", shape)
    if np.any(std < 0):
        raise ValueError(
            f"Got standard deviations down to {np.nanmin(std):.3g}, but expected none below 0."
        )
    return std


def names_of(
    values: object, n_outputs: int, given: Any = None, default: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the outputs' names: given, else the DataFrame's columns, else ``default``, else y0, y1, ..."""
    if given is None:
        columns = getattr(values, "columns", None)
        given = default if columns is None and len(default) == n_outputs else columns
    names = [f"y{i}" for i in range(n_outputs)] if given is None else [str(name) for name in given]
    if len(names) != n_outputs or len(set(names)) != n_outputs:
        raise ValueError(
            f"Got the names {names} for {n_outputs} outputs: give each output one name of its own."
        )
    return tuple(names)


def choose(names: Sequence[str], wanted: Names) -> list[int]:
    """Return the positions of the ``wanted`` names; all, for None."""
    wanted = names if wanted is None else [wanted] if isinstance(wanted, str) else wanted
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise ValueError(f"Got the outputs {unknown}, but expected some of {list(names)}.")
    return [list(names).index(name) for name in wanted]


def grid_columns(n_panels: int) -> int:
    """Return the number of columns: two for four panels and more, forces left and moments right."""
    return 1 if n_panels <= 3 else 2


def predicted(estimator: Any, X: Any, Y: Any, include_noise: bool) -> tuple[Any, Any, Any]:
    """Return mean and std of a fitted estimator, and its names of outputs where Y has none."""
    check_matplotlib("skdgp.plotting")
    names = None if hasattr(Y, "columns") else getattr(estimator, "output_names_", None)
    moments = (
        predict_with_noise(estimator, X) if include_noise else estimator.predict(X, return_std=True)
    )
    return *moments, names


def segment_starts(time: Vector, window: np.ndarray | None = None) -> Indices:
    """Return the indices where a new segment begins: after a gap, when time goes back, at a new window."""
    step = np.diff(time)
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= GAP * usual))
    if window is not None:
        cut |= window[1:] != window[:-1]
    return np.flatnonzero(np.concatenate([[True], cut]))


def _slices(
    time: Vector, finite: Mask, starts: Indices | None, n_bins: int
) -> tuple[Indices, Indices, Indices]:
    """Return indices of finite samples; which of these begin a time slice; and of each the number of its line."""
    starts = segment_starts(time) if starts is None else starts
    sample = np.flatnonzero(finite)
    t = time[sample]
    width = (t.max() - t.min()) / n_bins if t.size else 0.0
    segment = np.cumsum(np.bincount(starts, minlength=len(time)))[sample]
    # A missing value breaks the line only if the hole is wide enough to be visible.
    broken = (np.diff(segment) != 0) | ((np.diff(sample) > 1) & (np.diff(t) > width))
    new_line = np.concatenate([[True], broken])[: len(sample)]
    if len(sample) <= 2 * n_bins or width == 0.0:
        first = np.arange(len(sample))
    else:
        column = np.floor((t - t.min()) / width)
        first = np.flatnonzero(new_line | (np.diff(column, prepend=np.nan) != 0))
    return sample, first, np.cumsum(new_line)


def line_points(
    time: Vector, values: Vector, *, n_bins: int, starts: Indices | None = None
) -> tuple[Vector, Vector]:
    """Return the lowest and the highest sample of each of ``n_bins`` time slices, with NaN where the line breaks.

    It breaks at ``starts``, by default after gaps in time, and at values that are not finite.

    >>> t = np.arange(10_000) / 100.0
    >>> v = np.sin(t); v[5000] = 7.0
    >>> few_t, few_v = line_points(t, v, n_bins=100)
    >>> len(few_t) < 210, float(few_v.max())
    (True, 7.0)
    """
    sample, first, line = _slices(time, np.isfinite(values) & np.isfinite(time), starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0)
    time, values = time[sample], values[sample]
    ends = np.flatnonzero(np.diff(line))
    kept = [ends, ends + 1, np.array([0, len(values) - 1])]
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(values)))  # of the slice
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == extreme.reduceat(values, first)[number])
        kept.append(hits[np.unique(number[hits], return_index=True)[1]])  # one in each slice
    points = np.unique(np.concatenate(kept))
    gaps = np.flatnonzero(np.diff(line[points])) + 1
    return np.insert(time[points], gaps, np.nan), np.insert(values[points], gaps, np.nan)


def band_points(
    time: Vector, lower: Vector, upper: Vector, *, n_bins: int, starts: Indices | None = None
) -> tuple[Vector, Vector, Vector]:
    """Return times, lower and upper edge of a band that looks the same, with NaN where it breaks.

    In each slice the band is the union of the samples' intervals.
    """
    finite = np.isfinite(time) & np.isfinite(lower) & np.isfinite(upper)
    sample, first, line = _slices(time, finite, starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0), np.empty(0)
    low, high = np.minimum.reduceat(lower[sample], first), np.maximum.reduceat(upper[sample], first)
    last = np.append(first[1:], len(sample)) - 1
    ends = (
        first[:, None] if np.array_equal(first, last) else np.column_stack([first, last])
    )  # of each slice
    n = ends.shape[1]
    gaps = n * (np.flatnonzero(np.diff(line[first])) + 1)
    edges = time[sample][ends.ravel()], np.repeat(low, n), np.repeat(high, n)
    return tuple(np.insert(edge, gaps, np.nan) for edge in edges)  # type: ignore[return-value]


def isolated(values: Vector) -> list[int]:
    """Return the indices of finite values without a finite neighbour, which a line alone does not show."""
    return [run.start for run in true_runs(np.isfinite(values)) if run.stop - run.start == 1]
