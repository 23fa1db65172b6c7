"""TimeHistoryDisplay: measured, estimated, simulated or true values with bands against time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.utils import check_consistent_length

from skdgp._compute.typing import ArrayLike, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, ELEVONS, EULER, SURFACES
from skdgp._flight.tables import check_columns, interpolated, unwrapped
from skdgp.dynamics import trajectory_bands
from skdgp.plotting._display import BAND, ROLES, Display, axis_label, display_unit, segments

INPUTS = ("throttle", *SURFACES, *ELEVONS)
# Samples above which lines are drawn as a picture: 20,000 of six outputs take 194 kB of SVG, and 900 as lines 568 kB
LONG = 1000
TRAJECTORY = ("airspeed", "altitude", "phi", "theta", "p", "q")


@dataclass(kw_only=True, eq=False, repr=False)
class TimeHistoryDisplay(Display):
    """Measured and estimated values with the 95 % band of the estimate, a panel for each name.

    Units are SI and radians, drawn in degrees. No line is drawn across a gap, nor where time goes
    back.

    Parameters
    ----------
    time, names : (n,), k names
        Time of the samples [s]; outputs, or columns of a flight table.
    measured, mean, truth : (n, k), optional
        Measured values, NaN = not observed; estimated ones; noise-free ones of a simulation.
    lower, upper : (n, k), optional
        Edges of the band.
    estimate : str
        What ``mean`` is called.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import TimeHistoryDisplay
    >>> time = np.linspace(0, 10, 400)
    >>> mean = np.sin(time[:, None] * np.arange(1, 7))
    >>> display = TimeHistoryDisplay.from_predictions(time, mean + 0.1, mean, 0.1 + 0 * mean, ax=Figure())
    >>> display.axes_.shape, display.names[:2]
    ((3, 2), ('CX', 'CY'))
    """

    time: Vector
    names: tuple[str, ...]
    measured: Matrix | None = None
    mean: Matrix | None = None
    truth: Matrix | None = None
    lower: Matrix | None = None
    upper: Matrix | None = None
    estimate: str = "estimated"
    by_column = True

    @property
    def keys(self) -> list[str]:
        """The names."""
        return list(self.names)

    def draw(self, ax: Any, key: str) -> None:
        """Draw the lines and the band of a name."""
        k = self.names.index(key)
        factor, _ = display_unit(key)
        # a picture of every sample of a long record is smaller, and drawn faster, than its lines
        common = {"rasterized": len(self.time) > LONG}

        def line(label: str, values: Matrix | None, **style: Any) -> None:
            if values is not None:
                drawn = segments(self.time, factor * values[:, k])
                ax.plot(*drawn, label=label, **style, **common)

        if self.lower is not None and self.upper is not None:
            edges = factor * np.column_stack([self.lower[:, k], self.upper[:, k]])
            style = {"color": ROLES["band"], "alpha": 0.35, "linewidth": 0.6, "zorder": 2.2}
            drawn = segments(self.time, edges)
            ax.fill_between(*drawn, label="95 % band", **style, **common)
        line("measured", self.measured, color=ROLES["measured"], linewidth=1.4)
        line("truth", self.truth, color=ROLES["truth"], linewidth=0.9, linestyle="--")
        line(self.estimate, self.mean, color=ROLES["mean"], linewidth=0.8, zorder=2.3)
        if self.measured is not None:  # else the band is the subject of the figure
            _fit_to_lines(ax)
        # short labels of small values, which would stand over the name
        ax.ticklabel_format(axis="y", scilimits=(-3, 6))
        ax.set(xlabel="time [s]", ylabel=axis_label(key))

    @classmethod
    def from_predictions(
        cls,
        time: ArrayLike,
        measured: ArrayLike,
        mean: ArrayLike,
        std: ArrayLike | None = None,
        *,
        truth: ArrayLike | None = None,
        ax: Any = None,
    ) -> Self:
        """Draw predictions (n, P) and measurements.

        Outputs are named by the columns of a DataFrame ``measured``; six unnamed ones are CX CY CZ
        Cl Cm Cn.
        """
        check_consistent_length(time, measured, mean, std, truth)

        def columns(values: ArrayLike | None) -> Any:
            return None if values is None else np.asarray(values, float).reshape(len(center), -1)

        center = np.reshape(np.asarray(mean, dtype=float), (np.size(time), -1))
        half = None if std is None else BAND * columns(std)
        n_outputs = center.shape[1]
        unnamed = COEFFICIENTS if n_outputs == 6 else [f"y{k}" for k in range(n_outputs)]
        return cls(
            time=np.asarray(time, dtype=float),
            measured=columns(measured),
            mean=center,
            lower=None if half is None else center - half,
            upper=None if half is None else center + half,
            truth=columns(truth),
            names=tuple(map(str, getattr(measured, "columns", unnamed))),
        ).plot(ax)

    @classmethod
    def from_trajectories(
        cls,
        trajectories: pd.DataFrame,
        flown: pd.DataFrame | None = None,
        *,
        columns: Any = TRAJECTORY,
        ax: Any = None,
    ) -> Self:
        """Draw one trajectory of :func:`skdgp.dynamics.simulate`, or the paths of one start.

        The band holds 95 % of the paths at each time. The line is the median of the paths, which no aircraft flies.
        ``flown`` is the recorded flight, interpolated to the times of the simulation.
        """
        names = list(columns)
        check_columns(trajectories, ["time", *names], what="trajectory")
        if "start" in trajectories and trajectories["start"].nunique() > 1:
            raise ValueError(
                f"Got trajectories of {trajectories['start'].nunique()} starts, but "
                "expected those of one: trajectories[trajectories['start'] == 0]."
            )
        lower = upper = None
        estimate = "simulated"
        if "path" in trajectories:
            bands = trajectory_bands(trajectories, columns=names)
            time, line = bands["time"].to_numpy(float), bands[names].to_numpy()
            lower, upper = (
                bands[[f"{name}_{end}" for name in names]].to_numpy() for end in ("low", "high")
            )
            estimate = "median of the paths"
        else:
            time, line = trajectories["time"].to_numpy(float), unwrapped(trajectories, names)
        return cls(
            time=time,
            names=tuple(names),
            mean=line,
            lower=lower,
            upper=upper,
            measured=None if flown is None else _interpolated(flown, time, names, line[0]),
            estimate=estimate,
        ).plot(ax)

    @classmethod
    def from_inputs(cls, flight: pd.DataFrame, *, ax: Any = None) -> Self:
        """Draw the inputs of a flight (the paper's figure 4): throttle and surfaces."""
        check_columns(flight, ["time"])
        names = [name for name in INPUTS if name in flight]
        if not names:
            raise ValueError(f"Got a flight without inputs, but expected some of {list(INPUTS)}.")
        return cls(
            time=flight["time"].to_numpy(float),
            names=tuple(names),
            measured=flight[names].to_numpy(float),
        ).plot(ax)


def _interpolated(flown: pd.DataFrame, time: Vector, names: list[str], start: Vector) -> Matrix:
    """Return a flight at times, its angles without jumps, within half a turn of the simulated ones at the start."""
    check_columns(flown, ["time", *names], what="flown")
    clock = flown["time"].to_numpy(float)
    values = interpolated(time, clock, unwrapped(flown, names), beyond=np.nan)
    turns = np.round((start - values[0]) / (2 * np.pi)) * np.isin(names, EULER)
    return values + 2 * np.pi * turns


def _fit_to_lines(ax: Any) -> None:
    """Fit the vertical axis to the lines; a band may widen it by 0.6 of their range, and is cut off there."""
    shown = np.concatenate([line.get_ydata() for line in ax.lines])
    shown = shown[np.isfinite(shown)]
    if shown.size and np.ptp(shown) > 0:
        room = 0.6 * np.ptp(shown)
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, shown.min() - room), min(high, shown.max() + room))
