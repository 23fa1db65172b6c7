"""CalibrationDisplay: coverage of intervals, and histograms of the probability integral transform."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy.stats import norm

from skdgp._compute.statistics import LEVELS, check_levels, shares_inside, standardized
from skdgp._compute.typing import ArrayLike, Matrix, Vector
from skdgp._display.style import CYCLE, MARKERS, PALETTE, QUIET, dashes, symbol
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice
from skdgp.plotting._display import (
    Display,
    Names,
    as_columns,
    check_std,
    choose,
    grid_columns,
    names_of,
    predicted,
)

N_BINS = 20


@dataclass(kw_only=True, eq=False, repr=False)
class CalibrationDisplay(Display):
    """Coverage of intervals by nominal level, and the probability integral transform, per output.

    The interval of probability c is mean +/- z std with z = Phi^-1((1 + c) / 2). A curve on the
    diagonal: the standard deviations are right. Below it: too small (overconfident). Above it: too
    large.

    The probability integral transform Phi((y - mean) / std) of calibrated predictions is uniform
    (Dawid 1984; Gneiting, Balabdaoui & Raftery 2007). A histogram high in the middle: deviations
    too large. High at both ends: too small. High at one end: the mean is biased, which coverage
    does not show.

    The artists are ``lines_``, the coverage curves, or ``bars_``, the histograms; ``ax_`` is the
    first panel.

    Parameters
    ----------
    nominal, observed : (L,), (L, P)
        Probabilities of the intervals; shares of values inside, NaN for an output never observed.
    pit : (B, P)
        Density of the probability integral transform in B equal bins from 0 to 1; one is uniform,
        NaN never observed.
    output_names : P names

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CalibrationDisplay
    >>> y = np.random.default_rng(0).normal(size=(5000, 1))
    >>> display = CalibrationDisplay.from_predictions(y, 0 * y, 1 + 0 * y, ax=Figure())
    >>> bool(abs(display.observed[:, 0] - display.nominal).max() < 0.03)
    True
    """

    nominal: Vector
    observed: Matrix
    pit: Matrix
    output_names: tuple[str, ...]

    def plot(
        self, ax: Any = None, *, outputs: Names = None, legend: bool = True, kind: str = "coverage"
    ) -> Self:
        """Draw ``kind`` "coverage", all outputs in one panel, or "pit", a histogram each; see :mod:`skdgp.plotting`."""
        check_choice("kind", kind, ("coverage", "pit"))
        chosen = choose(self.output_names, outputs)
        if kind == "pit":
            self._draw_histograms(ax, chosen)
        else:
            self._draw_panels(
                ax, lambda one, _: self._draw_coverage(one, chosen, legend), [0], 1, (4.6, 3.6)
            )
        self.ax_ = self.axes_.flat[0]
        return self

    def _draw_coverage(self, ax, chosen, legend):
        ax.plot([0, 100], [0, 100], color=PALETTE["grey"], linewidth=1.0, linestyle=":")
        self.lines_ = []
        for k in chosen:
            style = {
                "color": CYCLE[k % len(CYCLE)],
                "linestyle": dashes(self.output_names[k]),
                "linewidth": 1.4,
            }
            # Where curves agree, their markers stand beside each other.
            style |= {
                "marker": MARKERS[k % len(MARKERS)],
                "markersize": 4,
                "markevery": (k % 5, 5),
                "clip_on": False,
            }
            label = symbol(self.output_names[k])
            self.lines_ += ax.plot(
                100 * self.nominal, 100 * self.observed[:, k], label=label, **style
            )
        ticks = range(0, 101, 20)
        ax.set(xlabel="nominal coverage [%]", xlim=(0, 100), xticks=ticks, aspect="equal")
        ax.set(ylabel="observed coverage [%]", ylim=(0, 100), yticks=ticks)
        ax.text(4, 96, "too wide", va="top", fontsize="small", color=QUIET)
        ax.text(96, 4, "too narrow", ha="right", fontsize="small", color=QUIET)
        if legend and chosen:
            ax.legend(
                loc="upper left", bbox_to_anchor=(0.01, 0.92), frameon=False, fontsize="small"
            )
        return ()

    def _draw_histograms(self, ax, chosen):
        edges = np.linspace(0, 1, len(self.pit) + 1)

        def draw(ax, k):
            bars = ax.stairs(
                np.nan_to_num(self.pit[:, k]),
                edges,
                fill=True,
                color=CYCLE[k % len(CYCLE)],
                alpha=0.75,
            )
            ax.axhline(1.0, color="#333333", linewidth=1.0, linestyle=":")
            ax.set(xlim=(0, 1), xticks=[0, 0.5, 1])
            ax.set_title(symbol(self.output_names[k]), loc="left", fontsize="medium")
            return (bars,)

        options = {
            "by_column": True,
            "sharex": True,
            "sharey": True,
            "xlabel": r"$\Phi$((measured - mean) / std)",
        }
        (self.bars_,) = self._draw_panels(
            ax, draw, chosen, grid_columns(len(chosen)), (3.2, 1.5), **options
        )
        self.axes_.flat[0].set_ylim(0, 1.05 * np.nan_to_num(self.pit[:, chosen]).max(initial=1.0))
        for left in self.axes_[:, 0]:
            left.set_ylabel("density")

    @classmethod
    def from_predictions(
        cls, measured: ArrayLike, mean: ArrayLike, std: ArrayLike, *, levels: ArrayLike = LEVELS,
        output_names: Any = None, **plot_options: Any,
    ) -> Self:  # fmt: skip
        """Compute coverage and transform of predictions, and draw them with the options of :meth:`plot`.

        ``measured``, ``mean`` and ``std`` are (n, P), NaN = not observed. For measured values
        standard deviations must include the measurement noise; for truth they must not. The levels
        (L,) are by default 5 % to 95 % in steps of 5 %, and 99 %. Names of outputs are as for
        :class:`CoefficientDisplay`.
        """
        values = as_columns(measured, "measured outputs")
        mean = as_columns(mean, "mean", values.shape)
        nominal = check_levels(levels)
        z = standardized(values, mean, check_std(std, values.shape))
        with np.errstate(invalid="ignore"):  # of an output never observed
            densities = [
                np.histogram(column, N_BINS, (0, 1), density=True)[0] for column in norm.cdf(z).T
            ]
        return cls(
            nominal=nominal,
            observed=shares_inside(z, nominal),
            pit=np.column_stack(densities),
            output_names=names_of(measured, values.shape[1], output_names, COEFFICIENTS),
        ).plot(**plot_options)

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, Y: Any, *, include_noise: bool = True, **options: Any
    ) -> Self:
        """Predict with a fitted estimator, and draw with the options of :meth:`from_predictions`.

        Its ``predict`` takes ``return_std``. X (n, d) are regressors, or the flights of an
        identification pipeline; Y (n, P) measured outputs, NaN = not observed. Set
        ``include_noise`` to False for truth, and for estimators whose ``predict`` does not take it.
        """
        mean, std, names = predicted(estimator, X, Y, include_noise)
        return cls.from_predictions(Y, mean, std, **{"output_names": names, **options})
