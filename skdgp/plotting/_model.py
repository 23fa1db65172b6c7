"""Displays of a model: EffectsDisplay and BuildUpDisplay, CouplingDisplay, DerivativeDisplay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Matrix, Vector
from skdgp._display.style import (
    PALETTE,
    ROLES,
    axis_label,
    check_matplotlib,
    display_unit,
    draw_curve,
    legend_of_figure,
    mark_samples,
    plain,
    scale_beside,
    symbol,
    units_shown,
)
from skdgp._effects import Curve, effects
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice
from skdgp.io import FULL_THROW
from skdgp.plotting._display import Display, Names, choose, names_of, panels

OTHERS = ""  # key of the column of terms of several regressors
N_LEVELS = 3  # contours of the standard deviation
N_PAIRS = 2
"""Tables of two regressors of each coefficient: those with the largest effect, root mean square
over the samples.
"""
DEFAULT_DERIVATIVES = (
    "CL_alpha", "CD_alpha", "Cm_alpha", "Cm_q", "CY_beta", "Cl_beta", "Cn_beta", "Cl_p", "Cn_r", "Cm_elevator",
    "Cl_aileron", "Cn_rudder",
)  # fmt: skip


def _draw_effect(display: EffectsDisplay | BuildUpDisplay, ax, i, name, level, named):
    """Draw the effect of a regressor on output i, and quantiles of the samples."""
    curve, factor = display.curves[name], display_unit(name)[0]
    if named:
        ax.set_xlabel(axis_label(name).replace(" [", "\n["))
    ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
    artists = draw_curve(ax, factor * curve.at, curve.mean[:, i], curve.std[:, i], level, "effect")
    mark_samples(ax, factor * display.samples[name])
    ax.locator_params(axis="x", nbins=2, min_n_ticks=2)
    ax.xaxis.set_major_formatter("{x:g}")  # short labels fit narrow panels
    ax.locator_params(axis="y", nbins=4)
    return artists


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
                return *_draw_effect(self, ax, i, column, level, i == rows[-1]), None
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
        """Compute the :func:`skdgp.effects` of a model, without drawing them."""
        found = effects(model, X, n_grid=n_grid)
        return cls(curves=found.curves, importance=found.importance, samples=found.samples)


@dataclass(kw_only=True, eq=False, repr=False)
class BuildUpDisplay(Display):
    r"""A row for each coefficient: the effect of each regressor with its band, then its largest tables of two.

    An effect is the derivative and the table of a regressor; it is drawn as by `EffectsDisplay`.
    Maps are tables of two regressors; their contours are standard deviations. Effects and maps have
    mean zero over the samples.

    The artists are ``lines_``, ``bands_`` and ``meshes_``, the maps.

    Parameters
    ----------
    curves : dict of str to Curve
        Effect of each regressor: its values (n,), SI units and radians, mean and standard deviation
        (n, P).
    maps : dict of str to list
        Largest tables of two of each coefficient: names and values (n,), (m,) of both regressors,
        mean and standard deviation (n, m).
    samples : DataFrame (n, d)
        Regressors of the samples.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.dynamics import Aircraft
    >>> from skdgp.export import build_up
    >>> from skdgp.plotting import BuildUpDisplay
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-0.1, 0.1, (50, 2)), columns=["alpha", "elevator"])
    >>> Y = pd.DataFrame(X.to_numpy() @ np.ones((2, 6)), columns=["CX", "CY", "CZ", "Cl", "Cm", "Cn"])
    >>> build = build_up(DependentGPRegressor(structure="trend").fit(X, Y), glider)
    >>> display = BuildUpDisplay.from_build_up(build, ax=Figure(), outputs=["CZ", "Cm"])
    >>> display.axes_.shape
    (2, 2)
    """

    curves: dict[str, Curve]
    maps: dict[str, list[tuple[tuple[str, str], Matrix, Matrix, Matrix, Matrix]]]
    samples: pd.DataFrame

    def plot(
        self, ax: Any = None, *, level: float = 0.95, outputs: Names = None, legend: bool = True
    ) -> Self:
        """Draw the panels; see :mod:`skdgp.plotting`."""
        z = half_width(level)
        names, regressors = list(self.maps), list(self.curves)
        rows, n_curves = choose(names, outputs), len(regressors)
        n_maps = max(len(self.maps[names[i]]) for i in rows)

        def draw(ax, key):
            i, k = key
            if k == 0:
                ax.set_ylabel(symbol(names[i]))
            if k < n_curves:
                artists = *_draw_effect(self, ax, i, regressors[k], level, i == rows[-1]), None
                ax.set_ylim(*self._range(i, z))
                ax.tick_params(labelleft=k == 0, labelbottom=i == rows[-1])
                return artists
            if k - n_curves < len(self.maps[names[i]]):
                return None, None, self._draw_map(ax, *self.maps[names[i]][k - n_curves])
            ax.set_visible(False)
            return None, None, None

        keys = [(i, k) for i in rows for k in range(n_curves + n_maps)]
        size = (max(1.3, 12.0 / (n_curves + n_maps)), 1.25)
        widths = {"width_ratios": [1.0] * n_curves + [1.5] * n_maps}
        artists = self._draw_panels(ax, draw, keys, n_curves + n_maps, size, gridspec_kw=widths)
        self.lines_, self.bands_, self.meshes_ = artists
        if legend:
            legend_of_figure(self.axes_[0, 0])
        return self

    def _range(self, i, z):
        """Return the limits of the vertical axis of a coefficient."""
        low = min(
            float(np.min((curve.mean - z * curve.std)[:, i])) for curve in self.curves.values()
        )
        high = max(
            float(np.max((curve.mean + z * curve.std)[:, i])) for curve in self.curves.values()
        )
        edge = 0.08 * (high - low) or 1.0
        return low - edge, high + edge

    def _draw_map(self, ax, regressors, rows, columns, mean, std):
        (first, second), largest = regressors, np.abs(mean).max()
        x, y = display_unit(second)[0] * columns, display_unit(first)[0] * rows
        mesh = ax.pcolormesh(
            x, y, mean, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="gouraud"
        )
        if np.ptp(std) > 0:
            lines = ax.contour(x, y, std, levels=N_LEVELS, colors=ROLES["measured"], linewidths=0.6)
            ax.clabel(lines, fmt="%.1g", fontsize=5)
        scale_beside(ax, mesh, "").ax.tick_params(labelsize=6)
        ax.grid(False)
        ax.set_xlabel(axis_label(second), fontsize="small", labelpad=1)
        ax.set_ylabel(axis_label(first), fontsize="small", labelpad=1)
        ax.tick_params(labelsize=7)
        return mesh

    @classmethod
    def from_build_up(cls, build: Any, *, n_grid: int = 40, **plot_options: Any) -> Self:
        """Draw the effects of a :func:`skdgp.export.build_up` with standard deviations; options of :meth:`plot`.

        Curves and each axis of a map have ``n_grid`` points; ValueError if there are less than 2.
        """
        check_matplotlib(cls.__name__)
        if n_grid < 2:
            raise ValueError(f"Got n_grid={n_grid!r}, but expected at least 2.")
        samples = pd.DataFrame(build.samples, columns=list(build.regressors))
        at = dict(
            zip(
                build.regressors,
                np.linspace(build.limits[0], build.limits[1], n_grid).T,
                strict=True,
            )
        )
        terms = {name: build.effects(name) for name in build.tables}
        curves = {}
        for regressor, points in at.items():
            moments = [term((regressor,), points[:, None]) for term in terms.values()]
            curves[regressor] = Curve(points, *np.stack(moments, axis=-1))
        maps: dict[str, list] = {name: [] for name in terms}
        for name, tables in build.tables.items():
            sizes = {
                t.regressors: t(samples[list(t.regressors)]).std()
                for t in tables
                if len(t.regressors) == 2
            }
            for pair in sorted(sizes, key=lambda pair: -sizes[pair])[:N_PAIRS]:
                first, second = (at[regressor] for regressor in pair)
                grid = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
                mean, std = (values.reshape(n_grid, n_grid) for values in terms[name](pair, grid))
                maps[name].append((pair, first, second, mean, std))
        units = zip(build.regressors, build.units, strict=True)
        with units_shown({name: unit for name, unit in units if unit == FULL_THROW}):
            return cls(curves=curves, maps=maps, samples=samples).plot(**plot_options)


@dataclass(kw_only=True, eq=False, repr=False)
class CouplingDisplay:
    """Heat map of the correlations between outputs, with their values.

    The artists are ``image_``, the coloured cells, ``text_`` (P, P), the written values, and
    ``colorbar_``.

    Parameters
    ----------
    correlation, output_names : (P, P), P names
        Correlations between -1 and 1; NaN where there is none.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CouplingDisplay
    >>> display = CouplingDisplay.from_correlation([[1, -0.4], [-0.4, 1]], output_names=["CZ", "Cm"], ax=Figure())
    >>> display.text_[0, 1].get_text()
    '−0.40'
    """

    correlation: Matrix
    output_names: tuple[str, ...]

    def plot(self, ax: Any = None) -> Self:
        """Draw the heat map into ``ax`` (see :mod:`skdgp.plotting`)."""
        self.ax_ = ax = panels(ax, 1, 1, figsize=(6.2, 4.6))[0, 0]
        self.figure_ = ax.figure
        edges = np.arange(len(self.output_names) + 1) - 0.5
        style = {"cmap": "RdBu_r", "vmin": -1, "vmax": 1, "edgecolors": "white", "linewidth": 1.0}
        self.image_ = ax.pcolormesh(edges, edges, self.correlation, **style)
        self.text_ = np.empty(self.correlation.shape, dtype=object)
        for (i, j), value in np.ndenumerate(self.correlation):
            text = f"{value:z.2f}".replace("-", "−") if np.isfinite(value) else "–"
            style = {
                "ha": "center",
                "va": "center",
                "color": "white" if abs(value) > 0.6 else "black",
            }
            self.text_[i, j] = ax.text(j, i, text, fontsize="small", **style)
        labels = [symbol(name) for name in self.output_names]
        ax.set_xticks(range(len(labels)), labels)
        ax.set_yticks(range(len(labels)), labels)
        ax.invert_yaxis()
        ax.set_aspect("equal")
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        self.colorbar_ = scale_beside(ax, self.image_, "correlation", ticks=[-1, -0.5, 0, 0.5, 1])
        return self

    @classmethod
    def from_correlation(
        cls, correlation: Any, *, output_names: Any = None, **plot_options: Any
    ) -> Self:
        """Draw a correlation matrix (P, P), or what ``output_correlation()`` returns; options of :meth:`plot`."""
        if hasattr(correlation, "correlation"):
            output_names = correlation.output_names if output_names is None else output_names
            correlation = correlation.correlation
        matrix = np.asarray(correlation, dtype=float)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
            raise ValueError(f"Got a correlation of shape {matrix.shape}, but expected (P, P).")
        largest = np.max(np.abs(matrix), where=np.isfinite(matrix), initial=0.0)
        if largest > 1 + 1e-6:
            raise ValueError(
                f"Got correlations up to {largest:.4g} in size, but expected at most 1: divide a "
                f"covariance by the "
                "standard deviations first."
            )
        names = names_of(correlation, len(matrix), output_names, COEFFICIENTS)
        return cls(correlation=matrix, output_names=names).plot(**plot_options)

    @classmethod
    def from_estimator(cls, estimator: Any, **plot_options: Any) -> Self:
        """Draw the ``output_correlation()`` of a fitted regressor, or of a pipeline that ends in one."""
        last = estimator.steps[-1][1] if hasattr(estimator, "steps") else estimator
        return cls.from_correlation(last.output_correlation(), **plot_options)


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
