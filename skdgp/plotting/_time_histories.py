"""CoefficientDisplay and StateDisplay: measured and estimated values with bands against time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp._compute.intervals import check_level
from skdgp._compute.typing import ArrayLike, Indices, Matrix, Vector
from skdgp._display.flights import LATERAL_STATES, check_time, replay_rows
from skdgp._display.style import PALETTE, ROLES, axis_label, check_matplotlib, display_unit, tidy
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice, check_columns
from skdgp._flight.clock import true_runs
from skdgp.plotting._display import (
    Display,
    Names,
    as_columns,
    check_std,
    choose,
    grid_columns,
    names_of,
    predict_with_std,
)
from skdgp.plotting._lines import band_points, isolated, line_points, segment_starts

MAX_BAND = 0.6  # a band widens the vertical axis by at most this part of the lines' range, so that lines stay readable
MAX_MARKS = 150  # restarts; more would be a grey bar


@dataclass(kw_only=True, eq=False, repr=False)
class CoefficientDisplay(Display):
    """Measured and estimated outputs with the band of the estimate, one panel each (the paper's figure 6).

    Parameters
    ----------
    time : (n,)
        Time of the samples [s]. No line is drawn across a gap, nor where time goes back (a new flight).
    measured : (n, P)
        Measured outputs; NaN = not observed.
    mean : (n, P)
        Estimated outputs.
    std : (n, P), optional
        Their standard deviations.
    truth : (n, P), optional
        Noise-free outputs of a simulation.
    output_names : P names, optional
        Default: those of a DataFrame ``measured``; for six unnamed columns CX CY CZ Cl Cm Cn.

    Attributes
    ----------
    measured_, mean_, bands_, truth_ : lists of artists
        One per panel; None where there was nothing to draw.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CoefficientDisplay
    >>> time = np.linspace(0, 10, 400)
    >>> mean = np.sin(time[:, None] * np.arange(1, 7))
    >>> display = CoefficientDisplay.from_predictions(time, mean + 0.1, mean, 0.1 + 0 * mean, ax=Figure())
    >>> display.axes_.shape, display.output_names[:2]
    ((3, 2), ('CX', 'CY'))
    """

    time: Vector
    measured: Matrix
    mean: Matrix
    std: Matrix | None = None
    truth: Matrix | None = None
    output_names: Any = None

    def plot(
        self,
        ax: Any = None,
        *,
        outputs: Names = None,
        level: float = 0.95,
        n_bins: int = 2000,
        legend: bool = True,
        kind: str = "values",
        time_span: tuple[float, float] | None = None,
    ) -> Self:
        """Draw the panels.

        Parameters
        ----------
        ax, outputs, level, n_bins, legend
            See :mod:`skdgp.plotting`.
        kind : {"values", "residuals"}, default="values"
            Measured and estimated values; or measured minus estimated, with the band about zero, which is clearer for
            a long record.
        time_span : (begin, end), optional
            Part of the record to draw [s].
        """
        level = check_level(level)
        check_choice("kind", kind, ("values", "residuals"))
        chosen = choose(self.output_names, outputs)

        def draw(ax, k):
            columns = (None if v is None else v[:, k] for v in (self.std, self.truth))
            data = _Comparison(self.time, self.measured[:, k], self.mean[:, k], *columns).in_time_span(time_span)
            artists = _draw_comparison(ax, data.residuals() if kind == "residuals" else data, level, n_bins)
            label = axis_label(self.output_names[k])
            ax.set_ylabel(f"{label} less estimate" if kind == "residuals" else label)
            return artists

        options: dict[str, Any] = {"legend": legend, "by_column": True, "sharex": True}
        n_cols = grid_columns(len(chosen))
        artists = self._draw_panels(ax, draw, chosen, n_cols, (5, 1.7), xlabel="time [s]", **options)
        self.measured_, self.mean_, self.bands_, self.truth_ = artists
        return self

    @classmethod
    def from_predictions(
        cls,
        time: ArrayLike,
        measured: ArrayLike,
        mean: ArrayLike,
        std: ArrayLike | None = None,
        *,
        truth: ArrayLike | None = None,
        output_names: Any = None,
        **plot_options: Any,
    ) -> Self:
        """Draw predictions and measurements; see the class and :meth:`plot`."""
        values = as_columns(measured, "measured outputs")
        return cls(
            time=check_time(time, len(values)),
            measured=values,
            mean=as_columns(mean, "mean", values.shape),
            std=check_std(std, values.shape),
            truth=None if truth is None else as_columns(truth, "truth", values.shape),
            output_names=names_of(measured, values.shape[1], output_names, COEFFICIENTS),
        ).plot(**plot_options)

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        Y: Any,
        *,
        time: ArrayLike | None = None,
        truth: ArrayLike | None = None,
        include_noise: bool = False,
        **plot_options: Any,
    ) -> Self:
        """Predict with a fitted estimator and draw.

        Parameters
        ----------
        estimator, X, Y
            See :meth:`CalibrationDisplay.from_estimator`.
        time : (n,), optional
            Default: the column ``time`` of ``X``.
        truth : (n, P), optional
            See the class.
        include_noise : bool, default=False
            Whether the band is that of a new measurement, for estimators that take ``include_noise``, or of the
            noise-free output.
        **plot_options
            See :meth:`plot`.
        """
        check_matplotlib(cls.__name__)
        if time is None and "time" not in getattr(X, "columns", ()):
            raise ValueError("Got an X without a column 'time': give the samples' times as time=... [s].")
        mean, std = predict_with_std(estimator, X, include_noise)
        names = None if hasattr(Y, "columns") else getattr(estimator, "output_names_", None)
        time = X["time"].to_numpy() if time is None else time
        return cls.from_predictions(time, Y, mean, std, truth=truth, output_names=names, **plot_options)


@dataclass(kw_only=True, eq=False, repr=False)
class StateDisplay(Display):
    """Measured states and those replayed with estimated coefficients (the paper's figure 7).

    A replay restarts from the measured state every few seconds. Lines break there, and small marks on the upper edge
    show where. States are given in SI units and drawn in degrees.

    Parameters
    ----------
    time : (n,)
        Time of the samples [s].
    measured, replayed : (n, k)
        States, SI units and radians. Where every replay ends a row later, rows may repeat a time.
    std : (n, k), optional
        Standard deviations of the replayed states.
    window : (n,), optional
        Number of the replay that a row belongs to; it changes at a restart.
    state_names : k names, optional
        Columns of a flight table; default those of a DataFrame ``measured``, or v_east, p, r.

    Attributes
    ----------
    measured_, replayed_, bands_ : lists of artists
        One per panel; None where there was nothing to draw.
    restarts_ : list of artists
        The marks of the restarts, one per panel; None without windows, or for more than 150 restarts.

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

    time: Vector
    measured: Matrix
    replayed: Matrix
    std: Matrix | None = None
    window: np.ndarray | None = None
    state_names: Any = LATERAL_STATES

    def plot(
        self,
        ax: Any = None,
        *,
        level: float = 0.95,
        n_bins: int = 2000,
        legend: bool = True,
        states: Names = None,
        time_span: tuple[float, float] | None = None,
    ) -> Self:
        """Draw the panels, one above the other.

        Parameters
        ----------
        ax, level, n_bins, legend
            See :mod:`skdgp.plotting`.
        states : names, optional
            States to draw, default all.
        time_span : (begin, end), optional
            Part of the record to draw [s].
        """
        level = check_level(level)

        def draw(ax, k):
            factor = display_unit(self.state_names[k])[0]
            std = None if self.std is None else factor * self.std[:, k]
            columns = (factor * self.measured[:, k], factor * self.replayed[:, k], std)
            data = _Comparison(self.time, *columns, window=self.window).in_time_span(time_span)
            measured, replayed, band, _ = _draw_comparison(ax, data, level, n_bins)
            replayed.set_label("replayed")
            ax.set_ylabel(axis_label(self.state_names[k]))
            return measured, replayed, band, _mark_restarts(ax, data)

        chosen = choose(self.state_names, states)
        self.measured_, self.replayed_, self.bands_, self.restarts_ = self._draw_panels(
            ax, draw, chosen, 1, (9, 1.7), xlabel="time [s]", legend=legend, sharex=True
        )
        return self

    @classmethod
    def from_predictions(
        cls,
        time: ArrayLike,
        measured: ArrayLike,
        replayed: ArrayLike,
        std: ArrayLike | None = None,
        *,
        window: ArrayLike | None = None,
        state_names: Any = None,
        **plot_options: Any,
    ) -> Self:
        """Draw replayed and measured states; see the class and :meth:`plot`."""
        values = as_columns(measured, "measured states")
        window = None if window is None else np.asarray(window)
        if window is not None and window.shape != (len(values),):
            raise ValueError(f"Got window of shape {window.shape} for {len(values)} samples: give one per sample.")
        return cls(
            time=check_time(time, len(values)),
            measured=values,
            replayed=as_columns(replayed, "replayed states", values.shape),
            std=check_std(std, values.shape),
            window=window,
            state_names=names_of(measured, values.shape[1], state_names, LATERAL_STATES),
        ).plot(**plot_options)

    @classmethod
    def from_replay(
        cls,
        trajectory: pd.DataFrame,
        flight: pd.DataFrame,
        *,
        states: Any = LATERAL_STATES,
        horizon: float | None = None,
        **plot_options: Any,
    ) -> Self:
        """Draw the result of :func:`skdgp.dynamics.replay` and the flight that it replays.

        Parameters
        ----------
        trajectory : DataFrame
            Columns ``time``, ``horizon``, ``window``, the states and, for bands, ``<state>_std``; one row per
            row of the flight and horizon. Rows that were not replayed are NaN.
        flight : DataFrame
            The measured states, in the same row order.
        states : names, default=("v_east", "p", "r")
            States to draw.
        horizon : float, optional
            Horizon to draw [s], default the longest.
        **plot_options
            See :meth:`plot`.
        """
        states = list(states)
        rows = replay_rows(trajectory, horizon)
        check_columns(rows, ["time", "window", *states], what="trajectory")
        check_columns(flight, states)
        if len(rows) != len(flight):
            raise ValueError(
                f"Got a trajectory of {len(rows)} rows for a flight of {len(flight)}: give the flight that "
                "was replayed, with all its rows."
            )
        bands = [f"{name}_std" for name in states]
        std = rows[bands] if set(bands) <= set(rows.columns) else None
        return cls.from_predictions(
            rows["time"], flight[states], rows[states], std, window=rows["window"], **plot_options
        )


class _Comparison(NamedTuple):
    """Columns of one quantity in the displayed unit; lines break where ``window`` changes."""

    time: Vector
    measured: Vector
    mean: Vector
    std: Vector | None = None
    truth: Vector | None = None
    window: np.ndarray | None = None

    def in_time_span(self, time_span: tuple[float, float] | None) -> _Comparison:
        """Return the part between two times; everything, for None."""
        if time_span is None:
            return self
        begin, end = time_span
        inside = (self.time >= begin) & (self.time <= end)
        if not inside.any():
            raise ValueError(
                f"Got time_span {begin:g} to {end:g} s, but the samples run from {self.time.min():g} to "
                f"{self.time.max():g} s: choose a span inside."
            )
        parts = [None if values is None else values[inside] for values in self]
        return _Comparison(*parts)  # type: ignore[arg-type]

    def residuals(self) -> _Comparison:
        """Return the values minus the estimate."""
        truth = None if self.truth is None else self.truth - self.mean
        return self._replace(measured=self.measured - self.mean, mean=0 * self.mean, truth=truth)


def _draw_comparison(ax: Any, data: _Comparison, level: float, n_bins: int) -> tuple[Any, Any, Any, Any]:
    """Draw one panel, and return the artists of measured, estimate, band and truth; None where there is none."""
    starts = segment_starts(data.time, data.window)
    width = 1.0 if len(data.time) <= 4 * n_bins else 0.6  # thin lines show more where many samples share a pixel

    def line(values, **style):
        if values is None:
            return None
        t, v = line_points(data.time, values, n_bins=n_bins, starts=starts)
        dots = isolated(v)
        return ax.plot(t, v, marker="." if dots else None, markersize=3, markevery=dots, **style)[0]

    # The thin measured line lies over the broad estimate, so both are visible where they agree.
    measured = line(data.measured, color=ROLES["measured"], linewidth=0.5 * width, zorder=2.2, label="measured")
    band = _draw_band(ax, data, starts, level, n_bins)
    truth = line(data.truth, color=ROLES["truth"], linewidth=0.7 * width, zorder=2.1, label="truth")
    mean = line(data.mean, color=ROLES["mean"], linewidth=1.8 * width, label="estimated")
    _limit(ax, data)
    tidy(ax)
    return measured, mean, band, truth


def _draw_band(ax: Any, data: _Comparison, starts: Indices, level: float, n_bins: int) -> Any:
    if data.std is None:
        return None
    half = norm.ppf(0.5 + level / 2) * data.std
    t, lower, upper = band_points(data.time, data.mean - half, data.mean + half, n_bins=n_bins, starts=starts)
    # The edge keeps a band of one sample, which has no width, visible.
    style = {"color": ROLES["band"], "alpha": 0.5, "linewidth": 0.4, "label": f"{level:.0%} band"}
    band = ax.add_artist(_outline(t, lower, upper, **style))
    if t.size:
        # The corners suffice; add_patch would search the whole outline.
        ax.update_datalim([(np.nanmin(t), np.nanmin(lower)), (np.nanmax(t), np.nanmax(upper))])
    return band


def _outline(t: Vector, lower: Vector, upper: Vector, **style: Any) -> Any:
    """Return one patch around all pieces of a band, so that the picture has few elements."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    runs = true_runs(~np.isnan(t))
    edges = [(np.column_stack([t[k], upper[k]]), np.column_stack([t[k], lower[k]])[::-1]) for k in runs]
    outlines = [Path(np.concatenate([forth, back, forth[:1]]), closed=True) for forth, back in edges]
    return PathPatch(Path.make_compound_path(*outlines), **style)


def _limit(ax: Any, data: _Comparison) -> None:
    """Fit the vertical axis to the lines; a much wider band is cut off."""
    lines = np.concatenate([v for v in (data.measured, data.mean, data.truth) if v is not None])
    lines = lines[np.isfinite(lines)]
    if lines.size == 0 or np.ptp(lines) == 0:
        return
    room = MAX_BAND * np.ptp(lines)
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, lines.min() - room), min(high, lines.max() + room))


def _mark_restarts(ax: Any, data: _Comparison) -> Any:
    if data.window is None:
        return None
    restarts = data.time[np.flatnonzero(data.window[1:] != data.window[:-1]) + 1]
    if not 0 < len(restarts) <= MAX_MARKS:
        return None
    style = {"color": PALETTE["grey"], "markersize": 5, "label": "restart", "transform": ax.get_xaxis_transform()}
    return ax.plot(restarts, np.ones(len(restarts)), "|", **style)[0]
