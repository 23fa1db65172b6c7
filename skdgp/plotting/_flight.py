"""FlightDisplay: inputs against time, and the path over the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._display.flights import ground_path, named_flights, start_marker
from skdgp._display.style import CYCLE, PALETTE, axis_label, display_unit, legend_above, plain, scale_beside, tidy
from skdgp._flight.channels import ELEVONS, SURFACES
from skdgp._flight.checks import check_choice
from skdgp.plotting._display import Display, Names, choose, panels
from skdgp.plotting._lines import line_points

INPUTS = ("throttle", *SURFACES)
COLOR_STEPS = 32


@dataclass(kw_only=True, eq=False, repr=False)
class FlightDisplay(Display):
    """Inputs against time (the paper's figure 4) or the path over the ground (its figure 5).

    Parameters
    ----------
    flights : dict of name to DataFrame
        Flight tables in SI units, at least with ``time``.

    Attributes
    ----------
    axes_, figure_ : ndarray of Axes, Figure
        The panels, inputs by rows and flights by columns, or the one with the path; and their figure.
    lines_ : list of artists
        The lines, panel by panel; for a path one per flight.
    starts_ : list of Line2D
        The first point of each path.
    colorbar_ : Colorbar or None
        The scale of altitude or time along a path.

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
    >>> path = FlightDisplay.from_flights({"train": flight}, kind="path", ax=Figure())
    >>> path.axes_[0, 0].get_xlabel()
    'east [m]'
    """

    flights: dict[str, pd.DataFrame]

    def plot(self, ax: Any = None, *, kind: str = "inputs", **options: Any) -> Self:
        """Draw the inputs or the path (``kind="path"``); options as in :meth:`plot_inputs` or :meth:`plot_path`."""
        check_choice("kind", kind, ("inputs", "path"))
        return self.plot_inputs(ax, **options) if kind == "inputs" else self.plot_path(ax, **options)

    def plot_inputs(
        self, ax: Any = None, *, n_bins: int = 2000, channels: Names = None, flights: Names = None, titles: bool = True
    ) -> Self:
        """Draw the inputs against time, one row per input and one column per flight.

        Parameters
        ----------
        ax, n_bins
            See :mod:`skdgp.plotting`.
        channels : names, optional
            Columns to draw; default: throttle, elevator, aileron, rudder, those that some flight has (the
            elevons where no flight has an elevator).
        flights : names, optional
            Flights to draw, default all.
        titles : bool, default=True
            Whether to write each flight's name above its column.
        """
        names = self._names(flights)
        channels = self.inputs if channels is None else [channels] if isinstance(channels, str) else list(channels)
        size = (2 + 4 * len(names), 1 + 1.3 * len(channels))
        axes = panels(ax, len(channels), len(names), figsize=size, sharex="col", sharey="row")
        self.lines_ = []
        for column, name in zip(axes.T, names, strict=True):
            for one, channel in zip(column, channels, strict=True):
                self.lines_.append(self._draw_input(one, name, channel, n_bins))
            column[-1].set_xlabel("time [s]")
            if titles:
                column[0].set_title(plain(name), fontsize="medium", loc="left")
        for row, channel in zip(axes, channels, strict=True):
            row[0].set_ylabel(axis_label(channel))
        self.axes_, self.figure_, self.colorbar_ = axes, axes.flat[0].figure, None
        return self

    def plot_path(
        self, ax: Any = None, *, legend: bool = True, color_by: str | None = None, flights: Names = None
    ) -> Self:
        """Draw the path over the ground, north up, both axes to one scale.

        Positions are the columns ``north`` and ``east``. Without these, ``v_north`` and ``v_east`` are integrated
        from the origin by trapezoids.

        Parameters
        ----------
        ax, legend
            See :mod:`skdgp.plotting`.
        color_by : {"flight", "altitude", "time"}, optional
            Quantity of the colour; default: the flight when there are several, else the altitude or the time.
        flights : names, optional
            Flights to draw, default all.
        """
        names = self._names(flights)
        color_by = self._check_color(color_by, names)
        paths = {name: ground_path(self.flights[name], name) for name in names}
        ax = panels(ax, 1, 1, figsize=(6.0, 5.4))[0, 0]
        draw = _draw_plain if color_by == "flight" else _draw_coloured
        self.lines_, scale = draw(ax, paths, color_by)
        self.starts_ = [_draw_start(ax, path, name, k) for k, (name, path) in enumerate(paths.items())]
        tidy(ax)
        ax.margins(0.05)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel=axis_label("east"), ylabel=axis_label("north"))
        self.colorbar_ = None if scale is None else scale_beside(ax, scale, axis_label(color_by))
        if legend:
            legend_above(ax, self.lines_ if color_by == "flight" else self.starts_)
        self.axes_, self.figure_ = np.array([[ax]]), ax.figure
        return self

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs that some flight has."""
        columns = set().union(*(table.columns for table in self.flights.values()))
        wanted = INPUTS if "elevator" in columns else ("throttle", *ELEVONS, "rudder")
        found = [name for name in wanted if name in columns]
        if not found:
            raise ValueError(f"Got flights without any of {[*INPUTS, *ELEVONS]}: name the columns as channels=...")
        return found

    def _names(self, flights) -> list[str]:
        names = tuple(self.flights)
        return [names[k] for k in choose(names, flights)]

    def _draw_input(self, ax, name, channel, n_bins):
        table = self.flights[name]
        tidy(ax)
        if channel not in table.columns:
            ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", fontsize="small")
            return None
        values = display_unit(channel)[0] * table[channel].to_numpy(dtype=float)
        points = line_points(table["time"].to_numpy(dtype=float), values, n_bins=n_bins)
        color = CYCLE[list(self.flights).index(name) % len(CYCLE)]
        return ax.plot(*points, color=color, linewidth=0.9, label=plain(name))[0]

    def _check_color(self, color_by, names) -> str:
        altitude = all("altitude" in self.flights[name].columns for name in names)
        if color_by is None:
            return "flight" if len(names) > 1 else "altitude" if altitude else "time"
        check_choice("color_by", color_by, ("flight", "altitude", "time"))
        if color_by == "altitude" and not altitude:
            raise ValueError("Got color_by='altitude' for a flight without that column: use 'flight' or 'time'.")
        return color_by

    @classmethod
    def from_flights(cls, flights: pd.DataFrame | Mapping[str, pd.DataFrame], **plot_options: Any) -> Self:
        """Draw one flight table, divided by its column ``flight``, or several by name; options of :meth:`plot`."""
        return cls(flights=named_flights(flights)).plot(**plot_options)


def _draw_plain(ax, paths, color_by):
    lines = []
    for k, (name, path) in enumerate(paths.items()):
        color = CYCLE[k % len(CYCLE)]
        lines += ax.plot(path["east"], path["north"], color=color, linewidth=1.2, label=plain(name))
    return lines, None


def _draw_coloured(ax, paths, color_by):
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    values = np.concatenate([path[color_by].to_numpy() for path in paths.values()])
    low, high = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else (0.0, 1.0)
    cmap = colormaps["viridis"].resampled(COLOR_STEPS)
    lines = []
    for name, path in paths.items():
        # The grey edge keeps the dark end of the scale visible on dark pages, and the bright end on white ones.
        ax.plot(path["east"], path["north"], color=PALETTE["grey"], linewidth=2.8, zorder=1.9)
        pieces, shades = _pieces(path, path[color_by].to_numpy(), low, high)
        line = LineCollection(pieces, array=shades, cmap=cmap, linewidths=1.6, capstyle="round", label=plain(name))
        line.set_clim(low, high)
        lines.append(ax.add_collection(line))
    ax.autoscale_view()
    return lines, lines[0]


def _pieces(path, values, low, high):
    """Return the path in pieces of one shade each, which share their end points, and the shades' values."""
    step = (high - low) / COLOR_STEPS or 1.0
    middle = 0.5 * (values[:-1] + values[1:])
    shade = np.clip(np.floor((middle - low) / step), 0, COLOR_STEPS - 1)
    change = np.flatnonzero(np.diff(shade)) + 1
    points = path[["east", "north"]].to_numpy()
    edges = [0, *change, max(len(points) - 1, 0)]
    pieces = [points[a : b + 1] for a, b in pairwise(edges)]
    return pieces, low + (shade[edges[:-1]] + 0.5) * step if shade.size else np.full(len(pieces), low)


def _draw_start(ax, path, name, k):
    """Mark the first point of a flight; sizes differ, so that two markers at one point are both visible."""
    first, size = path.iloc[:1], max(5, 12 - 5 * k)
    style = {"marker": start_marker(k), "markersize": size, "markeredgecolor": "white", "linestyle": "none"}
    label = plain(f"{name}: start")
    return ax.plot(first["east"], first["north"], color=CYCLE[k % len(CYCLE)], zorder=3, label=label, **style)[0]
