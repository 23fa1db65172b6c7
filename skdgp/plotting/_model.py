"""Displays of a model: the effects of its regressors, and where it was learned and is uncertain."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.predicting import accepts
from skdgp._compute.typing import Array, Matrix, Vector
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


PAIRS = (
    ("alpha", "beta"),
    ("alpha", "elevator"),
    ("alpha", "q"),
    ("beta", "r"),
    ("beta", "rudder"),
    ("p", "aileron"),
)  # default panels; a rate may be the non-dimensional one
LEVELS = (0.25, 0.5, 0.75)  # relative standard deviations at which contours are drawn
MARGIN = 0.2  # margin of the panels around the flown range, relative to it
MAX_ROWS = 500  # samples for the variance of the function as flown
N_CELLS = 64  # cells along an axis, each with at most one dot of a flight


@dataclass(kw_only=True, eq=False, repr=False)
class EnvelopeDisplay(Display):
    r"""Pairs of regressors: the training samples, the uncertainty of the model there, and another flight.

    Contours show the relative uncertainty, the posterior standard deviation over the spread of the
    function as it was flown,

    .. math::
        \rho(s) = \sqrt{\frac{1}{P} \sum_i \frac{\operatorname{var} f_i(s)}{V_i}}, \quad
        V_i = \operatorname{var}_n[\operatorname{E} f_i(s_n)] +
        \operatorname{E}_n[\operatorname{var} f_i(s_n)]

    over the training samples s_n (the law of total variance) and the P outputs drawn. At 0 the
    function is known; at 1 the expected normalised RMSE is 1, as of predicting the mean. Regressors
    that a panel does not show have their medians.

    Parameters
    ----------
    flown, path : DataFrame (n, d), DataFrame (m, d) or None
        Regressors of the training samples and of another flight, SI units and radians.
    pairs, points : list of (name, name), list of pairs of ndarray (G,)
        Horizontal and vertical regressor of each panel, and the grid along both.
    relative_std : ndarray (n_pairs, G, G)
        rho on the grid: second axis vertical, third horizontal.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.plotting import EnvelopeDisplay
    >>> flown = pd.DataFrame(np.random.default_rng(0).normal(0, 0.05, (60, 2)), columns=["alpha", "beta"])
    >>> model = DependentGPRegressor(n_latent=1, optimizer=None).fit(flown, np.sin(20 * flown["alpha"]))
    >>> display = EnvelopeDisplay.from_estimator(model, flown, ax=Figure())
    >>> rho = display.relative_std[0]
    >>> bool(rho[8, 8] < rho[0, 0])
    True
    """

    flown: pd.DataFrame
    path: pd.DataFrame | None = None
    pairs: list[tuple[str, str]]
    points: list[tuple[Vector, Vector]]
    relative_std: Array
    size = (2.9, 2.45)
    n_columns = 3

    @property
    def keys(self) -> list[tuple[str, str]]:
        """The pairs of regressors."""
        return self.pairs

    def words(self, key: tuple[str, str]) -> str:
        """Return what a panel shows."""
        return f"{key[1]} against {key[0]}: where samples were flown, and how uncertain the model is there"

    def draw(self, ax: Any, key: tuple[str, str]) -> None:
        """Draw contours and samples of a pair."""
        k = self.pairs.index(key)
        factors = np.array([display_unit(name)[0] for name in key])
        axes = [factor * axis for factor, axis in zip(factors, self.points[k], strict=True)]
        rho = self.relative_std[k]
        levels = [0.0, *LEVELS, max(1.0, rho.max())]
        ax.contourf(*axes, rho, levels, cmap="Blues", alpha=0.6)
        lines = ax.contour(*axes, rho, LEVELS, colors=PALETTE["blue"], linewidths=0.8)
        ax.clabel(lines, fmt="%.2g", fontsize="small")
        for table, color, label in (
            (self.flown, "#333333", "learned from"),
            (self.path, PALETTE["vermillion"], "other flight"),
        ):
            if table is not None:
                dots = _occupied(factors * table[list(key)].to_numpy(), axes)
                style = {"marker": ".", "markersize": 2, "markeredgewidth": 0, "color": color}
                ax.plot(*dots.T, linestyle="none", label=label, **style)
        ax.set(xlabel=axis_label(key[0]), ylabel=axis_label(key[1]))
        ax.set(xlim=axes[0][[0, -1]], ylim=axes[1][[0, -1]])

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, *, flight: Any = None, n_grid: int = 16, ax: Any = None
    ) -> Self:
        """Draw the uncertainty of a fitted estimator around its training data X.

        The estimator, or the pipeline that ends in it, takes a DataFrame of regressors; its
        ``predict`` takes ``return_std``. X and ``flight``, another one to draw, are such tables: of
        an identification pipeline give ``model[-2:]`` and ``model[:-2].transform(table)``. The
        panels are alpha with beta, elevator and q, beta with r and rudder, p with aileron, where
        present, or else neighbouring columns. Grids have ``n_grid`` points along each axis. Raises
        ValueError if regressors have no names.
        """
        if not hasattr(X, "columns"):
            raise ValueError("Got regressors without names, but expected X as a DataFrame.")
        pairs = _pairs(list(X))
        both = pd.concat([X, flight])
        points = [(_grid(both[x], n_grid), _grid(both[y], n_grid)) for x, y in pairs]
        means, variances = _moments(estimator, X.iloc[:: -(-len(X) // MAX_ROWS)])
        as_flown = means.var(axis=0) + variances.mean(axis=0)
        rows = pd.concat([_slice(X, *panel) for panel in zip(pairs, points, strict=True)])
        ratio = (_moments(estimator, rows)[1] / as_flown).mean(axis=1)
        rho = np.sqrt(ratio).reshape(len(pairs), n_grid, n_grid)
        return cls(flown=X, path=flight, pairs=pairs, points=points, relative_std=rho).plot(ax)


def _occupied(values: Matrix, axes: Any) -> Matrix:
    """Return one sample of each occupied cell of a panel, so that isolated samples remain."""
    low, high = np.transpose([axis[[0, -1]] for axis in axes])
    values = values[np.isfinite(values).all(axis=1)]
    cells = np.floor(N_CELLS * (values - low) / (high - low))
    return values[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _pairs(names: list[str]) -> list[tuple[str, str]]:
    """Return the usual pairs of regressors among the names, or else neighbouring ones."""

    def regressor(name: str) -> str:
        return name if name in names else f"{name}_hat"

    pairs = [(regressor(x), regressor(y)) for x, y in PAIRS]
    return [pair for pair in pairs if set(pair) <= set(names)] or list(pairwise(names))


def _grid(values: pd.Series, n_grid: int) -> Vector:
    """Return points along one regressor, over the flown range and a margin."""
    low, high = values.min(), values.max()
    room = MARGIN * ((high - low) or abs(high) or 1.0)
    return np.linspace(low - room, high + room, n_grid)


def _slice(
    flown: pd.DataFrame, pair: tuple[str, str], points: tuple[Vector, Vector]
) -> pd.DataFrame:
    """Return the grid of one panel as rows of regressors, with the medians of the others."""
    grid = np.meshgrid(*points)
    rows = pd.DataFrame({name: np.full(grid[0].size, flown[name].median()) for name in flown})
    return rows.assign(**{name: axis.ravel() for name, axis in zip(pair, grid, strict=True)})


def _moments(predictor: Any, rows: pd.DataFrame) -> tuple[Matrix, Matrix]:
    """Return mean and variance of the outputs at rows of regressors, (n, P) each."""
    last = getattr(predictor, "steps", [("", predictor)])[-1][1]
    exact = {"include_input_noise": False} if accepts(last, "include_input_noise") else {}
    mean, std = predictor.predict(rows, return_std=True, **exact)
    return mean.reshape(len(rows), -1), std.reshape(len(rows), -1) ** 2
