"""CalibrationDisplay: coverage of intervals by nominal level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from skdgp._compute.statistics import LEVELS, shares_inside, standardized
from skdgp._compute.typing import ArrayLike, Matrix, Vector
from skdgp._display.style import CYCLE, MARKERS, PALETTE, QUIET, dashes, symbol
from skdgp.plotting._display import Display, as_columns, check_std, names_of


@dataclass(kw_only=True, eq=False, repr=False)
class CalibrationDisplay(Display):
    """Coverage of intervals by nominal level, a curve for each output.

    The interval of probability c is mean +/- z std with z = Phi^-1((1 + c) / 2). A curve on the
    diagonal: the standard deviations are right. Below it: too small (overconfident). Above it: too
    large.

    Parameters
    ----------
    nominal, observed : (L,), (L, P)
        Probabilities of the intervals; fractions of values inside, NaN for an output never
        observed.
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
    output_names: tuple[str, ...]
    keys = ("coverage",)
    size = (4.6, 3.6)

    def words(self, key: str) -> str:
        """Return the description of the panel."""
        return "observed against nominal coverage"

    def draw(self, ax: Any, key: str) -> None:
        """Draw the curves of all outputs."""
        ax.plot([0, 100], [0, 100], color=PALETTE["grey"], linewidth=1.0, linestyle=":")
        for k, name in enumerate(self.output_names):
            ax.plot(
                100 * self.nominal,
                100 * self.observed[:, k],
                label=symbol(name),
                color=CYCLE[k % len(CYCLE)],
                linestyle=dashes(name),
                linewidth=1.4,
                marker=MARKERS[k % len(MARKERS)],
                markersize=4,
                markevery=(k % 5, 5),  # where curves agree, markers stand beside each other
                clip_on=False,
            )
        ticks = range(0, 101, 20)
        ax.set(xlabel="nominal coverage [%]", xlim=(0, 100), xticks=ticks, aspect="equal")
        ax.set(ylabel="observed coverage [%]", ylim=(0, 100), yticks=ticks)
        ax.text(4, 96, "too wide", va="top", fontsize="small", color=QUIET)
        ax.text(96, 4, "too narrow", ha="right", fontsize="small", color=QUIET)

    @classmethod
    def from_predictions(
        cls,
        measured: ArrayLike,
        mean: ArrayLike,
        std: ArrayLike,
        *,
        ax: Any = None,
    ) -> Self:
        """Draw the coverage of predictions.

        ``measured``, ``mean`` and ``std`` are (n, P), NaN = not observed. For measured values
        standard deviations must include the measurement noise; for truth they must not. The levels
        are 5 % to 95 % in steps of 5 %, and 99 %. Outputs are named by the columns of a DataFrame
        ``measured``; six unnamed ones are CX CY CZ Cl Cm Cn.
        """
        values = as_columns(measured, "measured outputs")
        mean = as_columns(mean, "mean", values.shape)
        nominal = np.array(LEVELS)
        z = standardized(values, mean, check_std(std, values.shape))
        return cls(
            nominal=nominal,
            observed=shares_inside(z, nominal),
            output_names=names_of(measured, values.shape[1]),
        ).plot(ax)
