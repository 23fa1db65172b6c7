"""DerivativeDisplay: stability derivatives over speed or angle of attack."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp.plotting._arrays import choose
from skdgp.plotting._comparison import check_level
from skdgp.plotting._style import (
    ROLES,
    axis_label,
    check_matplotlib,
    display_unit,
    legend_above,
    panels,
    plain,
    symbol,
    tidy,
)

USUAL = (
    "CL_alpha", "CD_alpha", "Cm_alpha", "Cm_q", "CY_beta", "Cl_beta", "Cn_beta", "Cl_p", "Cn_r", "Cm_elevator",
    "Cl_aileron", "Cn_rudder",
)  # fmt: skip
OVER = ("airspeed", "alpha", "beta")


class DerivativeDisplay:
    """Derivatives with their bands over airspeed, alpha or beta, one panel each.

    Use :meth:`from_sweep`. All parameters are kept as attributes.

    Parameters
    ----------
    at : (n,)
        Airspeed [m/s] or angle [rad] of the points, rising.
    values : (n, k)
        The derivatives.
    names : k names
        ``CL_alpha``, ``Cm_q``, ...
    over : {"airspeed", "alpha", "beta"}
        What ``at`` is.
    std : (n, k), optional
        Their standard deviations.
    truth : (n, k), optional
        Known ones; NaN where there is none.

    Attributes
    ----------
    axes_ : ndarray of Axes
        The panels.
    figure_ : Figure
        The figure they are in.
    lines_, bands_, truth_ : lists of artists
        One per panel drawn; None where there was nothing to draw.

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

    def __init__(self, *, at, values, names, over="airspeed", std=None, truth=None):
        self.at = at
        self.values = values
        self.names = names
        self.over = over
        self.std = std
        self.truth = truth

    def plot(self, ax=None, *, derivatives=None, level=0.95, legend=True):
        """Draw the panels.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure.
        derivatives : names, optional
            Which to draw, default all.
        level : float, default=0.95
            Probability of the bands.
        legend : bool, default=True
            Whether to write what is what above the first panel.

        Returns
        -------
        DerivativeDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        reach = norm.ppf(0.5 + 0.5 * check_level(level))
        chosen = choose(self.names, derivatives)
        n_cols = min(3, len(chosen))
        n_rows = -(-len(chosen) // n_cols)
        axes = panels(ax, n_rows, n_cols, figsize=(3.2 * n_cols, 0.8 + 1.9 * n_rows), sharex=True)
        drawn = [self._draw_panel(one, k, reach, level) for one, k in zip(axes.flat, chosen, strict=False)]
        for unused in axes.flat[len(chosen) :]:
            unused.set_visible(False)
        for bottom in axes[-1]:
            bottom.set_xlabel(axis_label(self.over))
        self.lines_, self.bands_, self.truth_ = (list(kind) for kind in zip(*drawn, strict=True))
        self.axes_, self.figure_ = axes, axes.flat[0].figure
        if legend:
            legend_above(axes.flat[0])
        return self

    def _draw_panel(self, ax, k, reach, level):
        at, values = self.at * display_unit(self.over)[0], self.values[:, k]
        band = known = None
        if self.std is not None:
            half = reach * self.std[:, k]
            band = ax.fill_between(
                at, values - half, values + half, color=ROLES["band"], alpha=0.4, lw=0, label=f"{level:.0%}"
            )
        (line,) = ax.plot(at, values, color=ROLES["mean"], label="model")
        if self.truth is not None and np.isfinite(self.truth[:, k]).any():
            (known,) = ax.plot(at, self.truth[:, k], "--", color=ROLES["truth"], label="known")
        ax.set_ylabel(_label(self.names[k]))
        tidy(ax)
        return line, band, known

    @classmethod
    def from_sweep(cls, sweep: pd.DataFrame, *, over="airspeed", derivatives=None, truth=None, ax=None, **plot_options):
        """Draw what :func:`skdgp.dynamics.stability_derivatives` returned for several points.

        Parameters
        ----------
        sweep : DataFrame
            With levels ``point`` and derivative.
        over : {"airspeed", "alpha", "beta"}
            What the points are drawn over.
        derivatives : names, optional
            Which to draw; default: the best known of those there are.
        truth : DataFrame, optional
            Known ones at the same points, of the same form.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        DerivativeDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If the table is of a single point, or lacks a name.
        """
        check_matplotlib(f"{cls.__name__}.from_sweep")
        if not isinstance(sweep.index, pd.MultiIndex):
            raise ValueError(
                "Got derivatives of a single point, but expected those of several: stability_derivatives(model, "
                "aircraft, [trim, ...])."
            )
        if over not in OVER:
            raise ValueError(f"Got over={over!r}, but expected one of {list(OVER)}.")
        wide = sweep["value"].unstack(0)
        names = [name for name in USUAL if name in wide.index] if derivatives is None else list(derivatives)
        choose(tuple(wide.index), names)
        at = sweep[over].groupby(level=0).first()
        order = at.sort_values().index
        display = cls(
            at=at[order].to_numpy(dtype=float),
            values=wide.loc[names, order].to_numpy(dtype=float).T,
            std=sweep["std"].unstack(0).loc[names, order].to_numpy(dtype=float).T if "std" in sweep else None,
            truth=None if truth is None else truth["value"].unstack(0).reindex(names)[order].to_numpy(dtype=float).T,
            over=over,
            names=tuple(names),
        )
        return display.plot(ax, **plot_options)


def _label(name: str) -> str:
    """Return the symbol, such as C_{m_q}, of a derivative."""
    coefficient, _, regressor = name.partition("_")
    below = coefficient.removeprefix("C")
    if not regressor:
        return f"$C_{below}$"
    sign = symbol(regressor)
    of = sign.strip("$") if sign.startswith("$") else rf"\mathrm{{{plain(regressor)}}}".replace("_", r"\_")
    return f"$C_{{{below}_{{{of}}}}}$"
