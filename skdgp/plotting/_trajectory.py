"""TrajectoryDisplay: simulated flights, the band of their ensemble, and truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.intervals import half_width
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._display.style import PALETTE, ROLES, axis_label, display_unit
from skdgp._flight.channels import EULER
from skdgp._flight.checks import check_columns
from skdgp._flight.frames import unwrapped_paths
from skdgp.dynamics._trajectory import path_quantiles
from skdgp.plotting._display import Display

DEFAULT_COLUMNS = ("airspeed", "altitude", "phi", "theta", "p", "q")


@dataclass(kw_only=True, eq=False, repr=False)
class TrajectoryDisplay(Display):
    r"""Trajectories of :func:`skdgp.dynamics.simulate`: one with standard deviations, or an ensemble.

    Of an ensemble the band holds the central share of the paths at each time, and the line is the trajectory ``mean``
    where it is given, else the median of the paths, which no aircraft flies. Of one trajectory with ``return_std=True``
    the band is that of a normal distribution.

    The artists are ``lines_``, ``bands_``, ``truth_`` and ``beyond_``, marks on the upper edge where a path leaves the
    range of the training data.

    Parameters
    ----------
    time, values, names : (n,), (n_paths, n, k), k names
        Time [s]; states, columns of a flight table in SI units and radians, NaN after the end of a path.
    std : (n, k), optional
        Standard deviations, of one path.
    mean, truth : (n, k), optional
        The trajectory of the model's mean, beside an ensemble; the true states.
    beyond : (n,), optional
        Share of the paths outside the range of the training data.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import TrajectoryDisplay
    >>> t = np.arange(0, 5, 0.1)
    >>> paths = pd.concat([pd.DataFrame({"path": k, "time": t, "phi": 0.1 * k * np.sin(t), "airspeed": 20.0 + k})
    ...                    for k in range(5)])
    >>> display = TrajectoryDisplay.from_trajectories(paths, columns=["airspeed", "phi"], ax=Figure())
    >>> [ax.get_ylabel() for ax in display.axes_.flat]
    ['$V$ [m/s]', '$\\phi$ [deg]']
    """

    time: Vector
    values: Array
    names: Any = DEFAULT_COLUMNS
    std: Matrix | None = None
    mean: Matrix | None = None
    truth: Matrix | None = None
    beyond: Vector | None = None

    def plot(self, ax: Any = None, *, level: float = 0.95, legend: bool = True) -> Self:
        """Draw the panels. See :mod:`skdgp.plotting`; of an ensemble, ``level`` is the share of paths in the band."""
        z = half_width(level)

        def draw(ax, k):
            factor = display_unit(self.names[k])[0]
            values, label = factor * self.values[:, :, k], "simulated"
            low, middle, high = None, values[0], None  # no edges of one path without deviations
            if self.std is not None:
                half = z * factor * self.std[:, k]
                low, high = middle - half, middle + half
            elif len(values) > 1:
                low, middle, high = path_quantiles(values, level)
                label = "median of the paths"
            if self.mean is not None:
                middle, label = factor * self.mean[:, k], "simulated"
            band, truth = None, None
            if low is not None:
                held = f"{100 * level:.4g} % " + ("of the paths" if self.std is None else "band")
                band = ax.fill_between(self.time, low, high, color=ROLES["band"], alpha=0.45, linewidth=0, label=held)
            (line,) = ax.plot(self.time, middle, color=ROLES["mean"], linewidth=1.2, label=label)
            if self.truth is not None:
                style = {"color": ROLES["truth"], "linewidth": 1.2, "label": "flown"}
                (truth,) = ax.plot(self.time, factor * self.truth[:, k], "--", **style)
            ax.set_ylabel(axis_label(self.names[k]))
            return line, band, truth, self._mark_beyond(ax)

        options = {"xlabel": "time [s]", "legend": legend, "sharex": True}
        artists = self._draw_panels(ax, draw, range(len(self.names)), 2, (5, 1.7), **options)
        self.lines_, self.bands_, self.truth_, self.beyond_ = artists
        if legend:
            first = self.axes_.flat[0]
            first.set_title(" ")  # room for the legend, which is wider than the panel
            first.get_legend().set_in_layout(False)
        return self

    def _mark_beyond(self, ax):
        if self.beyond is None or not (self.beyond > 0).any():
            return None
        marks = np.where(self.beyond > 0, 1.0, np.nan)
        style = {"color": PALETTE["orange"], "linewidth": 4, "transform": ax.get_xaxis_transform(), "clip_on": False}
        return ax.plot(self.time, marks, label="outside the training data", **style)[0]

    @classmethod
    def from_trajectories(
        cls, trajectories: pd.DataFrame, truth: pd.DataFrame | None = None, *, mean: pd.DataFrame | None = None,
        start: Any = None, columns: Any = DEFAULT_COLUMNS, **plot_options: Any,
    ) -> Self:  # fmt: skip
        """Draw the result of :func:`skdgp.dynamics.simulate` with the options of :meth:`plot`.

        ``trajectories`` is one trajectory, or the paths of one start (column ``path``); ``start`` is the one to draw,
        by default the first. ``truth`` is the recorded flight, interpolated to the times of the simulation. ``mean``,
        beside paths, is the trajectory that the mean of the model flies, the line.
        """
        names = list(columns)
        check_columns(trajectories, ["time", *names], what="trajectory")
        if "start" in trajectories:
            starts = trajectories["start"].unique()
            start = starts[0] if start is None else start
            if start not in starts:
                raise ValueError(f"Got start={start!r}, but expected one of {starts.tolist()}.")
            trajectories = trajectories[trajectories["start"] == start]
        n_paths = trajectories["path"].nunique() if "path" in trajectories else 1
        time = trajectories["time"].to_numpy(float).reshape(n_paths, -1)[0]
        values = trajectories[names].to_numpy(float, copy=True).reshape(n_paths, len(time), len(names))
        if mean is not None:
            check_columns(mean, names, what="mean")
            if len(mean) != len(time):
                raise ValueError(f"Got a mean of {len(mean)} rows, but expected the {len(time)} of each path.")
            values = np.concatenate([mean[names].to_numpy(float)[None], values])
        for k in (k for k, name in enumerate(names) if name in EULER):
            values[:, :, k] = unwrapped_paths(values[:, :, k])
        bands = [f"{name}_std" for name in names]
        beyond = (trajectories["beyond"] != "").to_numpy() if "beyond" in trajectories else None
        return cls(
            time=time,
            values=values if mean is None else values[1:],
            mean=None if mean is None else values[0],
            std=trajectories[bands].to_numpy(float) if n_paths == 1 and set(bands) <= set(trajectories) else None,
            truth=None if truth is None else _interpolated(truth, time, names, values[0, 0]),
            beyond=None if beyond is None else beyond.reshape(n_paths, -1).mean(axis=0),
            names=tuple(names),
        ).plot(**plot_options)


def _interpolated(truth: pd.DataFrame, time: Vector, names: list[str], start: Vector) -> Matrix:
    """Return truth at times, its angles without jumps, within half a turn of the simulated ones at the start."""
    check_columns(truth, ["time", *names], what="truth")
    clock, columns = truth["time"].to_numpy(float), []
    for name, first in zip(names, start, strict=True):
        column = truth[name].to_numpy(float)
        column = np.interp(time, clock, np.unwrap(column) if name in EULER else column, left=np.nan, right=np.nan)
        turns = np.round((first - column[0]) / (2 * np.pi)) if name in EULER else 0.0
        columns.append(column + 2 * np.pi * turns)
    return np.stack(columns, axis=-1)
