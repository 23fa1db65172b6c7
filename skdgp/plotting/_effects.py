"""Effects of a fitted model: how each regressor changes each output, its strongest interactions, and their display."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, takewhile
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.page import (
    PALETTE,
    ROLES,
    axis_label,
    display_unit,
    draw_curve,
    symbol,
    units_shown,
)
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import scaling_of
from skdgp.inference import CentredTerm, training_inputs
from skdgp.plotting._display import BAND, Display

MAX_ROWS = 1000  # samples over which effects are centred
RANGE = (0.01, 0.99)  # quantiles of a regressor between which its effect is computed
JOINT = "joint"  # name of the term of all regressors
LEVELS = (0.05, 0.95)  # quantiles of the second regressor of an interaction
N_SAMPLES = 60  # samples over which interactions are compared
N_GRID = 30  # points of each curve


class Curve(NamedTuple):
    """Effect of one regressor: its values (n,), and mean and standard deviation (n, P) in units of the outputs."""

    at: Vector
    mean: Matrix
    std: Matrix


class Interaction(NamedTuple):
    """How the effect of one regressor on an output depends on another.

    ``mean`` and ``std`` (n, 2) are f(x, z) - f(x0, z) over the values ``at`` (n,) of x, at the low
    and the high value ``levels`` (2,) of z; x0 and all others are means of the samples. ``share``
    is the root mean square of the interaction over the samples, in units of the output.
    """

    regressors: tuple[str, str]
    at: Vector
    levels: Vector
    mean: Matrix
    std: Matrix
    share: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Effects:
    """Independent terms of a fitted model; with the intercept their means add up to its mean.

    Attributes
    ----------
    intercept : ndarray (P,)
        Mean of the predictions over the samples.
    importance : DataFrame (n_terms, P)
        Standard deviation over the samples of the mean of each term, in units of the outputs.
    curves : dict of str to Curve
        Effect of each regressor that has a term of its own, from its 1 % to its 99 % quantile, in
        its unit before scaling by the pipeline.
    samples : DataFrame (n, d)
        The samples over which the effects have mean zero, at most 1000, in the same units.
    """

    intercept: Vector
    importance: pd.DataFrame
    curves: dict[str, Curve]
    samples: pd.DataFrame
    _model: Any
    _terms: dict[str, Any]

    def evaluate(self, X: Any) -> tuple[dict[str, Matrix], dict[str, Matrix]]:
        """Return means and standard deviations (n, P) of the terms, at input X of the model, by name.

        The sum of the means and ``intercept`` is the predicted mean.
        """
        regressor, before, _, _ = _split_model(self._model)
        for step in before:
            X = step.transform(X)
        X = regressor._check_regressors(X)
        moments = {name: term.predict(X) for name, term in self._terms.items()}
        mean = {name: values * regressor.scale_ for name, (values, _) in moments.items()}
        return mean, {name: np.sqrt(x) * regressor.scale_ for name, (_, x) in moments.items()}


def effects(model: BaseEstimator) -> Effects:
    r"""Return the effect of each regressor on each output, and of the joint term, with standard deviations.

    The kernel of the model is a sum of terms: a line in each regressor (``trend="linear"``), a
    process of each (``structure="additive"``), processes of few (``ConvolvedGaussian(regressors=[0,
    1])``), and the joint processes. Terms of the same regressors are one effect. With the
    covariance :math:`K_t` of a term, and C of the measured values y, it has the mean
    :math:`K_t(X_*, X) C^{-1} y` and the covariance :math:`K_t(X_*, X_*) - K_t(X_*, X) C^{-1} K_t(X,
    X_*)` (Duvenaud, Nickisch & Rasmussen 2011, "Additive Gaussian processes"; Plate 1999). Every
    effect has mean zero over the samples, so that

    .. math:: \mathrm{E}\, y(x) = \mathrm{intercept} + \sum_t \mathrm{effect}_t(x).

    With ``structure="trend"`` effects are straight lines. With ``"joint"`` they are straight lines,
    and the term "joint" holds the rest. Terms share the data, so where regressors move together in
    the samples their bands are wide, though the sum is known. Raises TypeError if the model is not
    a ``DependentGPRegressor``, nor a pipeline that ends in one; NotFittedError if the model is not
    fitted.

    Parameters
    ----------
    model : DependentGPRegressor or Pipeline
        Fitted; a pipeline ends in a ``DependentGPRegressor``. ``StandardScaler``, ``MinMaxScaler``
        (without ``clip``), ``MaxAbsScaler`` and ``RobustScaler`` before it are undone in the
        result; behind other transformers regressors keep the transformed units and names.

    Returns
    -------
    Effects
        ``curves`` by the name of the regressor, ``importance``, ``intercept``, and ``evaluate(X)``
        for any points.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp import DependentGPRegressor, effects
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-1, 1, (60, 2)), columns=["alpha", "elevator"])
    >>> Y = pd.DataFrame({"Cm": np.sin(2 * X["alpha"]) - 0.5 * X["elevator"]})
    >>> model = DependentGPRegressor(structure="additive", n_latent=0, max_iter=20, random_state=0).fit(X, Y)
    >>> found = effects(model)
    >>> list(found.curves), list(found.importance.index)
    (['alpha', 'elevator'], ['alpha', 'elevator', 'joint'])
    >>> bool(np.allclose(sum(found.evaluate(X)[0].values()) + found.intercept, model.predict(X)))
    True
    """
    regressor, _, (shift, factor), names = _split_model(model)
    rows = training_inputs(regressor.posterior_)
    rows = rows[:: -(-len(rows) // MAX_ROWS)]
    units = pd.DataFrame(shift + factor * rows, columns=names)
    posterior, scale = regressor.posterior_, regressor.scale_
    columns = posterior.kernel.term_regressors()
    terms = {
        _name(regressors, names): CentredTerm(posterior, regressors, rows) for regressors in columns
    }
    intercept = sum(term.values.mean(axis=0) for term in terms.values())
    terms.pop("", None)  # the constant
    curves = {}
    for k, name in enumerate(names):
        if name in terms:
            points = np.tile(rows.mean(axis=0), (N_GRID, 1))
            low, high = np.quantile(rows[:, k], RANGE)
            points[:, k] = np.linspace(low, high, N_GRID)
            mean, variance = terms[name].predict(points)
            at = shift[k] + factor[k] * points[:, k]
            curves[name] = Curve(at, mean * scale, np.sqrt(variance) * scale)
    importance = {name: term.values.std(axis=0) * scale for name, term in terms.items()}
    return Effects(
        intercept=regressor.center_ + intercept * scale,
        importance=pd.DataFrame.from_dict(
            importance, orient="index", columns=regressor.output_names_
        ),
        curves=curves,
        samples=units,
        _model=model,
        _terms=terms,
    )


def interactions(
    model: BaseEstimator, *, most: int = 2, n_grid: int = 15
) -> dict[str, list[Interaction]]:
    r"""Return the ``most`` strongest interactions of two regressors on each output, the strongest first.

    Around the mean c of the samples, regressors i and j interact by the second-order term of
    cut-HDMR (Rabitz & Alis 1999),

    .. math:: I(x_i, x_j) = f(x_i, x_j) - f(x_i, c_j) - f(c_i, x_j) + f(c_i, c_j),

    with all other regressors at c. It is zero where the model is a sum of functions of single
    regressors. For arguments and errors see `effects`.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.plotting._effects import interactions
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-1, 1, (80, 3)), columns=["alpha", "q", "r"])
    >>> model = DependentGPRegressor(n_latent=0, max_iter=20).fit(X, pd.DataFrame({"Cm": X["alpha"] * X["q"]}))
    >>> interactions(model, most=1)["Cm"][0].regressors
    ('alpha', 'q')
    """
    regressor, _, (shift, factor), names = _split_model(model)
    rows = training_inputs(regressor.posterior_)
    rows = rows[:: -(-len(rows) // N_SAMPLES)]
    posterior, scale = regressor.posterior_, regressor.scale_
    centre = rows.mean(axis=0)

    def moved(columns):
        points = np.tile(centre, (len(rows), 1))
        points[:, columns] = rows[:, columns]
        return posterior.predict(points)

    alone = [moved([k]) for k in range(len(names))]
    origin = posterior.predict(centre[None])
    pairs = list(combinations(range(len(names)), 2))
    sizes = np.zeros((len(pairs), len(scale)))
    for row, (i, j) in zip(sizes, pairs, strict=True):
        row[:] = np.sqrt(np.mean((moved([i, j]) - alone[i] - alone[j] + origin) ** 2, axis=0))
    found = {}
    for k, output in enumerate(regressor.output_names_):
        strongest = np.argsort(-sizes[:, k], kind="stable")[:most]
        found[str(output)] = [
            _interaction(
                posterior, rows, pairs[n], k, n_grid, names, shift, factor, scale[k]
            )._replace(share=float(sizes[n, k] * scale[k]))
            for n in strongest
        ]
    return found


def _interaction(posterior, rows, pair, output, n_grid, names, shift, factor, scale) -> Interaction:
    """Return how an output moves with the first of two regressors at two values of the second."""
    first, second = pair
    low, high = np.quantile(rows[:, first], RANGE)
    grid = np.linspace(low, high, n_grid)
    levels = np.quantile(rows[:, second], LEVELS)
    points = np.tile(rows.mean(axis=0), (2, n_grid + 1, 1))
    points[:, 1:, first] = grid  # the first row of each level is the origin of its curve
    points[:, :, second] = levels[:, None]
    flat = points.reshape(-1, points.shape[2])
    n = len(flat)
    mean = posterior.predict(flat)[:, output].reshape(2, -1)
    block = slice(output * n, (output + 1) * n)
    cov = posterior.covariance(flat)[block, block].reshape(2, n_grid + 1, 2, n_grid + 1)
    cov = np.stack([cov[0, :, 0], cov[1, :, 1]])
    variance = np.einsum("lnn->ln", cov) + cov[:, :1, 0] - 2 * cov[:, :, 0]
    units = shift + factor * points
    return Interaction(
        regressors=(names[first], names[second]),
        at=units[0, 1:, first],
        levels=units[:, 0, second],
        mean=scale * (mean - mean[:, :1])[:, 1:].T,
        std=scale * np.sqrt(np.maximum(variance, 0.0))[:, 1:].T,
        share=np.nan,
    )


def _split_model(model):
    """Return the regressor, the steps before it, shift and scale of the scalers at their end, the regressors' names."""
    steps = [step for _, step in model.steps] if isinstance(model, Pipeline) else [model]
    regressor = steps.pop()
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__}, but expected a fitted DependentGPRegressor, or a "
            f"pipeline that ends in one."
        )
    check_is_fitted(regressor)
    names = regressor._regressor_names()
    steps = [step for step in steps if step not in (None, "passthrough")]
    d = len(names)
    scalers = list(takewhile(lambda step: not scaling_of([step], d)[2], reversed(steps)))[::-1]
    if scalers:
        names = list(map(str, getattr(scalers[0], "feature_names_in_", names)))
    return regressor, steps, scaling_of(scalers, d)[:2], names


def _name(columns, names):
    """Return the name of the term of some regressors; empty for a constant."""
    return JOINT if len(columns) == len(names) > 1 else ", ".join(names[k] for k in columns)


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
        return [
            (output, key)
            for output in map(str, self.importance)
            for key in (*self._largest(output), *range(len(self.interactions.get(output, ()))))
        ]

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
        ax.plot(
            quantiles, np.full(len(quantiles), 0.03), "|", label="samples", color=ROLES["measured"],
            markersize=4, markeredgewidth=0.5, transform=ax.get_xaxis_transform(),
        )  # fmt: skip
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
