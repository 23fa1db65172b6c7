"""Effects of a fitted model: how each regressor changes each output, its strongest interactions, and their display."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.typing import Array, Matrix, Vector
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

JOINT = "joint"  # name of the term of all regressors


@dataclass(frozen=True)
class EffectSettings:
    """Numbers of effects and interactions, and of their display."""

    # Samples over which effects are centred, and over which interactions are compared
    rows: int = 1000
    interaction_rows: int = 60
    # Quantiles of a regressor between which its effect is computed
    range: tuple[float, float] = (0.01, 0.99)
    # Quantiles of the second regressor of an interaction
    levels: tuple[float, float] = (0.05, 0.95)
    # Points of a curve, and of a curve of an interaction
    points: int = 30
    interaction_points: int = 15
    # Shown for each output: regressors whose effects vary most over the samples, and interactions
    effects: int = 4
    interactions: int = 2


SETTINGS = EffectSettings()


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
        parts = _split_model(self._model)
        for step in parts.before:
            X = step.transform(X)
        X = parts.regressor._check_regressors(X)  # noqa: SLF001
        means = {}
        stds = {}
        for name, term in self._terms.items():
            mean, variance = term.predict(X)
            means[name] = mean * parts.scale
            stds[name] = np.sqrt(variance) * parts.scale
        return means, stds


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
    parts = _split_model(model)
    rows = parts.samples(SETTINGS.rows)
    terms = {}
    intercept: Any = 0.0
    for columns in parts.posterior.kernel.term_regressors():
        term = CentredTerm(parts.posterior, columns, rows)
        intercept = intercept + term.values.mean(axis=0)
        if len(columns):  # else the constant
            terms[_name(columns, parts.names)] = term
    importance = {name: term.values.std(axis=0) * parts.scale for name, term in terms.items()}
    curves = {}
    for k, name in enumerate(parts.names):
        if name in terms:
            curves[name] = _curve(parts, rows, terms[name], k)
    outputs = parts.regressor.output_names_
    return Effects(
        intercept=parts.regressor.center_ + intercept * parts.scale,
        importance=pd.DataFrame.from_dict(importance, orient="index", columns=outputs),
        curves=curves,
        samples=pd.DataFrame(parts.in_units(rows), columns=parts.names),
        _model=model,
        _terms=terms,
    )


def _curve(parts: _Parts, rows: Matrix, term: CentredTerm, k: int) -> Curve:
    """Return the effect of regressor k, from its 1 % to its 99 % quantile."""
    low, high = np.quantile(rows[:, k], SETTINGS.range)
    points = np.tile(rows.mean(axis=0), (SETTINGS.points, 1))
    points[:, k] = np.linspace(low, high, SETTINGS.points)
    mean, variance = term.predict(points)
    return Curve(parts.in_units(points)[:, k], mean * parts.scale, np.sqrt(variance) * parts.scale)


def interactions(model: BaseEstimator) -> dict[str, list[Interaction]]:
    r"""Return the two strongest interactions of two regressors on each output, the strongest first.

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
    >>> interactions(model)["Cm"][0].regressors
    ('alpha', 'q')
    """
    parts = _split_model(model)
    rows = parts.samples(SETTINGS.interaction_rows)
    pairs = list(combinations(range(len(parts.names)), 2))
    shares = _shares(parts, rows, pairs)
    strongest = {}
    for k, output in enumerate(parts.regressor.output_names_):
        order = np.argsort(-shares[:, k], kind="stable")[: SETTINGS.interactions]
        of_output = [_interaction(parts, rows, pairs[n], k, float(shares[n, k])) for n in order]
        strongest[str(output)] = of_output
    return strongest


def _shares(parts: _Parts, rows: Matrix, pairs: list[tuple[int, int]]) -> Matrix:
    """Return the root mean square over the rows of the interaction of pairs, (n_pairs, P)."""
    centre = rows.mean(axis=0)

    def moved(*columns: int) -> Matrix:
        """Return the mean with some regressors as in the rows, the others at their centre."""
        points = np.tile(centre, (len(rows), 1))
        points[:, columns] = rows[:, columns]
        return parts.posterior.predict(points)

    alone = [moved(k) for k in range(len(centre))]
    origin = parts.posterior.predict(centre[None])
    shares = np.zeros((len(pairs), len(parts.scale)))
    for n, (i, j) in enumerate(pairs):
        term = moved(i, j) - alone[i] - alone[j] + origin
        shares[n] = np.sqrt(np.mean(term**2, axis=0))
    return shares * parts.scale


def _interaction(
    parts: _Parts, rows: Matrix, pair: tuple[int, int], output: int, share: float
) -> Interaction:
    """Return how an output moves with the first of two regressors at two values of the second."""
    first, second = pair
    low, high = np.quantile(rows[:, first], SETTINGS.range)
    n = SETTINGS.interaction_points
    # A curve for each level, behind its origin
    points = np.tile(rows.mean(axis=0), (2, n + 1, 1))
    points[:, 1:, first] = np.linspace(low, high, n)
    points[:, :, second] = np.quantile(rows[:, second], SETTINGS.levels)[:, None]
    mean, variance = _changes(parts.posterior, points, output)
    units = parts.in_units(points)
    scale = parts.scale[output]
    return Interaction(
        regressors=(parts.names[first], parts.names[second]),
        at=units[0, 1:, first],
        levels=units[:, 0, second],
        mean=scale * mean.T,
        std=scale * np.sqrt(np.maximum(variance, 0.0)).T,
        share=share,
    )


def _changes(posterior: Any, curves: Array, output: int) -> tuple[Matrix, Matrix]:
    """Return mean and variance of an output on curves (k, 1 + n, d) less its value at their origins, (k, n) each."""
    k, n, d = curves.shape
    points = curves.reshape(k * n, d)
    block = slice(output * k * n, (output + 1) * k * n)
    value = posterior.predict(points)[:, output].reshape(k, n)
    cov = posterior.covariance(points)[block, block].reshape(k, n, k, n)
    of_curves = np.einsum("iaib->iab", cov)
    with_origin = of_curves[:, 1:, 0]
    variance = np.einsum("iaa->ia", of_curves)[:, 1:] + of_curves[:, :1, 0] - 2 * with_origin
    return value[:, 1:] - value[:, :1], variance


class _Parts(NamedTuple):
    """Regressor of a model, the steps before it, and the scaling to the units before the scalers at their end."""

    regressor: DependentGPRegressor
    before: list[Any]
    names: list[str]
    shift: Vector
    factor: Vector

    @property
    def posterior(self) -> Any:
        """The posterior of the scaled outputs."""
        return self.regressor.posterior_

    @property
    def scale(self) -> Vector:
        """The scales of the outputs (P,)."""
        return self.regressor.scale_

    def samples(self, most: int) -> Matrix:
        """Return at most so many rows of the training data."""
        rows = training_inputs(self.posterior)
        return rows[:: -(-len(rows) // most)]

    def in_units(self, points: Array) -> Array:
        """Return regressors (..., d) in the units before the scalers."""
        return self.shift + self.factor * points


def _split_model(model: Any) -> _Parts:
    """Return the parts of a regressor, or of a pipeline that ends in one."""
    steps = [step for _, step in model.steps] if isinstance(model, Pipeline) else [model]
    regressor = steps.pop()
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__}, but expected a fitted "
            "DependentGPRegressor, or a pipeline that ends in one."
        )
    check_is_fitted(regressor)
    names = regressor._regressor_names()  # noqa: SLF001
    d = len(names)
    before = [step for step in steps if step not in (None, "passthrough")]
    scalers = _scalers_at_end(before, d)
    if scalers:
        names = list(map(str, getattr(scalers[0], "feature_names_in_", names)))
    shift, factor, _ = scaling_of(scalers, d)
    return _Parts(regressor, before, names, shift, factor)


def _scalers_at_end(steps: list[Any], d: int) -> list[Any]:
    """Return the scalers behind all other steps."""
    n_others = len(steps)
    while n_others and not scaling_of(steps[n_others - 1 : n_others], d)[2]:
        n_others -= 1
    return steps[n_others:]


def _name(columns: tuple[int, ...], names: list[str]) -> str:
    """Return the name of the term of some regressors."""
    if len(columns) == len(names) > 1:
        return JOINT
    return ", ".join(names[k] for k in columns)


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
        sizes = self.importance.loc[list(self.curves), output]
        return list(sizes.nlargest(SETTINGS.effects).index)

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
        # short labels fit narrow panels
        ax.xaxis.set_major_formatter("{x:g}")
        ax.ticklabel_format(axis="y", scilimits=(-3, 4))
        ax.set_ylabel(symbol(output))

    def _draw_effect(self, ax: Any, output: str, name: str) -> None:
        k = list(self.importance).index(output)
        curve = self.curves[name]
        factor, _ = display_unit(name)
        draw_curve(ax, factor * curve.at, curve.mean[:, k], curve.std[:, k], "effect")
        quantiles = factor * self.samples[name].quantile(np.linspace(0.02, 0.98, 25))
        ax.plot(
            quantiles, np.full(len(quantiles), 0.03), "|", label="samples", color=ROLES["measured"],
            markersize=4, markeredgewidth=0.5, transform=ax.get_xaxis_transform(),
        )  # fmt: skip
        shown = [self.curves[other] for other in self._largest(output)]  # on one scale
        tops = [np.abs(c.mean[:, k]).max() + BAND * c.std[:, k].min() for c in shown]
        top = 1.08 * max(0.0, *tops)
        ax.set_ylim(-top, top)
        ax.set_xlabel(axis_label(name))

    def _draw_interaction(self, ax: Any, interaction: Interaction) -> None:
        first, second = interaction.regressors
        factor, _ = display_unit(first)
        level_factor, unit = display_unit(second)
        values = factor * interaction.at
        for k, color in enumerate((PALETTE["blue"], PALETTE["vermillion"])):
            level = level_factor * interaction.levels[k]
            label = f"{symbol(second)} = {level:.3g} {unit}".rstrip()
            draw_curve(
                ax, values, interaction.mean[:, k], interaction.std[:, k], label, color, color
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
