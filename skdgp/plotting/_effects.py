"""EffectsDisplay: the effect of each regressor on each output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import pandas as pd
from scipy.stats import norm

from skdgp._compute.intervals import check_level
from skdgp._display.style import (
    PALETTE,
    axis_label,
    check_matplotlib,
    display_unit,
    draw_curve,
    legend_of_figure,
    mark_samples,
    plain,
    symbol,
    tidy,
)
from skdgp._effects import Curve, effects
from skdgp.plotting._display import Display, Names, choose

OTHERS = ""  # key of the column of terms of several regressors


@dataclass(kw_only=True, eq=False, repr=False)
class EffectsDisplay(Display):
    r"""The effect of each regressor with its band: a row for each output, a column for each regressor.

    Panels of a row have the same vertical axis. Short lines in the last row are quantiles of the samples, each 4 %.
    Bars in the last column are terms of several regressors: the range that holds the given probability of their values
    over the samples, if these are normally distributed.

    Parameters
    ----------
    curves : dict of str to Curve
        Effect of each regressor: its values (n,), SI units and radians, mean and standard deviation (n, P).
    importance : DataFrame (n_terms, P)
        Standard deviation of each term over the samples; the columns are the outputs.
    samples : DataFrame (n, d)
        Regressors of the samples.

    Attributes
    ----------
    lines_, bands_ : lists of artists
        One per panel; None for the bars.
    bars_ : list
        The bars of each panel; None for curves.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.plotting import EffectsDisplay
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-0.2, 0.2, (60, 2)), columns=["alpha", "elevator"])
    >>> Y = pd.DataFrame({"Cm": np.sin(4 * X["alpha"]) - 0.5 * X["elevator"]})
    >>> model = DependentGPRegressor(structure="trend").fit(X, Y)
    >>> display = EffectsDisplay.from_model(model, ax=Figure())
    >>> [ax.get_xlabel() for ax in display.axes_.flat]
    ['$\\alpha$\n[deg]', 'elevator\n[deg]']
    """

    curves: dict[str, Curve]
    importance: pd.DataFrame
    samples: pd.DataFrame

    def plot(
        self,
        ax: Any = None,
        *,
        level: float = 0.95,
        outputs: Names = None,
        legend: bool = True,
        regressors: Names = None,
    ) -> Self:
        """Draw the panels.

        Parameters
        ----------
        ax, level, outputs, legend
            See :mod:`skdgp.plotting`.
        regressors : names, optional
            Regressors to draw, default all.
        """
        z = norm.ppf(0.5 + 0.5 * check_level(level))
        names = list(self.importance.columns)
        rows, chosen = choose(names, outputs), choose(list(self.curves), regressors, "regressors")
        columns = [list(self.curves)[k] for k in chosen]
        several = [name for name in self.importance.index if name not in self.curves]
        columns += [OTHERS] * bool(several)
        keys = [(i, column) for i in rows for column in columns]

        def draw(ax, key):
            i, column = key
            tidy(ax)
            ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
            if column == columns[0]:
                ax.set_ylabel(symbol(names[i]))
            if column == OTHERS:
                half = z * self.importance.loc[several].iloc[:, i].to_numpy()
                style = {"width": 0.5, "color": PALETTE["purple"], "alpha": 0.6}
                artists = None, None, ax.bar(range(len(several)), 2 * half, bottom=-half, **style)
                ax.grid(False, axis="x")
            else:
                artists = *self._draw_curve(ax, i, column, level), None
            if i == rows[-1]:
                self._draw_axis(ax, column, several)
            return artists

        size = (max(1.25, min(3.0, 9.0 / len(columns))), 1.15)
        self.lines_, self.bands_, self.bars_ = self._draw_panels(
            ax, draw, keys, len(columns), size, sharex="col", sharey="row"
        )
        self.figure_.align_labels(self.axes_.ravel())
        if legend:
            legend_of_figure(self.axes_[-1, 0])
        return self

    def _draw_curve(self, ax, i, name, level):
        curve, factor = self.curves[name], display_unit(name)[0]
        artists = draw_curve(ax, factor * curve.at, curve.mean[:, i], curve.std[:, i], level, "effect")
        ax.locator_params(axis="x", nbins=2, min_n_ticks=2)
        ax.ticklabel_format(axis="x", scilimits=(-2, 4), useMathText=True)  # short labels fit narrow panels
        ax.locator_params(axis="y", nbins=4)
        return artists

    def _draw_axis(self, ax, column, several):
        """Draw what the panels of a column share: the label, and the samples or the names of the bars."""
        if column == OTHERS:
            ax.set_xlim(-0.75, len(several) - 0.25)
            ax.set_xticks(range(len(several)), [plain(name.replace("_", " ")) for name in several])
            ax.tick_params(axis="x", length=0)
            return
        mark_samples(ax, display_unit(column)[0] * self.samples[column])
        ax.set_xlabel(axis_label(column).replace(" [", "\n["))

    @classmethod
    def from_model(cls, model: Any, X: Any = None, *, n_grid: int = 30, **plot_options: Any) -> Self:
        """Compute the :func:`skdgp.effects` of a model, and draw them with the options of :meth:`plot`."""
        check_matplotlib(cls.__name__)
        return cls.compute(model, X, n_grid=n_grid).plot(**plot_options)

    @classmethod
    def compute(cls, model: Any, X: Any = None, *, n_grid: int = 30) -> Self:
        """Compute the :func:`skdgp.effects` of a model, without drawing them."""
        found = effects(model, X, n_grid=n_grid)
        return cls(curves=found.curves, importance=found.importance, samples=found.samples)
