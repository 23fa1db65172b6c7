"""StateDisplay: measured and replayed states against time."""

from __future__ import annotations

import numpy as np

from skdgp._flight.checks import check_columns
from skdgp.plotting._arrays import check_columns_of, check_std, check_time, choose, names_of
from skdgp.plotting._comparison import Comparison, check_level, draw_comparison
from skdgp.plotting._style import PALETTE, axis_label, check_matplotlib, display_unit, legend_above, panels, tidy

LATERAL_STATES = ("v_east", "p", "r")
"""The states of the paper's figure 7: east velocity, roll rate, yaw rate."""

MOST_MARKS = 150
"""More restarts than this would be a grey bar: they are not marked."""


class StateDisplay:
    """Measured states and those replayed from estimated coefficients (the paper's figure 7).

    A replay is restarted from the measured state every few seconds; lines break there, and small marks on the
    upper edge show where. States are given in SI units and drawn in degrees.

    Use :meth:`from_replay` or :meth:`from_predictions`. All parameters are kept as attributes.

    Parameters
    ----------
    time : (n,)
        Time of the samples [s].
    measured, replayed : (n, k)
        States, SI units and radians. Where every replay is one more time, the rows may repeat it.
    std : (n, k), optional
        Standard deviations of the replayed states.
    window : (n,), optional
        Which replay a row belongs to; it changes where the replay was restarted.
    state_names : k names, optional
        Columns of a flight table; default those of a DataFrame ``measured``, or v_east, p, r.

    Attributes
    ----------
    axes_ : ndarray of Axes
        The panels.
    figure_ : Figure
        The figure they are in.
    measured_, replayed_, bands_ : lists of artists
        One per panel drawn; None where there was nothing to draw.
    restarts_ : list of artists
        The marks of the restarts, one per panel (None without windows, or with too many).

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import StateDisplay
    >>> time = np.arange(0, 30, 0.1)
    >>> states = np.sin(time[:, None] * [0.3, 1.0, 0.7])
    >>> display = StateDisplay.from_predictions(time, states, 1.1 * states, window=time // 10, ax=Figure())
    >>> [ax.get_ylabel() for ax in display.axes_.flat]
    ['$v_E$ [m/s]', '$p$ [deg/s]', '$r$ [deg/s]']
    """

    def __init__(self, *, time, measured, replayed, std=None, window=None, state_names=LATERAL_STATES):
        self.time = time
        self.measured = measured
        self.replayed = replayed
        self.std = std
        self.window = window
        self.state_names = state_names

    def plot(self, ax=None, *, states=None, level=0.95, time_span=None, n_bins=2000, legend=True):
        """Draw the panels, one above the other.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure. One Axes is divided when there are several panels.
        states : names, optional
            Which states to draw, default all.
        level : float, default=0.95
            Probability of the band.
        time_span : (begin, end), optional
            Part of the record to draw [s].
        n_bins : int, default=2000
            Time slices a longer record is drawn with; of each the extremes are kept.
        legend : bool, default=True
            Whether to write what is what above the first panel.

        Returns
        -------
        StateDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        level = check_level(level)
        chosen = choose(self.state_names, states)
        axes = panels(ax, len(chosen), 1, figsize=(9, 1 + 1.7 * len(chosen)), sharex=True)
        drawn = [self._draw_panel(one, k, level, time_span, n_bins) for one, k in zip(axes.flat, chosen, strict=True)]
        axes.flat[-1].set_xlabel("time [s]")
        self.measured_, self.replayed_, self.bands_, self.restarts_ = (list(kind) for kind in zip(*drawn, strict=True))
        self.axes_, self.figure_ = axes, axes.flat[0].figure
        if legend:
            legend_above(axes.flat[0])
        return self

    def _draw_panel(self, ax, k, level, time_span, n_bins):
        factor = display_unit(self.state_names[k])[0]
        measured, replayed, std = (
            None if v is None else factor * v[:, k] for v in (self.measured, self.replayed, self.std)
        )
        data = Comparison(self.time, measured, replayed, std, None, self.window).within(time_span)
        artists = draw_comparison(ax, data, level=level, n_bins=n_bins)
        artists.mean.set_label("replayed")
        ax.set_ylabel(axis_label(self.state_names[k]))
        tidy(ax)
        return artists.measured, artists.mean, artists.band, _mark_restarts(ax, data)

    @classmethod
    def from_predictions(
        cls, time, measured, replayed, std=None, *, window=None, state_names=None, ax=None, **plot_options
    ):
        """Draw replayed beside measured states.

        Parameters
        ----------
        time, measured, replayed, std, window, state_names
            See the class.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        StateDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If shapes or names do not belong together, or a standard deviation is negative.
        """
        check_matplotlib(f"{cls.__name__}.from_predictions")
        values = check_columns_of(measured, None, "measured states")
        window = None if window is None else np.asarray(window)
        if window is not None and window.shape != (len(values),):
            raise ValueError(f"Got window of shape {window.shape} for {len(values)} samples: give one per sample.")
        display = cls(
            time=check_time(time, len(values)),
            measured=values,
            replayed=check_columns_of(replayed, values.shape, "replayed states"),
            std=check_std(std, values.shape),
            window=window,
            state_names=names_of(measured, values.shape[1], state_names, LATERAL_STATES),
        )
        return display.plot(ax, **plot_options)

    @classmethod
    def from_replay(cls, trajectory, flight, *, states=LATERAL_STATES, horizon=None, ax=None, **plot_options):
        """Draw what :func:`skdgp.dynamics.replay` returned beside the flight it replays.

        Parameters
        ----------
        trajectory : DataFrame
            Columns ``time``, ``horizon``, ``window``, the states and, for bands, ``<state>_std``; one row per
            row of the flight and horizon. Rows not flown are NaN.
        flight : DataFrame
            The measured states, in the same row order.
        states : names, default=("v_east", "p", "r")
            Which states to draw.
        horizon : float, optional
            Which horizon, where the trajectory holds several; default the longest.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        StateDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If columns are missing, the horizon is not there, or the rows do not match.
        """
        states = list(states)
        replayed = replay_rows(trajectory, horizon)
        check_columns(replayed, ["time", "window", *states], what="trajectory")
        check_columns(flight, states)
        if len(replayed) != len(flight):
            raise ValueError(
                f"Got a trajectory of {len(replayed)} rows for a flight of {len(flight)}: give the flight that "
                "was replayed, with all its rows."
            )
        bands = [f"{name}_std" for name in states]
        return cls.from_predictions(
            replayed["time"],
            flight[states],
            replayed[states],
            replayed[bands] if set(bands) <= set(replayed.columns) else None,
            window=replayed["window"],
            ax=ax,
            **plot_options,
        )


def replay_rows(trajectory, horizon: float | None):
    """Return the rows of one horizon of a replay; the longest, for None."""
    check_columns(trajectory, ["horizon"], what="trajectory")
    there = np.unique(trajectory["horizon"])
    horizon = there[-1] if horizon is None else horizon
    rows = trajectory[np.isclose(trajectory["horizon"], horizon)]
    if len(rows) == 0:
        raise ValueError(f"Got horizon={horizon!r} s, but the trajectory holds {there.tolist()} s.")
    return rows


def _mark_restarts(ax, data: Comparison):
    if data.window is None:
        return None
    restarts = data.time[np.flatnonzero(data.window[1:] != data.window[:-1]) + 1]
    if not 0 < len(restarts) <= MOST_MARKS:
        return None
    return ax.plot(
        restarts,
        np.ones(len(restarts)),
        "|",
        color=PALETTE["grey"],
        markersize=5,
        transform=ax.get_xaxis_transform(),
        label="restart",
    )[0]
