"""Displays of a model: EffectsDisplay and DerivativeDisplay."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import pandas as pd

from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Matrix, Vector
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
    units_shown,
)
from skdgp._effects import Curve, Interaction, effects, interactions
from skdgp._flight.checks import check_choice
from skdgp.plotting._display import Display, Names, choose

OTHERS = ""  # key of the column of terms of several regressors
DEFAULT_DERIVATIVES = (
    "CL_alpha", "CD_alpha", "Cm_alpha", "Cm_q", "CY_beta", "Cl_beta", "Cn_beta", "Cl_p", "Cn_r", "Cm_elevator",
    "Cl_aileron", "Cn_rudder",
)  # fmt: skip


@dataclass(kw_only=True, eq=False, repr=False)
class EffectsDisplay(Display):
    r"""The effect of each regressor with its band: a row for each output, a column for each regressor.

    Panels of a row have the same vertical axis. Short lines at their bottom are quantiles of the
    samples, each 4 %. Bars in the last column are terms of several regressors: the range that holds
    the given probability of their values over the samples, if these are normally distributed.

    The artists are ``lines_``, ``bands_`` and ``bars_``.

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
        The strongest interactions of each output, as `draw_interaction` draws them.

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
    interactions: dict[str, list[Interaction]] = field(default_factory=dict)

    def plot(
        self, ax: Any = None, *, level: float = 0.95, outputs: Names = None, legend: bool = True
    ) -> Self:
        """Draw the panels; see :mod:`skdgp.plotting`."""
        z = half_width(level)
        names = list(self.importance.columns)
        rows = choose(names, outputs)
        several = [name for name in self.importance.index if name not in self.curves]
        columns = [*self.curves, *[OTHERS] * bool(several)]

        def draw(ax, key):
            i, column = key
            if column == columns[0]:
                ax.set_ylabel(symbol(names[i]))
            if column != OTHERS:
                artists = self.draw_effect(ax, names[i], column, level=level)
                if i == rows[-1]:
                    ax.set_xlabel(axis_label(column).replace(" [", "\n["))
                return *artists, None
            ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
            half = z * self.importance.loc[several].iloc[:, i].to_numpy()
            style = {"width": 0.5, "color": PALETTE["purple"], "alpha": 0.6}
            bars = ax.bar(range(len(several)), 2 * half, bottom=-half, **style)
            ax.grid(False, axis="x")
            ax.set_xlim(-0.75, len(several) - 0.25)
            ax.set_xticks(range(len(several)), [plain(name.replace("_", " ")) for name in several])
            ax.tick_params(axis="x", length=0)
            return None, None, bars

        keys = [(i, column) for i in rows for column in columns]
        size = (max(1.25, min(3.0, 9.0 / len(columns))), 1.15)
        artists = self._draw_panels(ax, draw, keys, len(columns), size, sharex="col", sharey="row")
        self.lines_, self.bands_, self.bars_ = artists
        self.figure_.align_labels(self.axes_.ravel())
        if legend:
            legend_of_figure(self.axes_[-1, 0])
        return self

    def draw_effect(
        self, ax: Any, output: str, regressor: str, *, level: float = 0.95
    ) -> tuple[Any, Any]:
        """Draw the effect of a regressor on an output into one Axes, and return its line and band."""
        k = choose(list(self.importance.columns), output)[0]
        curve = self.curves[regressor]
        factor = display_unit(regressor)[0]
        ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
        std = curve.std[:, k]
        artists = draw_curve(ax, factor * curve.at, curve.mean[:, k], std, level, "effect")
        mark_samples(ax, factor * self.samples[regressor].to_numpy())
        ax.locator_params(axis="x", nbins=2, min_n_ticks=2)
        ax.xaxis.set_major_formatter("{x:g}")  # short labels fit narrow panels
        ax.locator_params(axis="y", nbins=4)
        return artists

    def draw_interaction(
        self, ax: Any, output: str, number: int, *, level: float = 0.95, legend: bool = True
    ) -> list[tuple[Any, Any]]:
        """Draw an interaction of an output: the change with one regressor, at two values of the other."""
        found = self.interactions[output][number]
        (first, second), (factor, _) = found.regressors, display_unit(found.regressors[0])
        times, unit = display_unit(second)
        artists = []
        for k, color in enumerate(("blue", "vermillion")):
            label = f"{symbol(second)} = {times * found.levels[k]:.3g} {unit}".rstrip()
            mean, std = found.mean[:, k], found.std[:, k]
            colors = {"color": PALETTE[color], "band": PALETTE[color]}
            artists.append(draw_curve(ax, factor * found.at, mean, std, level, label, **colors))
        ax.locator_params(axis="x", nbins=3, min_n_ticks=2)
        ax.locator_params(axis="y", nbins=4)
        ax.set_xlabel(axis_label(first))
        if legend:
            ax.legend(handles=[line for line, _ in artists], frameon=False, fontsize="small")
        return artists

    @classmethod
    def from_model(
        cls, model: Any, X: Any = None, *, n_grid: int = 30, **plot_options: Any
    ) -> Self:
        """Compute the :func:`skdgp.effects` of a model, and draw them with the options of :meth:`plot`."""
        check_matplotlib(cls.__name__)
        with units_shown(getattr(model, "control_units_", {})):
            return cls.compute(model, X, n_grid=n_grid).plot(**plot_options)

    @classmethod
    def compute(cls, model: Any, X: Any = None, *, n_grid: int = 30) -> Self:
        """Compute the :func:`skdgp.effects` and the interactions of a model, without drawing them."""
        found = effects(model, X, n_grid=n_grid)
        return cls(
            curves=found.curves,
            importance=found.importance,
            samples=found.samples,
            interactions=interactions(model, X),
        )


