"""FlightDisplay: inputs against time, and the path over the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._display.flights import ground_path, named_flights, start_marker
from skdgp._display.style import CYCLE, PALETTE, axis_label, display_unit, legend_above, plain, scale_beside, tidy
from skdgp._flight.channels import ELEVONS, SURFACES
from skdgp._flight.checks import check_choice
from skdgp.plotting._display import Display, Names, line_points, panels

INPUTS = ("throttle", *SURFACES)


@dataclass(kw_only=True, eq=False, repr=False)
class FlightDisplay(Display):
    """Inputs against time (the paper's figure 4) or the path over the ground (its figure 5).

    Panels are inputs by rows and flights by columns. The artists are ``lines_``, flight by flight, and of paths
    ``starts_``, the first points, and ``colorbar_``, the scale of altitude or time.

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
        return self.plot_inputs(ax, **options) if kind == "inputs" else self.plot_path(ax, **options)

    def plot_inputs(self, ax: Any = None, *, n_bins: int = 2000, channels: Names = None) -> Self:
        """Draw the inputs against time, one row per input and one column per flight; see :mod:`skdgp.plotting`.

        ``channels`` are by default throttle, elevator, aileron and rudder, those that some flight has, or the elevons
        where no flight has an elevator.
        """
        names = list(self.flights)
        channels = self.inputs if channels is None else [channels] if isinstance(channels, str) else list(channels)

        def draw(ax, key):
            name, channel = key
            if name == names[0]:
                ax.set_ylabel(axis_label(channel))
            if channel == channels[0]:
                ax.set_title(plain(name), fontsize="medium", loc="left")
            table = self.flights[name]
            if channel not in table.columns:
                ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", fontsize="small")
                return (None,)
            values = display_unit(channel)[0] * table[channel].to_numpy(dtype=float)
            points = line_points(table["time"].to_numpy(dtype=float), values, n_bins=n_bins)
            color = CYCLE[names.index(name) % len(CYCLE)]
            return ax.plot(*points, color=color, linewidth=0.9, label=plain(name))

        keys, size = [(name, channel) for name in names for channel in channels], (4 + 2 / len(names), 1.3)
        options = {"xlabel": "time [s]", "by_column": True, "sharex": "col", "sharey": "row"}
        (self.lines_,) = self._draw_panels(ax, draw, keys, len(names), size, **options)
        self.colorbar_ = None
        return self

    def plot_path(self, ax: Any = None, *, legend: bool = True, color_by: str | None = None) -> Self:
        """Draw the path over the ground, north up, both axes to one scale; see :mod:`skdgp.plotting`.

        Positions are the columns ``north`` and ``east``, else integrals of ``v_north`` and ``v_east``. The colour is
        that of "flight", "altitude" or "time"; by default of the flight when there are several, else of the altitude or
        the time.
        """
        altitude = all("altitude" in table for table in self.flights.values())
        if color_by is None:
            color_by = "flight" if len(self.flights) > 1 else "altitude" if altitude else "time"
        check_choice("color_by", color_by, ("flight", "altitude", "time"))
        if color_by == "altitude" and not altitude:
            raise ValueError("Got color_by='altitude' for a flight without that column: use 'flight' or 'time'.")
        paths = {name: ground_path(table, name) for name, table in self.flights.items()}
        self.axes_ = panels(ax, 1, 1, figsize=(6.0, 5.4))
        ax, self.colorbar_ = self.axes_[0, 0], None
        self.figure_ = ax.figure
        if color_by == "flight":
            self.lines_ = [
                ax.plot(path["east"], path["north"], color=CYCLE[k % len(CYCLE)], linewidth=1.2, label=plain(name))[0]
                for k, (name, path) in enumerate(paths.items())
            ]
        else:
            self.lines_ = _draw_coloured(ax, paths, color_by)
        self.starts_ = []
        for k, (name, path) in enumerate(paths.items()):
            style = {"marker": start_marker(k), "markeredgecolor": "white", "linestyle": "none", "zorder": 3}
            style["markersize"] = max(5, 12 - 5 * k)  # so that two markers at one point are both visible
            first, label = path.iloc[:1], plain(f"{name}: start")
            self.starts_ += ax.plot(first["east"], first["north"], color=CYCLE[k % len(CYCLE)], label=label, **style)
        tidy(ax)
        ax.margins(0.05)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel=axis_label("east"), ylabel=axis_label("north"))
        if color_by != "flight":
            self.colorbar_ = scale_beside(ax, self.lines_[0], axis_label(color_by))
        if legend:
            legend_above(ax, self.lines_ if color_by == "flight" else self.starts_)
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

    @classmethod
    def from_flights(cls, flights: pd.DataFrame | Mapping[str, pd.DataFrame], **plot_options: Any) -> Self:
        """Draw one flight table, divided by its column ``flight``, or several by name; options of :meth:`plot`."""
        return cls(flights=named_flights(flights)).plot(**plot_options)


def _draw_coloured(ax, paths, color_by):
    from matplotlib.collections import LineCollection

    values = np.concatenate([path[color_by].to_numpy() for path in paths.values()])
    low, high = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else (0.0, 1.0)
    lines = []
    for name, path in paths.items():
        # The grey edge keeps the dark end of the scale visible on dark pages, and the bright end on white ones.
        ax.plot(path["east"], path["north"], color=PALETTE["grey"], linewidth=2.8, zorder=1.9)
        points, along = path[["east", "north"]].to_numpy(), path[color_by].to_numpy()
        pieces, shades = list(np.stack([points[:-1], points[1:]], axis=1)), 0.5 * (along[:-1] + along[1:])
        line = LineCollection(pieces, array=shades, cmap="viridis", linewidths=1.6, capstyle="round", label=plain(name))
        line.set_clim(low, high)
        lines.append(ax.add_collection(line))
    ax.autoscale_view()
    return lines
