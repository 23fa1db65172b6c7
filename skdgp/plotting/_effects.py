"""The effects of the regressors of a model, and its strongest interactions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._display.style import (
    PALETTE,
    ROLES,
    axis_label,
    display_unit,
    draw_curve,
    symbol,
    units_shown,
)
from skdgp._effects import Curve, Interaction, effects, interactions
from skdgp.plotting._display import BAND, Display

N_EFFECTS = 4  # regressors shown for each output: those whose effects vary most over the samples


@dataclass(kw_only=True, eq=False, repr=False)
class EffectsDisplay(Display):
    r"""The largest effects on each output with their 95 % bands, and its strongest interactions.

    A row holds the four regressors whose effects vary most over the samples, on one scale, and the
    two strongest interactions: the change with one regressor at a low and at a high value of
    another. Short lines at the bottom are quantiles of the samples, each 4 %.

    Parameters
    ----------
    curves : dict of str to Curve
        Effect of each regressor: its values (n,), SI units and radians, mean and standard deviation
        (n, P).
    importance : DataFrame (n_terms, P)
        Standard deviation of each term over the samples; the columns are the outputs.
    samples : DataFrame (n, d)
        Regressors of the samples.
    interactions : dict of str to list of Interaction, optional
        The strongest interactions of each output.

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
    >>> display.keys
    [('Cm', 'alpha'), ('Cm', 'elevator'), ('Cm', 0)]
    """

    curves: dict[str, Curve]
    importance: pd.DataFrame
    samples: pd.DataFrame
    interactions: dict[str, list[Interaction]] = field(default_factory=dict)

    size = (2.9, 1.75)

    @property
    def keys(self) -> list[tuple[str, str | int]]:
        """Output and regressor, or output and number of an interaction."""
        keys: list[tuple[str, str | int]] = []
        for output in map(str, self.importance):
            keys += [(output, name) for name in self._largest(output)]
            keys += [(output, k) for k in range(len(self.interactions.get(output, ())))]
        return keys

    @property
    def n_columns(self) -> int:
        """A row for each output."""
        return -(-len(self.keys) // len(self.importance.columns))

    def _largest(self, output: str) -> list[str]:
        return list(self.importance.loc[list(self.curves), output].nlargest(N_EFFECTS).index)

    def words(self, key: tuple[str, str | int]) -> str:
        """Return what a panel shows."""
        output, name = key
        if isinstance(name, str):
            return f"{output} by {name}"
        first, second = self.interactions[output][name].regressors
        return f"{output} by {first}, at two {second}"

    def draw(self, ax: Any, key: tuple[str, str | int]) -> None:
        """Draw an effect, or an interaction."""
        output, name = key
        ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
        if isinstance(name, str):
            self._draw_effect(ax, output, name)
        else:
            self._draw_interaction(ax, self.interactions[output][name])
        ax.locator_params(axis="both", nbins=4)
        ax.xaxis.set_major_formatter("{x:g}")  # short labels fit narrow panels
        ax.set_ylabel(symbol(output))

    def _draw_effect(self, ax, output, name):
        k = list(self.importance).index(output)
        curve = self.curves[name]
        factor = display_unit(name)[0]
        draw_curve(ax, factor * curve.at, curve.mean[:, k], curve.std[:, k], "effect")
        quantiles = factor * self.samples[name].quantile(np.linspace(0.02, 0.98, 25))
        style = {"color": ROLES["measured"], "markersize": 4, "markeredgewidth": 0.5}
        style["transform"] = ax.get_xaxis_transform()
        ax.plot(quantiles, np.full(len(quantiles), 0.03), "|", label="samples", **style)
        shown = [self.curves[each] for each in self._largest(output)]
        top = max(np.abs(each.mean[:, k]).max() + BAND * each.std[:, k].min() for each in shown)
        ax.set_ylim(-1.08 * top, 1.08 * top)
        ax.set_xlabel(axis_label(name))

    def _draw_interaction(self, ax, found):
        first, second = found.regressors
        factor = display_unit(first)[0]
        times, unit = display_unit(second)
        for k, color in enumerate((PALETTE["blue"], PALETTE["vermillion"])):
            label = f"{symbol(second)} = {times * found.levels[k]:.3g} {unit}".rstrip()
            draw_curve(
                ax, factor * found.at, found.mean[:, k], found.std[:, k], label, color, color
            )
        ax.set_xlabel(axis_label(first))
        lines = [line for line in ax.lines if not line.get_label().startswith("_")]
        ax.legend(handles=lines, frameon=False, fontsize="small")

    @classmethod
    def from_model(cls, model: BaseEstimator, *, ax: Any = None) -> Self:
        """Draw the :func:`skdgp.effects` and the interactions of a model."""
        terms = effects(model)
        display = cls(
            curves=terms.curves,
            importance=terms.importance,
            samples=terms.samples,
            interactions=interactions(model),
        )
        with units_shown(getattr(model, "control_units_", {})):
            return display.plot(ax)
