"""TrajectoryDisplay: simulated flights, the band of their ensemble, and truth."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import EULER
from skdgp._flight.checks import check_columns
from skdgp.plotting._comparison import check_level
from skdgp.plotting._style import PALETTE, ROLES, axis_label, check_matplotlib, display_unit, legend_above, panels, tidy

SHOWN = ("airspeed", "altitude", "phi", "theta", "p", "q")
MOST_PATHS = 40
"""More paths than this would be a surface: so many of them are drawn."""


class TrajectoryDisplay:
    r"""Trajectories flown by :func:`skdgp.dynamics.simulate`: one, its deviations, or an ensemble.

    Of an ensemble the band holds a share of the paths at every time, and the line is their median; of one trajectory
    with ``return_std=True`` the band is mean and deviation. Marks on the upper edge show where a path was beyond what
    the model was learned from. Angles are drawn in degrees.

    Use :meth:`from_trajectories`. All parameters are kept as attributes.

    Parameters
    ----------
    time : (n,)
        [s].
    values : (n_paths, n, k)
        The states, SI units and radians; NaN where a path had ended.
    std : (n, k), optional
        Standard deviations, of one path.
    truth : (n, k), optional
        What truly happened.
    beyond : (n,), optional
        Share of the paths that were beyond what was learned from.
    names : k names
        Columns of a flight table.

    Attributes
    ----------
    axes_ : ndarray of Axes
    figure_ : Figure
    lines_, bands_, paths_, truth_ : lists of artists
        One per panel; None where there was nothing to draw. ``paths_`` holds a list for each panel.
    beyond_ : list of artists
        The marks.

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

    def __init__(self, *, time, values, std=None, truth=None, beyond=None, names=SHOWN):
        self.time = time
        self.values = values
        self.std = std
        self.truth = truth
        self.beyond = beyond
        self.names = names

    def plot(self, ax=None, *, level=0.95, n_columns=2, show_paths=False, legend=True):
        """Draw the panels.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure.
        level : float, default=0.95
            Share of the paths, or probability, of the band.
        n_columns : int, default=2
            Panels side by side.
        show_paths : bool, default=False
            Whether to draw paths, at most 40, beside their band.
        legend : bool, default=True
            Whether to write what is what above the first panel.

        Returns
        -------
        TrajectoryDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        level = check_level(level)
        n_rows = -(-len(self.names) // n_columns)
        axes = panels(ax, n_rows, n_columns, figsize=(5 * n_columns, 1 + 1.7 * n_rows), sharex=True)
        for spare in axes.flat[len(self.names) :]:
            spare.set_axis_off()
        drawn = [self._draw_panel(one, k, level, show_paths) for k, one in enumerate(axes.flat[: len(self.names)])]
        for one in axes[-1]:
            one.set_xlabel("time [s]")
        self.lines_, self.bands_, self.paths_, self.truth_, self.beyond_ = (
            list(kind) for kind in zip(*drawn, strict=True)
        )
        self.axes_, self.figure_ = axes, axes.flat[0].figure
        if legend:
            axes.flat[0].set_title(" ")  # room for the legend, which is wider than the panel
            legend_above(axes.flat[0])
            axes.flat[0].get_legend().set_in_layout(False)
        return self

    def _draw_panel(self, ax, k, level, show_paths):
        name = self.names[k]
        factor = display_unit(name)[0]
        values = factor * self.values[:, :, k]
        low, middle, high = _band(values, None if self.std is None else factor * self.std[:, k], level)
        band, paths, truth = None, [], None
        if low is not None:
            label = f"{100 * level:.4g} % of the paths" if self.std is None else f"{100 * level:.4g} % band"
            band = ax.fill_between(self.time, low, high, color=ROLES["band"], alpha=0.45, linewidth=0, label=label)
        if show_paths:
            for path in values[:: -(-len(values) // MOST_PATHS)]:
                paths += ax.plot(self.time, path, color=PALETTE["blue"], linewidth=0.4, alpha=0.4)
        line = ax.plot(self.time, middle, color=ROLES["mean"], linewidth=1.2, label="simulated")[0]
        if self.truth is not None:
            truth = ax.plot(
                self.time, factor * self.truth[:, k], "--", color=ROLES["truth"], linewidth=1.2, label="flown"
            )[0]
        ax.set_ylabel(axis_label(name))
        tidy(ax)
        return line, band, paths, truth, self._mark_beyond(ax)

    def _mark_beyond(self, ax):
        if self.beyond is None or not (self.beyond > 0).any():
            return None
        shown = np.where(self.beyond > 0, 1.0, np.nan)
        transform, color = ax.get_xaxis_transform(), PALETTE["orange"]
        label = "beyond what was learned from"
        return ax.plot(self.time, shown, color=color, linewidth=4, transform=transform, clip_on=False, label=label)[0]

    @classmethod
    def from_trajectories(cls, trajectories, truth=None, *, start=None, columns=SHOWN, ax=None, **plot_options):
        """Draw what :func:`skdgp.dynamics.simulate` returned.

        Parameters
        ----------
        trajectories : DataFrame
            One trajectory, or the paths of one start (column ``path``).
        truth : DataFrame, optional
            The flight as it was, with the same columns; interpolated to the times of the simulation.
        start : optional
            Which start, where there are several; by default the first.
        columns : names
            What to draw.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        TrajectoryDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If columns are missing, or the start is not there.
        """
        check_matplotlib(f"{cls.__name__}.from_trajectories")
        names = list(columns)
        check_columns(trajectories, ["time", *names], what="trajectory")
        if "start" in trajectories:
            there = trajectories["start"].unique()
            start = there[0] if start is None else start
            if start not in there:
                raise ValueError(f"Got start={start!r}, but the trajectories are of {there.tolist()}.")
            trajectories = trajectories[trajectories["start"] == start]
        n_paths = trajectories["path"].nunique() if "path" in trajectories else 1
        time = trajectories["time"].to_numpy(float).reshape(n_paths, -1)[0]
        values = trajectories[names].to_numpy(float).reshape(n_paths, len(time), len(names))
        bands = [f"{name}_std" for name in names]
        beyond = (trajectories["beyond"] != "").to_numpy() if "beyond" in trajectories else None
        display = cls(
            time=time,
            values=_unwrapped(values, names),
            std=trajectories[bands].to_numpy(float) if n_paths == 1 and set(bands) <= set(trajectories) else None,
            truth=None if truth is None else _truth(truth, time, names),
            beyond=None if beyond is None else beyond.reshape(n_paths, -1).mean(axis=0),
            names=tuple(names),
        )
        if display.truth is not None:
            display.truth = _nearest_turn(display.truth, display.values[0], names)
        return display.plot(ax, **plot_options)


def _band(values, std, level):
    """Return the lower edge, the line and the upper edge; no edges of one path without deviations."""
    if std is not None:
        from scipy.special import ndtri

        reach = ndtri(0.5 + 0.5 * level) * std
        return values[0] - reach, values[0], values[0] + reach
    if len(values) == 1:
        return None, values[0], None
    found = np.full((3, values.shape[1]), np.nan)
    some = np.isfinite(values).any(axis=0)
    found[:, some] = np.nanquantile(values[:, some], [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level], axis=0)
    return tuple(found)


def _unwrapped(values, names):
    """Return values whose angles do not jump by a turn, path by path, all from the first one's turn."""
    values = values.copy()
    for k, name in enumerate(names):
        if name in EULER:
            first = values[0, 0, k]
            values[:, :, k] = first + np.unwrap(np.angle(np.exp(1j * (values[:, :, k] - first))), axis=1)
    return values


def _truth(truth, time, names):
    check_columns(truth, ["time", *names], what="truth")
    clock = truth["time"].to_numpy(float)
    columns = [np.unwrap(truth[n].to_numpy(float)) if n in EULER else truth[n].to_numpy(float) for n in names]
    return np.stack([np.interp(time, clock, c, left=np.nan, right=np.nan) for c in columns], axis=-1)


def _nearest_turn(truth, values, names):
    for k, name in enumerate(names):
        if name in EULER:
            truth[:, k] += 2 * np.pi * np.round(np.nanmedian(values[:1, k] - truth[:1, k]) / (2 * np.pi))
    return truth
