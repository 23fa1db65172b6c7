"""BuildUpDisplay: the tables of a build-up with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp._compute.intervals import check_level
from skdgp._compute.typing import Matrix
from skdgp._display.style import (
    PALETTE,
    ROLES,
    axis_label,
    check_matplotlib,
    display_unit,
    draw_curve,
    legend_of_figure,
    mark_samples,
    scale_beside,
    symbol,
    tidy,
)
from skdgp._effects import Curve
from skdgp.plotting._display import Display, Names, choose

N_PAIRS = 2
"""Tables of two regressors of each coefficient: those with the largest effect, root mean square over the samples."""
N_LEVELS = 3  # contours of the standard deviation


@dataclass(kw_only=True, eq=False, repr=False)
class BuildUpDisplay(Display):
    r"""A row for each coefficient: the effect of each regressor with its band, then its largest tables of two.

    An effect is the derivative and the table of a regressor. Effects and tables of two have mean zero over the samples.
    Panels of effects in a row have the same vertical axis; short lines at their bottom are quantiles of the samples,
    each 4 %. Maps are tables of two regressors; their contours are standard deviations.

    Parameters
    ----------
    curves : dict of (str, str) to Curve
        Effect of each coefficient and regressor: values (n,), SI units and radians, mean and standard deviation (n,).
    maps : dict of str to list
        Largest tables of two of each coefficient: names and values (n,), (m,) of both regressors, mean and standard
        deviation (n, m).
    samples : DataFrame (n, d)
        Regressors of the samples.

    Attributes
    ----------
    lines_, bands_ : lists of artists
        One per panel; None for maps.
    meshes_ : list
        The map of each panel; None for curves.

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

    curves: dict[tuple[str, str], Curve]
    maps: dict[str, list[tuple[tuple[str, str], Matrix, Matrix, Matrix, Matrix]]]
    samples: pd.DataFrame

    def plot(self, ax: Any = None, *, level: float = 0.95, outputs: Names = None, legend: bool = True) -> Self:
        """Draw the panels. See :mod:`skdgp.plotting` for the options."""
        z = norm.ppf(0.5 + 0.5 * check_level(level))
        names, regressors = list(self.maps), list(self.samples.columns)
        rows = [names[i] for i in choose(names, outputs)]
        n_maps = max(len(self.maps[name]) for name in rows)
        keys = [(name, k) for name in rows for k in range(len(regressors) + n_maps)]
        ranges = {name: self._range(name, z) for name in rows}

        def draw(ax, key):
            name, k = key
            tidy(ax)
            if k == 0:
                ax.set_ylabel(symbol(name))
            if k < len(regressors):
                artists = *self._draw_curve(ax, name, regressors[k], level), None
                ax.set_ylim(*ranges[name])
                ax.tick_params(labelleft=k == 0, labelbottom=name == rows[-1])
                if name == rows[-1]:
                    ax.set_xlabel(axis_label(regressors[k]).replace(" [", "\n["))
                return artists
            if k - len(regressors) < len(self.maps[name]):
                return None, None, self._draw_map(ax, *self.maps[name][k - len(regressors)])
            ax.set_visible(False)
            return None, None, None

        size = (max(1.3, 12.0 / (len(regressors) + n_maps)), 1.25)
        n_columns = len(regressors) + n_maps
        widths = {"width_ratios": [1.0] * len(regressors) + [1.5] * n_maps}
        self.lines_, self.bands_, self.meshes_ = self._draw_panels(ax, draw, keys, n_columns, size, gridspec_kw=widths)
        if legend:
            legend_of_figure(self.axes_[0, 0])
        return self

    def _range(self, name, z):
        """Return the limits of the vertical axis of a coefficient."""
        curves = [curve for (coefficient, _), curve in self.curves.items() if coefficient == name]
        low = min(float(np.min(curve.mean - z * curve.std)) for curve in curves)
        high = max(float(np.max(curve.mean + z * curve.std)) for curve in curves)
        edge = 0.08 * (high - low) or 1.0
        return low - edge, high + edge

    def _draw_curve(self, ax, name, regressor, level):
        curve, factor = self.curves[name, regressor], display_unit(regressor)[0]
        ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.6)
        artists = draw_curve(ax, factor * curve.at, curve.mean, curve.std, level, "effect")
        mark_samples(ax, factor * self.samples[regressor])
        ax.locator_params(axis="x", nbins=2, min_n_ticks=2)
        ax.xaxis.set_major_formatter("{x:g}")  # short labels fit narrow panels
        ax.locator_params(axis="y", nbins=4)
        return artists

    def _draw_map(self, ax, regressors, rows, columns, mean, std):
        (first, second), largest = regressors, np.abs(mean).max()
        x, y = display_unit(second)[0] * columns, display_unit(first)[0] * rows
        mesh = ax.pcolormesh(x, y, mean, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="gouraud")
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
        """Read the effects of a build-up, and draw them.

        Raises ValueError if ``n_grid`` is less than 2.

        Parameters
        ----------
        build : BuildUp
            Of :func:`skdgp.export.build_up`, with standard deviations.
        n_grid : int, default=40
            Points of each curve, and of each axis of a map.
        **plot_options
            See :meth:`plot`.
        """
        check_matplotlib(cls.__name__)
        if n_grid < 2:
            raise ValueError(f"Got n_grid={n_grid!r}, but expected at least 2.")
        samples = pd.DataFrame(build.samples, columns=list(build.regressors))
        at = dict(zip(build.regressors, np.linspace(build.limits[0], build.limits[1], n_grid).T, strict=True))
        curves: dict[tuple[str, str], Curve] = {}
        maps: dict[str, list] = {}
        for name, tables in build.tables.items():
            effect = build.effects(name)
            for regressor in build.regressors:
                curves[name, regressor] = Curve(at[regressor], *effect((regressor,), at[regressor][:, None]))
            sizes = {t.regressors: t(samples[list(t.regressors)]).std() for t in tables if len(t.regressors) == 2}
            maps[name] = []
            for pair in sorted(sizes, key=lambda pair: -sizes[pair])[:N_PAIRS]:
                first, second = (at[regressor] for regressor in pair)
                grid = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
                mean, std = (values.reshape(n_grid, n_grid) for values in effect(pair, grid))
                maps[name].append((pair, first, second, mean, std))
        return cls(curves=curves, maps=maps, samples=samples).plot(**plot_options)
