"""Base of the displays: panels, their artists, checks of what is drawn, and long records with few points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from skdgp._compute.predicting import predict_with_noise
from skdgp._compute.typing import ArrayLike, Indices, Matrix, Vector
from skdgp._display.style import check_matplotlib, legend_above, tidy

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

    ``ax`` is None (a new pyplot figure), a Figure or SubFigure (filled), one Axes for one panel, or
    an array of as many axes as panels.
    """
    check_matplotlib("skdgp.plotting")
    from matplotlib.axes import Axes

    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.figure(figsize=figsize, layout="constrained")
    if hasattr(ax, "subplots"):
        return ax.subplots(n_rows, n_cols, squeeze=False, **subplots)
    given = np.asarray(ax, dtype=object)
    if given.size != n_rows * n_cols or not all(isinstance(one, Axes) for one in given.flat):
        raise ValueError(
            f"Got {given.size} axes, but expected {n_rows * n_cols}: use fig, axes = "
            f"plt.subplots({n_rows}, {n_cols}), or give a Figure."
        )
    return given.reshape(n_rows, n_cols)


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


def _slices(time: Vector, n_bins: int, starts: Indices | None) -> Indices:
    """Return the number of each sample's slice of a record; it jumps by two where a line breaks."""
    new = np.zeros(len(time), dtype=int)
    new[:: max(1, len(time) // n_bins)] = 1
    new[segment_starts(time) if starts is None else starts] = 2
    return np.cumsum(new)


def line_points(
    time: Vector, values: Vector, *, n_bins: int, starts: Indices | None = None
) -> tuple[Vector, Vector]:
    """Return the lowest and the highest sample of each of ``n_bins`` slices, with NaN where the line breaks.

    It breaks at ``starts``, by default after gaps in time, and at slices without a finite value.

    >>> t = np.arange(10_000) / 100.0
    >>> v = np.sin(t); v[5000] = 7.0
    >>> few_t, few_v = line_points(t, v, n_bins=100)
    >>> len(few_t) < 210, float(few_v.max())
    (True, 7.0)
    """
    number = _slices(time, n_bins, starts)
    known = pd.Series(values)[np.isfinite(values)]
    slices = known.groupby(number[known.index])
    rows = np.unique(np.concatenate([slices.idxmin(), slices.idxmax()])).astype(int)
    gaps = np.flatnonzero(np.diff(number[rows]) > 1) + 1
    return np.insert(time[rows], gaps, np.nan), np.insert(values[rows], gaps, np.nan)


def band_points(
    time: Vector, lower: Vector, upper: Vector, *, n_bins: int, starts: Indices | None = None
) -> tuple[Vector, Vector, Vector]:
    """Return times, lower and upper edge of a band: in each slice the union of the samples' intervals."""
    number = _slices(time, n_bins, starts)
    band = pd.DataFrame({"time": time, "lower": lower, "upper": upper, "number": number})
    slices = band[np.isfinite(band).all(axis=1)].groupby("number")
    edges = pd.DataFrame({"lower": slices["lower"].min(), "upper": slices["upper"].max()})
    both = pd.concat(
        [edges.assign(time=slices["time"].first()), edges.assign(time=slices["time"].last())]
    )
    both = both.drop_duplicates().sort_index(kind="stable")
    gaps = np.flatnonzero(np.diff(both.index) > 1) + 1
    columns = (
        np.insert(both[name].to_numpy(float), gaps, np.nan) for name in ("time", "lower", "upper")
    )
    return tuple(columns)  # type: ignore[return-value]


def isolated(values: Vector) -> list[int]:
    """Return the indices of finite values without a finite neighbour, which a line alone does not show."""
    known = np.concatenate([[False], np.isfinite(values), [False]])
    return np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:]).tolist()
