"""Base of the displays: panels, their artists, and the checks of what is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from skdgp._compute.predicting import predict_with_noise
from skdgp._compute.typing import ArrayLike, Matrix
from skdgp._display.style import check_matplotlib, legend_above

Names: TypeAlias = "str | Sequence[str] | None"


class Display:
    """Base of displays: draws panels and keeps their axes."""

    axes_: np.ndarray
    figure_: Any

    def _draw_panels(
        self, ax, draw, keys, n_cols, figsize, *, xlabel=None, by_column=False, legend=False, **subplots
    ) -> list[list]:
        """Draw a panel per key with ``draw(axes, key)``, and return the artists: a list over panels of each kind.

        ``figsize`` is that of one panel [inch]; ``by_column`` fills the panels column by column.
        """
        n_rows = -(-len(keys) // n_cols)
        figsize = (n_cols * figsize[0], 1 + n_rows * figsize[1])
        self.axes_ = panels(ax, n_rows, n_cols, figsize=figsize, **subplots)
        self.figure_ = self.axes_.flat[0].figure
        cells = list(self.axes_.T.flat if by_column else self.axes_.flat)
        artists = [draw(one, key) for one, key in zip(cells, keys, strict=False)]
        for unused in cells[len(keys) :]:
            unused.set_visible(False)
        if xlabel is not None:
            for bottom in self.axes_[-1]:
                bottom.set_xlabel(xlabel)
        if legend:
            legend_above(self.axes_.flat[0])
        return [list(kind) for kind in zip(*artists, strict=True)]


def panels(ax: Any, n_rows: int, n_cols: int, *, figsize: tuple[float, float], **subplots: Any) -> np.ndarray:
    """Return an ``(n_rows, n_cols)`` array of axes.

    ``ax`` is None (a new pyplot figure), a Figure or SubFigure (filled), an array of as many axes as panels,
    or one Axes, which is divided when there are several panels.
    """
    check_matplotlib("skdgp.plotting")
    from matplotlib.axes import Axes

    shape = (n_rows, n_cols)
    if ax is None:
        import matplotlib.pyplot as plt

        return plt.subplots(*shape, figsize=figsize, layout="constrained", squeeze=False, **subplots)[1]
    if hasattr(ax, "subplots"):
        return ax.subplots(*shape, squeeze=False, **subplots)
    if isinstance(ax, Axes) and shape != (1, 1):
        ax.set_axis_off()
        if (spec := ax.get_subplotspec()) is None:
            raise ValueError(
                f"Got one free-standing Axes for {n_rows} x {n_cols} panels, but expected one made by subplots, "
                "which can be divided: give a Figure instead."
            )
        return spec.subgridspec(*shape).subplots(squeeze=False, **subplots)
    given = np.asarray(ax, dtype=object)
    if given.size != n_rows * n_cols or not all(isinstance(one, Axes) for one in given.flat):
        raise ValueError(
            f"Got {given.size} axes, but expected {n_rows * n_cols} (or one Axes, a Figure, or None): "
            f"use fig, axes = plt.subplots({n_rows}, {n_cols})."
        )
    return given.reshape(shape)


def as_columns(values: ArrayLike, what: str, shape: tuple[int, ...] | None = None) -> Matrix:
    """Return ``values`` as floats ``(n, P)``, NaN allowed; a vector is one column."""
    values = np.asarray(values, dtype=float)
    values = values[:, np.newaxis] if values.ndim == 1 else values
    if values.ndim != 2:
        raise ValueError(f"Got {what} of shape {values.shape}, but expected (n_samples, n_outputs).")
    if shape is not None and values.shape != shape:
        raise ValueError(
            f"Got {what} of shape {values.shape}, but expected {shape}, like the values it is compared with."
        )
    return values


def check_std(std: Any, shape: tuple[int, ...]) -> Any:
    """Return standard deviations ``(n, P)``, none negative; None for None."""
    if std is None:
        return None
    std = as_columns(std, "std", shape)
    if np.any(std < 0):
        raise ValueError(f"Got standard deviations down to {np.nanmin(std):.3g}, but expected none below 0.")
    return std


def names_of(values: object, n_outputs: int, given: Any = None, default: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the outputs' names: given, else the DataFrame's columns, else ``default``, else y0, y1, ..."""
    if given is None:
        columns = getattr(values, "columns", None)
        given = default if columns is None and len(default) == n_outputs else columns
    names = [f"y{i}" for i in range(n_outputs)] if given is None else [str(name) for name in given]
    if len(names) != n_outputs or len(set(names)) != n_outputs:
        raise ValueError(f"Got the names {names} for {n_outputs} outputs: give each output one name of its own.")
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
    moments = predict_with_noise(estimator, X) if include_noise else estimator.predict(X, return_std=True)
    return *moments, names
