"""CouplingDisplay: correlations between outputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from skdgp._compute.typing import Matrix
from skdgp._display.style import scale_beside, symbol
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting._display import names_of, panels


@dataclass(kw_only=True, eq=False, repr=False)
class CouplingDisplay:
    """Heat map of the correlations between outputs, with their values.

    The artists are ``image_``, the coloured cells, ``text_`` (P, P), the written values, and ``colorbar_``.

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
            style = {"ha": "center", "va": "center", "color": "white" if abs(value) > 0.6 else "black"}
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
    def from_correlation(cls, correlation: Any, *, output_names: Any = None, **plot_options: Any) -> Self:
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
                f"Got correlations up to {largest:.4g} in size, but expected at most 1: divide a covariance by the "
                "standard deviations first."
            )
        names = names_of(correlation, len(matrix), output_names, COEFFICIENTS)
        return cls(correlation=matrix, output_names=names).plot(**plot_options)

    @classmethod
    def from_estimator(cls, estimator: Any, **plot_options: Any) -> Self:
        """Draw the ``output_correlation()`` of a fitted regressor, or of a pipeline that ends in one."""
        last = estimator.steps[-1][1] if hasattr(estimator, "steps") else estimator
        return cls.from_correlation(last.output_correlation(), **plot_options)
