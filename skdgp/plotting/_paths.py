"""PathDisplay: flights over the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

from skdgp._display.style import CYCLE, MARKERS, axis_label, plain
from skdgp._flight.checks import check_columns
from skdgp.plotting._display import Display

PATH_POINTS = 600  # of one flight; a picture resolves no more


@dataclass(kw_only=True, eq=False, repr=False)
class PathDisplay(Display):
    """Paths over the ground, north up, both axes to one scale (the paper's figure 5).

    Positions are the columns ``north`` and ``east``, else integrals of ``v_north`` and ``v_east``.
    A hollow marker shows where a flight begins.

    Parameters
    ----------
    paths : dict of name to DataFrame
        ``north`` and ``east`` [m] of each flight.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import PathDisplay
    >>> t = np.arange(0.0, 60.0, 0.1)
    >>> flight = pd.DataFrame({"time": t, "v_north": 40.0, "v_east": 10 * np.sin(t / 9)})
    >>> PathDisplay.from_flights({"train": flight}, ax=Figure()).axes_[0, 0].get_ylabel()
    'north [m]'
    """

    paths: dict[str, pd.DataFrame]
    keys = ("path",)
    size = (4.6, 4.0)

    def words(self, key: str) -> str:
        """Return the description of the panel."""
        return "path over the ground, coloured by flight"

    def draw(self, ax: Any, key: str) -> None:
        """Draw the paths of all flights."""
        for k, (name, path) in enumerate(self.paths.items()):
            color = CYCLE[k % len(CYCLE)]
            ax.plot(path["east"], path["north"], color=color, linewidth=1.2, label=plain(name))
            # Hollow and smaller one after another, so that two at one point are both visible.
            ax.plot(
                path["east"].iloc[0],
                path["north"].iloc[0],
                marker=MARKERS[k % len(MARKERS)],
                markersize=max(5, 13 - 4 * k),
                markerfacecolor="none",
                markeredgewidth=1.6,
                color=color,
                zorder=3,
            )
        ax.margins(0.05)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel=axis_label("east"), ylabel=axis_label("north"))

    @classmethod
    def from_flights(cls, flights: Mapping[str, pd.DataFrame], *, ax: Any = None) -> Self:
        """Draw flight tables by name."""
        paths = {str(name): _ground_path(table, name) for name, table in flights.items()}
        return cls(paths=paths).plot(ax)


def _ground_path(flight: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return north and east [m] at no more than 600 points, equally far apart.

    Without positions, velocities are integrated: north = int v_north dt, by trapezoids, linear
    across holes of the log.
    """
    if {"north", "east"} <= set(flight.columns):
        points = flight[["north", "east"]].astype(float)
    else:
        check_columns(flight, ["v_north", "v_east"], what=f"flight {name!r} (for its path)")
        velocity = flight[["v_north", "v_east"]].astype(float).interpolate(limit_direction="both")
        integral = cumulative_trapezoid(velocity, flight["time"], axis=0, initial=0)
        points = pd.DataFrame(integral, columns=["north", "east"])
    distance = np.nan_to_num(np.hypot(*points.diff().to_numpy().T)).cumsum()
    rows = np.searchsorted(distance, np.linspace(0, distance[-1], PATH_POINTS))
    return points.iloc[np.unique(rows.clip(0, len(distance) - 1))]
