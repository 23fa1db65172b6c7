"""EnvelopeDisplay: where the data are, and where the model is uncertain."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from skdgp._flight.checks import check_names
from skdgp.plotting._arrays import choose
from skdgp.plotting._style import PALETTE, axis_label, check_matplotlib, display_unit, panels, tidy

PAIRS = (("alpha", "beta"), ("alpha", "elevator"), ("alpha", "q"), ("beta", "r"), ("beta", "rudder"), ("p", "aileron"))
"""What is looked at when nothing is said; a rate may be the non-dimensional one."""
LEVELS = (0.25, 0.5, 0.75)
"""Relative standard deviations that lines are drawn at; above the middle one the panel is hatched."""
SHARES = (0.95, 0.5)
"""Shares of the samples that the light and the dark area hold."""
MARGIN = 0.2
"""How far the panels reach beyond what was flown, relative to it."""
MOST_ROWS = 500
"""Samples over which the variance of what was flown is taken."""
N_BINS = 48
N_CELLS = 64
"""Cells along an axis; of a flight's samples in one cell one dot is drawn, so that none that stands apart is lost."""


class EnvelopeDisplay:
    r"""Pairs of regressors: where samples were flown, how much the model knows there, and where another flight goes.

    Grey areas hold 95 % and 50 % of the samples learned from. Lines and hatches show what the model does not know: its
    posterior standard deviation over that of the function as it was flown,

    .. math::
        \rho(s) = \sqrt{\frac{1}{P} \sum_i \frac{\operatorname{var} f_i(s)}{V_i}}, \quad
        V_i = \operatorname{var}_n[\operatorname{E} f_i(s_n)] + \operatorname{E}_n[\operatorname{var} f_i(s_n)]

    over the samples s_n learned from (the law of total variance) and the P outputs drawn. At 0 a function is known; at
    1 the model knows no more than that it may be any of the values flown, and the normalised RMSE to expect is 1. The
    prior is no such measure: with a trend it is boundless far away, and next to nothing where the trend says all.
    Regressors that a panel does not show are held at their medians.

    Use :meth:`from_estimator`, or :meth:`compute` and :meth:`plot`. All parameters are kept as attributes.

    Parameters
    ----------
    flown : DataFrame (n, d)
        Regressors of the samples learned from, SI units and radians.
    pairs : list of (name, name)
        What the panels show, horizontally and vertically.
    points : list of pairs of ndarray (G,)
        Where the variance was computed, along both axes of each panel.
    variance : ndarray (n_pairs, G, G, P)
        Posterior variance of each output there: second axis vertical, third horizontal.
    flown_variance : ndarray (P,)
        V_i, the variance of each output over what was flown.
    output_names : P names
        The outputs.
    path : DataFrame (m, d), optional
        Regressors of another flight.

    Attributes
    ----------
    axes_ : ndarray of Axes
        The panels.
    figure_ : Figure
        The figure they are in.
    density_, contours_, hatches_ : lists of QuadContourSet
        One per panel.
    paths_ : list of Line2D
        One per panel; None without a path.
    legend_ : Legend or None
        What is what.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.plotting import EnvelopeDisplay
    >>> flown = pd.DataFrame(np.random.default_rng(0).normal(0, 0.05, (60, 2)), columns=["alpha", "beta"])
    >>> model = DependentGPRegressor(n_latent=1, optimizer=None).fit(flown, np.sin(20 * flown["alpha"]))
    >>> display = EnvelopeDisplay.from_estimator(model, flown, ax=Figure())
    >>> display.axes_[0, 0].get_xlabel(), display.axes_[0, 0].get_ylabel()
    ('$\\alpha$ [deg]', '$\\beta$ [deg]')
    >>> rho = display.relative_std()[0]
    >>> bool(rho[8, 8] < rho[0, 0])
    True
    """

    def __init__(self, *, flown, pairs, points, variance, flown_variance, output_names, path=None):
        self.flown = flown
        self.pairs = pairs
        self.points = points
        self.variance = variance
        self.flown_variance = flown_variance
        self.output_names = output_names
        self.path = path

    def relative_std(self, outputs=None) -> np.ndarray:
        """Return the posterior standard deviation relative to that of the function as it was flown, (n_pairs, G, G).

        Parameters
        ----------
        outputs : names, optional
            Over which outputs, default all.

        Returns
        -------
        ndarray (n_pairs, G, G)
            At the points of each pair's grid.
        """
        chosen = choose(self.output_names, outputs)
        return np.sqrt((self.variance[..., chosen] / self.flown_variance[chosen]).mean(axis=-1))

    def plot(self, ax=None, *, pairs=None, outputs=None, legend=True):
        """Draw a panel for each pair.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure. One Axes is divided when there are several panels.
        pairs : list of (name, name), optional
            Which of the pairs to draw, default all.
        outputs : names, optional
            For which outputs the model's knowledge is drawn, default all.
        legend : bool, default=True
            Whether to write what is what above the first panel.

        Returns
        -------
        EnvelopeDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        chosen = self._chosen(pairs)
        relative = self.relative_std(outputs)
        n_cols = min(len(chosen), 3)
        n_rows = -(-len(chosen) // n_cols)
        axes = panels(ax, n_rows, n_cols, figsize=(3.3 * n_cols, 0.5 + 2.9 * n_rows))
        drawn = [self._draw_panel(one, k, relative[k]) for one, k in zip(axes.flat, chosen, strict=False)]
        for unused in axes.flat[len(chosen) :]:
            unused.set_visible(False)
        self.density_, self.contours_, self.hatches_, self.paths_ = (list(kind) for kind in zip(*drawn, strict=True))
        self.axes_, self.figure_ = axes, axes.flat[0].figure
        self.legend_ = _legend(axes.flat[0], self.path is not None) if legend else None
        return self

    def _chosen(self, pairs) -> list[int]:
        wanted = self.pairs if pairs is None else [tuple(pair) for pair in pairs]
        unknown = [pair for pair in wanted if pair not in self.pairs]
        if unknown or not wanted:
            raise ValueError(f"Got the pairs {unknown}, but expected some of {self.pairs}.")
        return [self.pairs.index(pair) for pair in wanted]

    def _draw_panel(self, ax, k, relative):
        names = self.pairs[k]
        factors = [display_unit(name)[0] for name in names]
        x, y = (factor * values for factor, values in zip(factors, self.points[k], strict=True))
        tidy(ax)
        flown = factors * self.flown[list(names)].to_numpy()
        density = _draw_density(ax, *flown.T, (x, y))
        x, y, relative = _smooth(x, y, relative)
        top = max(relative.max(), 1.0)
        hatches = ax.contourf(x, y, relative, levels=[LEVELS[1], top + 1], colors="none", hatches=["////"])
        hatches.set(edgecolor=PALETTE["grey"], linewidth=0.0)
        lines = ax.contour(x, y, relative, levels=LEVELS, colors=PALETTE["blue"], linewidths=(0.7, 1.3, 0.7))
        ax.clabel(lines, fmt="%.2g", fontsize="small", inline_spacing=2)
        path = None
        if self.path is not None:
            dots = _apart(factors * self.path[list(names)].to_numpy(), (x, y))
            (path,) = ax.plot(*dots.T, ".", color=PALETTE["vermillion"], markersize=1.8, markeredgewidth=0)
        ax.set(xlabel=axis_label(names[0]), ylabel=axis_label(names[1]), xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
        return density, lines, hatches, path

    @classmethod
    def from_estimator(cls, estimator, X, *, ax=None, flight=None, pairs=None, n_grid=16, **plot_options):
        """Compute what a fitted estimator knows around its data, and draw.

        Parameters
        ----------
        estimator, X
            See :meth:`compute`.
        ax : Figure, optional
            See :meth:`plot`, as for ``**plot_options``.
        flight, pairs, n_grid
            See :meth:`compute`.
        **plot_options
            See :meth:`plot`.

        Returns
        -------
        EnvelopeDisplay
            The display, drawn.
        """
        check_matplotlib(f"{cls.__name__}.from_estimator")
        display = cls.compute(estimator, X, flight=flight, pairs=pairs, n_grid=n_grid)
        return display.plot(ax, **plot_options)

    @classmethod
    def compute(cls, estimator, X, *, flight=None, pairs=None, n_grid=16):
        """Compute what a fitted estimator knows around its data, without drawing it.

        Parameters
        ----------
        estimator : fitted estimator or Pipeline
            A pipeline with a ``RegressorSelector``, or an estimator fitted on a DataFrame of regressors. It ends in a
            ``DependentGPRegressor``, or in another whose ``predict`` takes ``return_std``.
        X : DataFrame (n, ...)
            What the pipeline or estimator learned from.
        flight : DataFrame (m, ...), optional
            Another flight like X, whose path is drawn.
        pairs : list of (name, name), optional
            Regressors of the panels; default: alpha with beta, elevator and q, beta with r and rudder, p with aileron,
            those that are there, or else neighbouring columns.
        n_grid : int, default=16
            Points along each axis at which the variance is computed.

        Returns
        -------
        EnvelopeDisplay
            The display, not drawn.

        Raises
        ------
        ValueError
            If regressors have no names, or a pair is unknown.
        """
        before, behind, last = _divided(estimator)
        flown = _regressors(before, X)
        path = None if flight is None else _regressors(before, flight)
        pairs = _check_pairs(pairs, list(flown.columns))
        points = [tuple(_reach(flown[name], path, name, n_grid) for name in pair) for pair in pairs]
        rows = pd.concat([_slice(flown, pair, at) for pair, at in zip(pairs, points, strict=True)])
        variance = _moments(last, behind, rows)[1]
        means, variances = _moments(last, behind, flown.iloc[:: -(-len(flown) // MOST_ROWS)])
        return cls(
            flown=flown,
            pairs=pairs,
            points=points,
            variance=variance.reshape(len(pairs), n_grid, n_grid, -1),
            flown_variance=means.var(axis=0) + variances.mean(axis=0),
            output_names=tuple(getattr(last, "output_names_", [f"y{i}" for i in range(means.shape[1])])),
            path=path,
        )


def _divided(estimator):
    """Return what makes regressors, what stands between them and the last step, and that."""
    if not hasattr(estimator, "steps"):
        return None, None, estimator
    place = max((k for k, (_, step) in enumerate(estimator.steps) if hasattr(step, "regressors_")), default=-1) + 1
    last = len(estimator.steps) - 1
    return estimator[:place] if place else None, estimator[place:-1] if place < last else None, estimator[-1]


def _regressors(before, X) -> pd.DataFrame:
    table = X if before is None else before.transform(X)
    if not hasattr(table, "columns"):
        raise ValueError(
            "Got regressors without names, but expected a DataFrame: put RegressorSelector([...]) into the pipeline, "
            "or give X as a DataFrame of regressors."
        )
    return table


def _check_pairs(pairs, names: list[str]) -> list[tuple[str, str]]:
    if pairs is None:
        here = [tuple(name if name in names else f"{name}_hat" for name in pair) for pair in PAIRS]
        known = [pair for pair in here if set(pair) <= set(names)]
        pairs = known or list(pairwise(names))
    pairs = [tuple(pair) for pair in pairs]
    if not pairs or any(len(set(pair)) != 2 for pair in pairs):
        raise ValueError(f"Got pairs={pairs}, but expected pairs of two different regressors out of {names}.")
    check_names(sorted({name for pair in pairs for name in pair}), names, "regressors of the model")
    return pairs


def _reach(flown: pd.Series, path, name, n_grid) -> np.ndarray:
    """Return points along one regressor, a little beyond what was flown."""
    values = flown.to_numpy() if path is None else np.concatenate([flown, path[name]])
    low, high = np.nanmin(values), np.nanmax(values)
    room = MARGIN * ((high - low) or abs(high) or 1.0)
    return np.linspace(low - room, high + room, n_grid)


def _slice(flown: pd.DataFrame, pair, points) -> pd.DataFrame:
    """Return the grid of one panel as rows of regressors, the others at their medians."""
    grid = np.meshgrid(*points)
    columns = {name: np.full(grid[0].size, values.median()) for name, values in flown.items()}
    return pd.DataFrame(columns | {name: values.ravel() for name, values in zip(pair, grid, strict=True)})


def _moments(last, behind, rows):
    """Return mean and variance of the outputs at rows of regressors, (n, P) each."""
    mean, std = last.predict(rows if behind is None else behind.transform(rows), return_std=True)
    return mean.reshape(len(rows), -1), std.reshape(len(rows), -1) ** 2


def _draw_density(ax, x, y, points):
    """Fill the smallest areas that hold the shares of the samples (highest density regions, Hyndman 1996)."""
    edges = [np.linspace(axis[0], axis[-1], N_BINS + 1) for axis in points]
    counts = gaussian_filter(np.histogram2d(x, y, bins=edges)[0], 1.0, mode="constant")
    centres = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    order = np.sort(counts, axis=None)[::-1]
    held = np.cumsum(order) / order.sum()
    levels = [order[np.searchsorted(held, share)] for share in SHARES]
    levels = [level * (1 - 1e-9 * k) for level, k in zip(levels, (2, 1), strict=True)]
    filled = ax.contourf(*centres, counts.T, levels=[*levels, np.inf], colors=[PALETTE["grey"]], extend="neither")
    filled.set(alpha=[0.3, 0.65])
    # Over the dots of another flight, to be seen through them.
    ax.contour(*centres, counts.T, levels=levels[:1], colors="#333333", linewidths=0.9, linestyles="--", zorder=2.5)
    return filled


def _smooth(x, y, values):
    """Return a grid as fine as the picture, by cubic splines: variances of smooth functions are smooth."""
    degree = {"kx": min(3, len(y) - 1), "ky": min(3, len(x) - 1)}
    fine = [np.linspace(axis[0], axis[-1], N_BINS) for axis in (x, y)]
    return *fine, RectBivariateSpline(y, x, values, **degree)(fine[1], fine[0])


def _apart(rows, points) -> np.ndarray:
    """Return one of the rows (n, 2) in each cell of the panel."""
    low = np.array([axis[0] for axis in points])
    high = np.array([axis[-1] for axis in points])
    cells = np.floor(N_CELLS * (rows - low) / (high - low))
    return rows[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _legend(ax, with_path: bool):
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(color=PALETTE["grey"], alpha=0.65, label="half the samples"),
        Patch(facecolor="#8A8A8A4D", edgecolor="#333333", linestyle="--", label="95 % of them"),
        Line2D([], [], color=PALETTE["blue"], linewidth=1.3, label="relative uncertainty"),
        Patch(facecolor="none", edgecolor=PALETTE["grey"], hatch="////", linewidth=0, label="hardly known"),
    ]
    if with_path:
        style = {"color": PALETTE["vermillion"], "marker": ".", "linestyle": "none"}
        handles.append(Line2D([], [], label="other flight", **style))
    roomy = isinstance(ax.figure.get_layout_engine(), ConstrainedLayoutEngine)
    where = {"loc": "outside upper left"} if roomy else {"loc": "upper left"}
    return ax.figure.legend(handles=handles, ncols=5, frameon=False, fontsize="small", **where)
