"""FlightLearningCurveDisplay: scores over the seconds flown."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp.model_selection import flight_learning_curve
from skdgp.plotting._arrays import choose
from skdgp.plotting._style import CYCLE, check_matplotlib, dashes, panels, plain, symbol, tidy

MAX_TICKS = 12


class FlightLearningCurveDisplay:
    """How a score changes with the seconds of each flight that were learned from, per output.

    A line is the mean over the splits, a dot one split. Where the lines have become flat, flying longer like this
    teaches nothing more.

    Use :meth:`from_estimator` or :meth:`from_curve`. All parameters are kept as attributes.

    Parameters
    ----------
    seconds : (S,)
        Seconds of each training flight, rising.
    scores : (S, K, P)
        Scores of K splits and P outputs; NaN where there is none.
    score : str
        What the scores are.
    output_names : P names
        The outputs.

    Attributes
    ----------
    lines_ : list of Line2D
        Means over the splits, one per output drawn.
    dots_ : list of Line2D
        The splits, one artist per output drawn.
    ax_, figure_ : Axes, Figure
        Where it was drawn.

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

    def __init__(self, *, seconds, scores, score, output_names):
        self.seconds = seconds
        self.scores = scores
        self.score = score
        self.output_names = output_names

    def plot(self, ax=None, *, outputs=None, legend=True):
        """Draw the curves.

        Parameters
        ----------
        ax : Axes or Figure, optional
            Where to draw; default: a new pyplot figure.
        outputs : names, optional
            Which outputs to draw, default all.
        legend : bool, default=True
            Whether to name the curves.

        Returns
        -------
        FlightLearningCurveDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
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
        seen = ~np.isnan(values)
        sums, counts = np.where(seen, values, 0.0).sum(axis=1), seen.sum(axis=1)
        mean = np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)
        style = {"color": color, "clip_on": False}
        (line,) = ax.plot(
            self.seconds, mean, marker="o", markersize=4, linestyle=dashes(name), label=symbol(name), **style
        )
        at = np.repeat(self.seconds, values.shape[1])
        (dots,) = ax.plot(at, values.ravel(), "o", markersize=3, alpha=0.35, markeredgewidth=0, **style)
        return line, dots

    @classmethod
    def from_curve(cls, curve: pd.DataFrame, *, score="normalized_rmse", ax=None, **plot_options):
        """Draw what :func:`skdgp.model_selection.flight_learning_curve` returned.

        Parameters
        ----------
        curve : DataFrame
            Columns ``seconds``, ``split``, and ``<score>_<output>`` of each output, or ``<score>`` alone.
        score : str, default="normalized_rmse"
            Which score to draw.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        FlightLearningCurveDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If the curve lacks the score.
        """
        check_matplotlib(f"{cls.__name__}.from_curve")
        columns = [score] if score in curve else [name for name in curve if str(name).startswith(f"{score}_")]
        if not columns:
            known = [str(name) for name in curve if name not in ("seconds", "split", "n_samples")]
            raise ValueError(f"Got score={score!r}, but expected the beginning of a column among {known}.")
        tables = [curve.pivot(index="seconds", columns="split", values=column).sort_index() for column in columns]
        display = cls(
            seconds=tables[0].index.to_numpy(dtype=float),
            scores=np.stack([table.to_numpy(dtype=float) for table in tables], axis=2),
            score=score,
            output_names=tuple(str(column).removeprefix(f"{score}_") for column in columns),
        )
        return display.plot(ax, **plot_options)

    @classmethod
    def from_estimator(
        cls, estimator, table, Y, *, seconds, score="normalized_rmse", ax=None, outputs=None, legend=True, **options
    ):
        """Learn from the first seconds of each flight, score and draw.

        Parameters
        ----------
        estimator : estimator or Pipeline
            It is cloned and fitted for every point of the curve.
        table, Y, seconds
            See :func:`skdgp.model_selection.flight_learning_curve`.
        score : str, default="normalized_rmse"
            Which score to draw.
        ax, outputs, legend
            See :meth:`plot`.
        **options
            See :func:`skdgp.model_selection.flight_learning_curve`.

        Returns
        -------
        FlightLearningCurveDisplay
            The display, drawn.
        """
        check_matplotlib(f"{cls.__name__}.from_estimator")
        curve = flight_learning_curve(estimator, table, Y, seconds=seconds, **options)
        return cls.from_curve(curve, score=score, ax=ax, outputs=outputs, legend=legend)
