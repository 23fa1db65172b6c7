"""FlightDisplay and TrajectoryDisplay: flights as they were flown, and as they are simulated with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.statistics import half_width, path_quantiles
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._display.flights import ground_path, named_flights, start_marker
from skdgp._display.style import (
    CYCLE,
    PALETTE,
    ROLES,
    axis_label,
    check_matplotlib,
    display_unit,
    legend_above,
    plain,
    tidy,
)
from skdgp._flight.channels import ELEVONS, EULER, SURFACES
from skdgp._flight.checks import check_choice, check_columns
from skdgp._flight.frames import unwrapped_paths
from skdgp.plotting._display import Display, Names, choose, line_points, panels

INPUTS = ("throttle", *SURFACES)
DEFAULT_COLUMNS = ("airspeed", "altitude", "phi", "theta", "p", "q")


@dataclass(kw_only=True, eq=False, repr=False)
class FlightDisplay(Display):
    """Inputs against time (the paper's figure 4) or the path over the ground (its figure 5).

    Panels are inputs by rows and flights by columns. The artists are ``lines_``, flight by flight,
    and of paths ``starts_``, the first points.

    Parameters
    ----------
    flights : dict of name to DataFrame
        Flight tables in SI units, at least with ``time``.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import FlightDisplay
    >>> t = np.arange(0.0, 60.0, 0.1)
    >>> flight = pd.DataFrame({"time": t, "rudder": 0.1 * np.sin(t), "v_north": 40.0, "v_east": 10 * np.sin(t / 9)})
    >>> display = FlightDisplay.from_flights({"train": flight}, ax=Figure())
    >>> display.axes_[0, 0].get_ylabel()
    'rudder [deg]'
    """

    flights: dict[str, pd.DataFrame]

    def plot(self, ax: Any = None, *, kind: str = "inputs", **options: Any) -> Self:
        """Draw the inputs or the path (``kind="path"``); options as in :meth:`plot_inputs` or :meth:`plot_path`."""
        check_choice("kind", kind, ("inputs", "path"))
        return (
            self.plot_inputs(ax, **options) if kind == "inputs" else self.plot_path(ax, **options)
        )

    def plot_inputs(self, ax: Any = None, *, n_bins: int = 2000, channels: Names = None) -> Self:
        """Draw the inputs against time, one row per input and one column per flight; see :mod:`skdgp.plotting`.

        ``channels`` are by default throttle, elevator, aileron and rudder, those that some flight
        has, or the elevons where no flight has an elevator.
        """
        names = list(self.flights)
        channels = self.inputs if channels is None else list(np.atleast_1d(channels))

        def draw(ax, key):
            name, channel = key
            if name == names[0]:
                ax.set_ylabel(axis_label(channel))
            if channel == channels[0]:
                ax.set_title(plain(name), fontsize="medium", loc="left")
            table = self.flights[name]
            if channel not in table.columns:
                style = {"ha": "center", "va": "center", "fontsize": "small"}
                ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, **style)
                return (None,)
            values = display_unit(channel)[0] * table[channel].to_numpy(dtype=float)
            points = line_points(table["time"].to_numpy(dtype=float), values, n_bins=n_bins)
            color = CYCLE[names.index(name) % len(CYCLE)]
            return ax.plot(*points, color=color, linewidth=0.9, label=plain(name))

        keys = [(name, channel) for name in names for channel in channels]
        options = {"xlabel": "time [s]", "by_column": True, "sharex": "col", "sharey": "row"}
        size = (4 + 2 / len(names), 1.3)
        (self.lines_,) = self._draw_panels(ax, draw, keys, len(names), size, **options)
        return self

    def plot_path(self, ax: Any = None, *, legend: bool = True) -> Self:
        """Draw the path over the ground, north up, both axes to one scale; see :mod:`skdgp.plotting`.

        Positions are the columns ``north`` and ``east``, else integrals of ``v_north`` and
        ``v_east``. A hollow marker shows where a flight begins.
        """
        self.axes_ = panels(ax, 1, 1, figsize=(6.0, 5.4))
        ax = self.axes_[0, 0]
        self.figure_ = ax.figure
        self.lines_ = []
        self.starts_ = []
        for k, (name, table) in enumerate(self.flights.items()):
            path = ground_path(table, name)
            color = CYCLE[k % len(CYCLE)]
            style = {"color": color, "linewidth": 1.2, "label": plain(name)}
            self.lines_ += ax.plot(path["east"], path["north"], **style)
            # Hollow and smaller one after another, so that two at one point are both visible.
            style = {"marker": start_marker(k), "markerfacecolor": "none", "linestyle": "none"}
            style |= {"color": color, "markersize": max(5, 13 - 4 * k), "markeredgewidth": 1.6}
            first = path.iloc[:1]
            self.starts_ += ax.plot(first["east"], first["north"], zorder=3, **style)
        tidy(ax)
        ax.margins(0.05)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel=axis_label("east"), ylabel=axis_label("north"))
        if legend:
            legend_above(ax)
        return self

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs that some flight has."""
        columns = set().union(*(table.columns for table in self.flights.values()))
        wanted = INPUTS if "elevator" in columns else ("throttle", *ELEVONS, "rudder")
        found = [name for name in wanted if name in columns]
        if not found:
            raise ValueError(
                f"Got flights without any of {[*INPUTS, *ELEVONS]}: name the columns as "
                f"channels=..."
            )
        return found

    @classmethod
    def from_flights(
        cls, flights: pd.DataFrame | Mapping[str, pd.DataFrame], **plot_options: Any
    ) -> Self:
        """Draw one flight table, divided by its column ``flight``, or several by name; options of :meth:`plot`."""
        return cls(flights=named_flights(flights)).plot(**plot_options)


@dataclass(kw_only=True, eq=False, repr=False)
class TrajectoryDisplay(Display):
    r"""Trajectories of :func:`skdgp.dynamics.simulate`: one with standard deviations, or an ensemble.

    Of an ensemble the band holds the central share of the paths at each time, and the line is the
    trajectory ``mean`` where it is given, else the median of the paths, which no aircraft flies. Of
    one trajectory with ``return_std=True`` the band is that of a normal distribution.

    The artists are ``lines_``, ``bands_``, ``truth_`` and ``beyond_``, marks on the upper edge
    where a path leaves the range of the training data.

    Parameters
    ----------
    time, values, names : (n,), (n_paths, n, k), k names
        Time [s]; states, columns of a flight table in SI units and radians, NaN after the end of a
        path.
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

    def plot(
        self, ax: Any = None, *, level: float = 0.95, legend: bool = True, columns: Names = None
    ) -> Self:
        """Draw the panels of some ``columns``, default all.

        See :mod:`skdgp.plotting`; of an ensemble, ``level`` is the fraction of paths in the band.
        """
        z = half_width(level)
        keys = choose(self.names, columns)

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
                band = ax.fill_between(
                    self.time, low, high, color=ROLES["band"], alpha=0.45, linewidth=0, label=held
                )
            (line,) = ax.plot(self.time, middle, color=ROLES["mean"], linewidth=1.2, label=label)
            if self.truth is not None:
                style = {"color": ROLES["truth"], "linewidth": 1.2, "label": "flown"}
                (truth,) = ax.plot(self.time, factor * self.truth[:, k], "--", **style)
            ax.set_ylabel(axis_label(self.names[k]))
            return line, band, truth, self._mark_beyond(ax)

        options = {"xlabel": "time [s]", "legend": legend, "sharex": True}
        artists = self._draw_panels(ax, draw, keys, min(2, len(keys)), (5, 1.7), **options)
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
        style = {
            "color": PALETTE["orange"],
            "linewidth": 4,
            "transform": ax.get_xaxis_transform(),
            "clip_on": False,
        }
        return ax.plot(self.time, marks, label="outside the training data", **style)[0]

    @classmethod
    def from_trajectories(
        cls, trajectories: pd.DataFrame, truth: pd.DataFrame | None = None, *, mean: pd.DataFrame | None = None,
        start: Any = None, columns: Any = DEFAULT_COLUMNS, **plot_options: Any,
    ) -> Self:  # fmt: skip
        """Draw the result of :func:`skdgp.dynamics.simulate` with the options of :meth:`plot`; see :meth:`compute`."""
        check_matplotlib(cls.__name__)
        found = cls.compute(trajectories, truth, mean=mean, start=start, columns=columns)
        return found.plot(**plot_options)

    @classmethod
    def compute(
        cls, trajectories: pd.DataFrame, truth: pd.DataFrame | None = None, *, mean: pd.DataFrame | None = None,
        start: Any = None, columns: Any = DEFAULT_COLUMNS,
    ) -> Self:  # fmt: skip
        """Take what is drawn of the result of :func:`skdgp.dynamics.simulate`, without drawing it.

        ``trajectories`` is one trajectory, or the paths of one start (column ``path``); ``start``
        is the one to draw, by default the first. ``truth`` is the recorded flight, interpolated to
        the times of the simulation. ``mean``, beside paths, is the trajectory that the mean of the
        model flies, the line.
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
        values = (
            trajectories[names].to_numpy(float, copy=True).reshape(n_paths, len(time), len(names))
        )
        if mean is not None:
            check_columns(mean, names, what="mean")
            if len(mean) != len(time):
                raise ValueError(
                    f"Got a mean of {len(mean)} rows, but expected the {len(time)} of each path."
                )
            values = np.concatenate([mean[names].to_numpy(float)[None], values])
        for k in (k for k, name in enumerate(names) if name in EULER):
            values[:, :, k] = unwrapped_paths(values[:, :, k])
        bands = [f"{name}_std" for name in names]
        beyond = (trajectories["beyond"] != "").to_numpy() if "beyond" in trajectories else None
        return cls(
            time=time,
            values=values if mean is None else values[1:],
            mean=None if mean is None else values[0],
            std=trajectories[bands].to_numpy(float)
            if n_paths == 1 and set(bands) <= set(trajectories)
            else None,
            truth=None if truth is None else _interpolated(truth, time, names, values[0, 0]),
            beyond=None if beyond is None else beyond.reshape(n_paths, -1).mean(axis=0),
            names=tuple(names),
        )


def _interpolated(truth: pd.DataFrame, time: Vector, names: list[str], start: Vector) -> Matrix:
    """Return truth at times, its angles without jumps, within half a turn of the simulated ones at the start."""
    check_columns(truth, ["time", *names], what="truth")
    clock, columns = truth["time"].to_numpy(float), []
    for name, first in zip(names, start, strict=True):
        column = truth[name].to_numpy(float)
        column = np.interp(
            time, clock, np.unwrap(column) if name in EULER else column, left=np.nan, right=np.nan
        )
        turns = np.round((first - column[0]) / (2 * np.pi)) if name in EULER else 0.0
        columns.append(column + 2 * np.pi * turns)
    return np.stack(columns, axis=-1)
