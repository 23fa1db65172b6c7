"""FlightLearningCurveDisplay: scores over the length of the training flights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array, ArrayLike, Vector
from skdgp.model_selection import flight_learning_curve
from skdgp.plotting._display import Names, choose, panels
from skdgp.plotting._style import CYCLE, check_matplotlib, dashes, plain, symbol, tidy

MAX_TICKS = 12


@dataclass(kw_only=True, eq=False, repr=False)
class FlightLearningCurveDisplay:
    """Scores over the seconds of each training flight, per output.

    A line is the mean over the splits, a dot one split. Where lines are flat, longer flights of this kind do not
    improve the model.

    Parameters
    ----------
    seconds : (S,)
        Seconds of each training flight, rising.
    scores : (S, K, P)
        Scores of K splits and P outputs; NaN where there is none.
    score : str
        Name of the score.
    output_names : P names
        The outputs.

    Attributes
    ----------
    lines_ : list of Line2D
        Means over the splits, one per output drawn.
    dots_ : list of Line2D
        The splits, one artist per output drawn.

    Examples
    --------
    >>> import pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import FlightLearningCurveDisplay
    >>> curve = pd.DataFrame({"seconds": [20, 20, 40, 40], "split": [0, 1, 0, 1],
    ...                       "normalized_rmse_CZ": [0.4, 0.6, 0.2, 0.3], "normalized_rmse_Cm": [0.8, 0.9, 0.7, 0.7]})
    >>> display = FlightLearningCurveDisplay.from_curve(curve, ax=Figure())
    >>> display.output_names, display.scores.mean(axis=1)[:, 0].tolist()
    (('CZ', 'Cm'), [0.5, 0.25])
    """

    seconds: Vector
    scores: Array
    score: str
    output_names: tuple[str, ...]

    def plot(self, ax: Any = None, *, outputs: Names = None, legend: bool = True) -> Self:
        """Draw the curves. See :mod:`skdgp.plotting` for the options."""
        chosen = choose(self.output_names, outputs)
        ax = panels(ax, 1, 1, figsize=(5.6, 4.2))[0, 0]
        drawn = [self._draw_output(ax, k) for k in chosen]
        self.lines_, self.dots_ = [line for line, _ in drawn], [dots for _, dots in drawn]
        ax.set(xlabel="seconds of each training flight", ylabel=plain(self.score.replace("_", " ")), xscale="log")
        ticks = self.seconds[:: -(-len(self.seconds) // MAX_TICKS)]
        ax.set_xticks(ticks, [f"{second:g}" for second in ticks])
        ax.set_xticks([], minor=True)
        tidy(ax)
        ax.margins(x=0.05)
        if legend and len(self.output_names) > 1 and chosen:
            ax.legend(frameon=False, fontsize="small", ncols=2)
        self.ax_, self.figure_ = ax, ax.figure
        return self

    def _draw_output(self, ax, k):
        values, color, name = self.scores[:, :, k], CYCLE[k % len(CYCLE)], self.output_names[k]
        sums, counts = np.nansum(values, axis=1), np.count_nonzero(~np.isnan(values), axis=1)
        mean = np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)
        style = {"color": color, "clip_on": False}
        marks = {"marker": "o", "markersize": 4, "linestyle": dashes(name)}
        (line,) = ax.plot(self.seconds, mean, label=symbol(name), **marks, **style)
        at = np.repeat(self.seconds, values.shape[1])
        (dots,) = ax.plot(at, values.ravel(), "o", markersize=3, alpha=0.35, markeredgewidth=0, **style)
        return line, dots

    @classmethod
    def from_curve(cls, curve: pd.DataFrame, *, score: str = "normalized_rmse", **plot_options: Any) -> Self:
        """Draw a score of :func:`skdgp.model_selection.flight_learning_curve`'s result; options of :meth:`plot`.

        ``curve`` has the columns seconds, split and ``<score>_<output>`` for each output, or ``<score>`` alone.
        """
        columns = [score] if score in curve else [name for name in curve if str(name).startswith(f"{score}_")]
        if not columns:
            known = [str(name) for name in curve if name not in ("seconds", "split", "n_samples")]
            raise ValueError(f"Got score={score!r}, but expected the beginning of a column among {known}.")
        tables = [curve.pivot(index="seconds", columns="split", values=column).sort_index() for column in columns]
        return cls(
            seconds=tables[0].index.to_numpy(dtype=float),
            scores=np.stack([table.to_numpy(dtype=float) for table in tables], axis=2),
            score=score,
            output_names=tuple(str(column).removeprefix(f"{score}_") for column in columns),
        ).plot(**plot_options)

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        table: pd.DataFrame,
        Y: Any,
        *,
        seconds: ArrayLike,
        score: str = "normalized_rmse",
        ax: Any = None,
        outputs: Names = None,
        legend: bool = True,
        **options: Any,
    ) -> Self:
        """Compute :func:`skdgp.model_selection.flight_learning_curve` with its ``options``, and draw one ``score``."""
        check_matplotlib(cls.__name__)
        curve = flight_learning_curve(estimator, table, Y, seconds=seconds, **options)
        return cls.from_curve(curve, score=score, ax=ax, outputs=outputs, legend=legend)