@dataclass(kw_only=True, eq=False, repr=False)
class DerivativeDisplay(Display):
    """Derivatives with their bands over airspeed, alpha or beta, one panel each.

    The artists are ``lines_`` and ``bands_``.

    Parameters
    ----------
    at, over : (n,), {"airspeed", "alpha", "beta"}
        The points, rising, [m/s] or [rad], and their quantity.
    values, names : (n, k), k names
        The derivatives ``CL_alpha``, ``Cm_q``, ...
    std : (n, k), optional
        Their standard deviations.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, air_velocity, stability_derivatives
    >>> from skdgp.plotting import DerivativeDisplay
    >>> glider = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.5)
    >>> model = Aerodynamics(lambda X: np.sin(X) * [[0.4, 0, -4.5, 0, -0.6, 0]], ["alpha"])
    >>> states = np.zeros((5, 13))
    >>> states[:, 3:6], states[:, 6] = air_velocity(20.0, np.linspace(0, 0.2, 5), 0.0), 1.0
    >>> sweep = stability_derivatives(model, glider, states, {"thrust": 0.0})
    >>> display = DerivativeDisplay.from_sweep(sweep, over="alpha", ax=Figure())
    >>> display.names
    ('CL_alpha', 'CD_alpha', 'Cm_alpha')
    """

    at: Vector
    over: str = "airspeed"
    values: Matrix
    names: tuple[str, ...]
    std: Matrix | None = None

    def plot(self, ax: Any = None, *, level: float = 0.95, legend: bool = True) -> Self:
        """Draw the panels; see :mod:`skdgp.plotting`."""
        at = self.at * display_unit(self.over)[0]

        def draw(ax, k):
            ax.set_ylabel(_label(self.names[k]))
            return draw_curve(
                ax,
                at,
                self.values[:, k],
                None if self.std is None else self.std[:, k],
                level,
                "model",
            )

        keys, options = (
            range(len(self.names)),
            {"xlabel": axis_label(self.over), "legend": legend, "sharex": True},
        )
        artists = self._draw_panels(ax, draw, keys, min(3, len(keys)), (3.2, 1.9), **options)
        self.lines_, self.bands_ = artists
        return self

    @classmethod
    def from_sweep(
        cls,
        sweep: pd.DataFrame,
        *,
        over: str = "airspeed",
        derivatives: Names = None,
        **plot_options: Any,
    ) -> Self:
        """Draw the result of :func:`skdgp.dynamics.stability_derivatives` for several points; see :meth:`plot`.

        ``over`` is "airspeed", "alpha" or "beta", the quantity of the horizontal axis. The
        derivatives are by default the most common ones of the table.
        """
        if not isinstance(sweep.index, pd.MultiIndex):
            raise ValueError(
                "Got derivatives of a single point, but expected those of several: "
                "stability_derivatives(model, "
                "aircraft, [trim, ...])."
            )
        check_choice("over", over, ("airspeed", "alpha", "beta"))
        known = sweep.index.unique(level=1)
        names = (
            [name for name in DEFAULT_DERIVATIVES if name in known]
            if derivatives is None
            else list(derivatives)
        )
        choose(tuple(known), names)
        at = sweep[over].groupby(level=0).first().sort_values()

        def columns(column):
            return (
                sweep[column]
                .unstack(1)
                .reindex(index=at.index, columns=names)
                .to_numpy(dtype=float)
            )

        return cls(
            at=at.to_numpy(dtype=float), values=columns("value"), std=columns("std") if "std" in sweep else None,
            over=over, names=tuple(names),
        ).plot(**plot_options)  # fmt: skip


def _label(name: str) -> str:
    """Return the symbol, such as C_{m_q}, of a derivative."""
    coefficient, _, regressor = name.partition("_")
    below = coefficient.removeprefix("C")
    if not regressor:
        return f"$C_{below}$"
    sign = symbol(regressor)
    index = (
        sign.strip("$")
        if sign.startswith("$")
        else rf"\mathrm{{{plain(regressor)}}}".replace("_", r"\_")
    )
    return f"$C_{{{below}_{{{index}}}}}$"
