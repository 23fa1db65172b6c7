"""CoefficientDisplay and StateDisplay: measured and estimated values with bands against time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.statistics import half_width
from skdgp._compute.typing import ArrayLike, Matrix, Vector
from skdgp._display.flights import LATERAL_STATES, check_time, replay_rows
from skdgp._display.style import ROLES, axis_label, display_unit
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice, check_columns
from skdgp.plotting._display import (
    Display,
    Names,
    as_columns,
    band_points,
    check_std,
    choose,
    grid_columns,
    isolated,
    line_points,
    names_of,
    predicted,
    segment_starts,
)

KINDS = {"values": ("values",), "residuals": ("residuals",), "both": ("values", "residuals")}
MAX_BAND = 0.6
"""Largest part of the lines' range by which a band widens the vertical axis."""


@dataclass(kw_only=True, eq=False, repr=False)
class CoefficientDisplay(Display):
    """Measured and estimated outputs with the band of the estimate (the paper's figure 6).

    The artists are ``measured_``, ``mean_``, ``bands_`` and ``truth_``.

    Parameters
    ----------
    time : (n,)
        Time of the samples [s]. No line is drawn across a gap, nor where time goes back (a new
        flight).
    measured, mean : (n, P)
        Measured outputs, NaN = not observed; estimated outputs.
    std, truth : (n, P), optional
        Standard deviations of the estimate; noise-free outputs of a simulation.
    output_names : P names, optional
        Default: those of a DataFrame ``measured``; for six unnamed columns CX CY CZ Cl Cm Cn.

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
        self, ax: Any = None, *, outputs: Names = None, level: float = 0.95, n_bins: int = 2000, legend: bool = True,
        kind: str = "values", time_span: tuple[float, float] | None = None,
    ) -> Self:  # fmt: skip
        """Draw ``kind`` "values", "residuals", measured minus estimated, or "both"; see :mod:`skdgp.plotting`."""
        check_choice("kind", kind, tuple(KINDS))
        chosen, kinds = choose(self.output_names, outputs), KINDS[kind]
        draws = {}
        for name in kinds:
            zero = self.mean if name == "residuals" else np.zeros_like(self.mean)
            truth = None if self.truth is None else self.truth - zero
            std = self.std
            if kind == "both":  # the truth above, the band beneath
                truth, std = (truth, None) if name == "values" else (None, std)
            columns = self.measured - zero, self.mean - zero, std, truth
            less = " less estimate" if kind == "residuals" else ""
            draws[name] = _drawing(
                self.time, columns, self.output_names, "estimated", level, n_bins, time_span, less
            )

        def draw(ax, key):
            artists = draws[key[1]](ax, key[0])
            if len(kinds) > 1 and key[1] == "residuals":
                ax.set_ylabel("residual")
            return artists

        n_cols = grid_columns(len(chosen)) if len(chosen) % 2 == 0 or kind != "both" else 1
        n_rows = -(-len(chosen) // n_cols)
        ratios = {"height_ratios": [2.0, 1.2] * n_rows} if kind == "both" else {}
        options = {"xlabel": "time [s]", "legend": legend, "by_column": True, "sharex": True}
        keys = [(k, name) for k in chosen for name in kinds]
        artists = self._draw_panels(ax, draw, keys, n_cols, (5, 1.7), gridspec_kw=ratios, **options)
        self.measured_, self.mean_, self.bands_, self.truth_ = artists
        return self

    @classmethod
    def from_predictions(
        cls, time: ArrayLike, measured: ArrayLike, mean: ArrayLike, std: ArrayLike | None = None, *,
        truth: ArrayLike | None = None, output_names: Any = None, **plot_options: Any,
    ) -> Self:  # fmt: skip
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
        cls, estimator: Any, X: Any, Y: Any, *, time: ArrayLike | None = None, truth: ArrayLike | None = None,
        include_noise: bool = False, **plot_options: Any,
    ) -> Self:  # fmt: skip
        """Predict with a fitted estimator and draw, as :meth:`CalibrationDisplay.from_estimator`; see :meth:`plot`.

        ``time`` (n,) is by default the column ``time`` of X. With ``include_noise`` the band is
        that of a measurement.
        """
        if time is None and "time" not in getattr(X, "columns", ()):
            raise ValueError(
                "Got an X without a column 'time': give the samples' times as time=... [s]."
            )
        mean, std, names = predicted(estimator, X, Y, include_noise)
        time = X["time"].to_numpy() if time is None else time
        return cls.from_predictions(
            time, Y, mean, std, truth=truth, output_names=names, **plot_options
        )


@dataclass(kw_only=True, eq=False, repr=False)
class StateDisplay(Display):
    """Measured states and those replayed with estimated coefficients (the paper's figure 7).

    A replay restarts from the measured state every few seconds, where lines break. States are given
    in SI units and drawn in degrees.

    The artists are ``measured_``, ``replayed_`` and ``bands_``.

    Parameters
    ----------
    time : (n,)
        Time of the samples [s].
    measured, replayed : (n, k)
        States, SI units and radians.
    window : (n,)
        Number of the replay that a row belongs to, which changes at a restart.
    state_names : k names
        Columns of a flight table.
    std : (n, k), optional
        Standard deviations of the replayed states.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import StateDisplay
    >>> flight = pd.DataFrame({"time": np.arange(0, 30, 0.1), "p": 0.1})
    >>> replayed = flight.assign(horizon=10.0, window=flight["time"] // 10, p=0.11)
    >>> StateDisplay.from_replay(replayed, flight, states=["p"], ax=Figure()).axes_[0, 0].get_ylabel()
    '$p$ [deg/s]'
    """

    time: Vector
    measured: Matrix
    replayed: Matrix
    window: np.ndarray
    state_names: tuple[str, ...]
    std: Matrix | None = None

    def plot(
        self, ax: Any = None, *, level: float = 0.95, n_bins: int = 2000, legend: bool = True,
        time_span: tuple[float, float] | None = None,
    ) -> Self:  # fmt: skip
        """Draw the states, one above the other; see :mod:`skdgp.plotting`."""
        columns = self.measured, self.replayed, self.std, None
        names = self.state_names
        draw = _drawing(
            self.time, columns, names, "replayed", level, n_bins, time_span, window=self.window
        )
        options = {"xlabel": "time [s]", "legend": legend, "sharex": True}
        artists = self._draw_panels(ax, draw, range(len(names)), 1, (9, 1.7), **options)
        self.measured_, self.replayed_, self.bands_, _ = artists
        return self

    @classmethod
    def from_replay(
        cls, trajectory: pd.DataFrame, flight: pd.DataFrame, *, states: Any = LATERAL_STATES,
        horizon: float | None = None, **plot_options: Any,
    ) -> Self:  # fmt: skip
        """Draw the result of :func:`skdgp.dynamics.replay` and the flight that it replays; see :meth:`plot`.

        ``trajectory`` has columns ``time``, ``horizon``, ``window``, the states and, for bands,
        ``<state>_std``, and one row per row of the flight and horizon. ``flight`` holds the
        measured states, in the same row order. The horizon [s] is by default the longest.
        """
        states = list(states)
        rows = replay_rows(trajectory, horizon)
        check_columns(rows, ["time", "window", *states], what="trajectory")
        check_columns(flight, states)
        if len(rows) != len(flight):
            raise ValueError(
                f"Got a trajectory of {len(rows)} rows for a flight of {len(flight)}: give the "
                f"flight that was replayed, with all its rows."
            )
        bands = [f"{name}_std" for name in states]
        return cls(
            time=check_time(rows["time"]),
            measured=flight[states].to_numpy(float),
            replayed=rows[states].to_numpy(float),
            std=rows[bands].to_numpy(float) if set(bands) <= set(rows.columns) else None,
            window=rows["window"].to_numpy(),
            state_names=tuple(states),
        ).plot(**plot_options)


def _drawing(time, columns, names, estimate, level, n_bins, span, less="", window=None) -> Callable:
    """Return the function that draws panel k of ``columns``: measured, estimate, its deviations and truth, (n, P) each.

    It returns the artists of measured, estimate, band and truth, None where there is none.
    """
    from matplotlib.colors import to_rgb

    z = half_width(level)
    rows = slice(None)
    if span is not None:
        rows = (time >= span[0]) & (time <= span[1])
        if not rows.any():
            raise ValueError(
                f"Got time_span {span[0]:g} to {span[1]:g} s, but the samples run from "
                f"{time.min():g} to {time.max():g} s: choose a span inside."
            )
    time = time[rows]
    starts = segment_starts(time, None if window is None else window[rows])

    def draw(ax, k):
        factor = display_unit(names[k])[0]
        shown = [None if values is None else factor * values[rows, k] for values in columns]
        measured, mean, std, truth = shown

        def line(values, **style):
            if values is None:
                return None
            points = line_points(time, values, n_bins=n_bins, starts=starts)
            alone = isolated(points[1])
            return ax.plot(
                *points, marker="." if alone else None, markersize=3, markevery=alone, **style
            )[0]

        thick = line(measured, color=ROLES["measured"], linewidth=1.4, label="measured")
        band = None
        if std is not None:
            half = z * std
            edges = band_points(time, mean - half, mean + half, n_bins=n_bins, starts=starts)
            # Above the measured values, which may fill the band.
            style: dict[str, Any] = {
                "facecolor": (*to_rgb(ROLES["band"]), 0.35),
                "edgecolor": ROLES["edge"],
            }
            style |= {"linewidth": 0.6, "zorder": 2.2, "label": f"{level:.0%} band"}
            band = ax.fill_between(*edges, **style)
        known = line(truth, color=ROLES["truth"], linewidth=0.9, linestyle="--", label="truth")
        thin = line(mean, color=ROLES["mean"], linewidth=0.8, zorder=2.3, label=estimate)
        _limit(ax, np.concatenate([one for one in (measured, mean, truth) if one is not None]))
        ax.set_ylabel(axis_label(names[k]) + less)
        return thick, thin, band, known

    return draw


def _limit(ax: Any, shown: Vector) -> None:
    """Fit the vertical axis to the lines; a much wider band is cut off."""
    shown = shown[np.isfinite(shown)]
    if shown.size and np.ptp(shown) > 0:
        room = MAX_BAND * np.ptp(shown)
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, shown.min() - room), min(high, shown.max() + room))
