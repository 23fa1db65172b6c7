"""DerivativeDisplay: stability derivatives over speed or angle of attack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.style import axis_label, display_unit, draw_curve, plain, symbol
from skdgp._flight.checks import check_choice
from skdgp.plotting._display import Display, Names, choose

DEFAULT_DERIVATIVES = (
    "CL_alpha", "CD_alpha", "Cm_alpha", "Cm_q", "CY_beta", "Cl_beta", "Cn_beta", "Cl_p", "Cn_r", "Cm_elevator",
    "Cl_aileron", "Cn_rudder",
)  # fmt: skip


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
            return draw_curve(ax, at, self.values[:, k], None if self.std is None else self.std[:, k], level, "model")

        keys, options = range(len(self.names)), {"xlabel": axis_label(self.over), "legend": legend, "sharex": True}
        artists = self._draw_panels(ax, draw, keys, min(3, len(keys)), (3.2, 1.9), **options)
        self.lines_, self.bands_ = artists
        return self

    @classmethod
    def from_sweep(
        cls, sweep: pd.DataFrame, *, over: str = "airspeed", derivatives: Names = None, **plot_options: Any
    ) -> Self:
        """Draw the result of :func:`skdgp.dynamics.stability_derivatives` for several points; see :meth:`plot`.

        ``over`` is "airspeed", "alpha" or "beta", the quantity of the horizontal axis. The derivatives are by default
        the most common ones of the table.
        """
        if not isinstance(sweep.index, pd.MultiIndex):
            raise ValueError(
                "Got derivatives of a single point, but expected those of several: stability_derivatives(model, "
                "aircraft, [trim, ...])."
            )
        check_choice("over", over, ("airspeed", "alpha", "beta"))
        known = sweep.index.unique(level=1)
        names = [name for name in DEFAULT_DERIVATIVES if name in known] if derivatives is None else list(derivatives)
        choose(tuple(known), names)
        at = sweep[over].groupby(level=0).first().sort_values()

        def columns(column):
            return sweep[column].unstack(1).reindex(index=at.index, columns=names).to_numpy(dtype=float)

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
    index = sign.strip("$") if sign.startswith("$") else rf"\mathrm{{{plain(regressor)}}}".replace("_", r"\_")
    return f"$C_{{{below}_{{{index}}}}}$"
