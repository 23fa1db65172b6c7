"""PathDisplay: flights over the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import pandas as pd

from skdgp._display.flights import ground_path
from skdgp._display.style import CYCLE, MARKERS, axis_label, plain
from skdgp.plotting._display import Display


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
        paths = {str(name): ground_path(table, name) for name, table in flights.items()}
        return cls(paths=paths).plot(ax)
