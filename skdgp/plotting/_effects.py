"""EffectsDisplay: how each output of a model changes with each regressor, in slices through one point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.typing import Array
from skdgp._flight.tables import check_names
from skdgp.plotting._display import BAND, ROLES, Display, axis_label, display_unit, symbol

# Points of a slice, and the quantiles of the regressor between which it lies
POINTS = 30
RANGE = (0.01, 0.99)
# Regressors that are drawn for each output
SHOWN = 4


@dataclass(kw_only=True, eq=False, repr=False)
class EffectsDisplay(Display):
    r"""Outputs of a model by one regressor, the others at a point such as a trim, with 95 % bands.

    A row holds the four regressors along which an output changes most, on one scale. Short lines at
    the bottom are quantiles of the samples, each 4 %.

    Parameters
    ----------
    outputs : sequence of str, P
    samples : DataFrame (m, d)
        Regressors of the samples, SI units and radians.
    at : Series (d,)
        The point.
    values : DataFrame (n, d)
        Values of each regressor along its slice.
    mean, std : ndarray (d, n, P)
        Of the outputs along the slice of each regressor.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.plotting import EffectsDisplay
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-0.2, 0.2, (60, 2)), columns=["alpha", "elevator"])
    >>> Y = pd.DataFrame({"Cm": np.sin(4 * X["alpha"]) - 0.5 * X["elevator"]})
    >>> model = DependentGPRegressor(structure="trend").fit(X, Y)
    >>> display = EffectsDisplay.from_estimator(model, X, {"elevator": 0.0}, ax=Figure())
    >>> display.keys
    [('Cm', 'alpha'), ('Cm', 'elevator')]
    """

    outputs: tuple[str, ...]
    samples: pd.DataFrame
    at: pd.Series
    values: pd.DataFrame
    mean: Array
    std: Array

    size = (2.9, 1.75)
    sharey = "row"

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Outputs, and for each the regressors along which it changes most."""
        changes = pd.DataFrame(np.ptp(self.mean, axis=1), list(self.values), self.outputs)
        return [(name, k) for name in self.outputs for k in changes[name].nlargest(SHOWN).index]

    @property
    def n_columns(self) -> int:
        """A row for each output."""
        return len(self.keys) // len(self.outputs)

    def draw(self, ax: Any, key: tuple[str, str]) -> None:
        """Draw the slice of an output along a regressor."""
        output, name = key
        k = self.outputs.index(output)
        i = list(self.values).index(name)
        factor, _ = display_unit(name)
        ax.axvline(factor * self.at[name], color=ROLES["measured"], linewidth=0.6)
        at = factor * self.values[name].to_numpy()
        center, half = self.mean[i, :, k], BAND * self.std[i, :, k]
        style = {"color": ROLES["band"], "alpha": 0.35, "linewidth": 0}
        ax.fill_between(at, center - half, center + half, label="95 % band", **style)
        ax.plot(at, center, color=ROLES["mean"], label="model")
        quantiles = factor * self.samples[name].quantile(np.linspace(0.02, 0.98, 25))
        ax.plot(
            quantiles, np.full(len(quantiles), 0.03), "|", label="samples", color=ROLES["measured"],
            markersize=4, markeredgewidth=0.5, transform=ax.get_xaxis_transform(),
        )  # fmt: skip
        ax.locator_params(axis="both", nbins=4)
        # short labels fit narrow panels
        ax.xaxis.set_major_formatter("{x:g}")
        ax.ticklabel_format(axis="y", scilimits=(-3, 4))
        ax.set(xlabel=axis_label(name), ylabel=symbol(output))

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: pd.DataFrame,
        at: Mapping[str, float] | None = None,
        *,
        ax: Any = None,
    ) -> Self:
        """Draw slices of a fitted `DependentGPRegressor`, or of a pipeline that ends in one.

        Parameters
        ----------
        estimator : DependentGPRegressor or Pipeline
        X : DataFrame (m, d)
            Samples of the input, as of ``fit``: a slice lies between the 1 % and the 99 % quantile.
        at : mapping of str to float, optional
            Values of regressors at the point; the others have their mean over the samples.
        ax : Figure, SubFigure or False, optional
            See :mod:`skdgp.plotting`.
        """
        check_is_fitted(estimator)
        check_names(at or {}, X.columns, "regressors")
        regressor = estimator[-1] if isinstance(estimator, Pipeline) else estimator
        point = X.mean().astype(float)
        point.update(pd.Series(dict(at or {}), dtype=float))
        low, high = X.quantile(RANGE[0]), X.quantile(RANGE[1])
        values = pd.DataFrame(np.linspace(low, high, POINTS), columns=X.columns)
        d = X.shape[1]
        slices = np.tile(point, (d, POINTS, 1))
        slices[range(d), :, range(d)] = values.T
        points = pd.DataFrame(slices.reshape(-1, d), columns=X.columns)
        # the regressors of a slice are exact
        predicted = estimator.predict(points, return_std=True, include_input_noise=False)
        mean, std = np.reshape(predicted, (2, d, POINTS, -1))
        outputs = tuple(regressor.output_names_)
        display = cls(outputs=outputs, samples=X, at=point, values=values, mean=mean, std=std)
        return display.plot(ax)
