"""CouplingDisplay: correlations between outputs."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting._arrays import names_of
from skdgp.plotting._style import check_matplotlib, panels, scale_beside, symbol


class CouplingDisplay:
    """Correlation between the outputs as a heat map with its values written in.

    Use :meth:`from_estimator` or :meth:`from_correlation`. All parameters are kept as attributes.

    Parameters
    ----------
    correlation : (P, P)
        Correlations between -1 and 1; NaN where there is none.
    output_names : P names
        The outputs.

    Attributes
    ----------
    image_ : QuadMesh
        The coloured cells.
    text_ : ndarray of Text, (P, P)
        The written values.
    colorbar_ : Colorbar or None
        The scale.
    ax_, figure_ : Axes, Figure
        Where it was drawn.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CouplingDisplay
    >>> display = CouplingDisplay.from_correlation([[1, -0.4], [-0.4, 1]], output_names=["CZ", "Cm"], ax=Figure())
    >>> display.text_[0, 1].get_text()
    '−0.40'
    """

    def __init__(self, *, correlation, output_names):
        self.correlation = correlation
        self.output_names = output_names

    def plot(self, ax=None, *, cmap="RdBu_r", colorbar=True):
        """Draw the heat map.

        Parameters
        ----------
        ax : Axes or Figure, optional
            Where to draw; default: a new pyplot figure.
        cmap : str or Colormap, default="RdBu_r"
            A diverging colour map, drawn from -1 to 1.
        colorbar : bool, default=True
            Whether to draw the scale.

        Returns
        -------
        CouplingDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        ax = panels(ax, 1, 1, figsize=(6.2, 4.6))[0, 0]
        edges = np.arange(len(self.output_names) + 1) - 0.5
        self.image_ = ax.pcolormesh(
            edges, edges, self.correlation, cmap=cmap, vmin=-1, vmax=1, edgecolors="white", linewidth=1.0
        )
        self.text_ = self._write_values(ax)
        labels = [symbol(name) for name in self.output_names]
        ax.set_xticks(range(len(labels)), labels)
        ax.set_yticks(range(len(labels)), labels)
        ax.invert_yaxis()
        ax.set_aspect("equal")
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        self.ax_, self.figure_ = ax, ax.figure
        ticks = [-1, -0.5, 0, 0.5, 1]
        self.colorbar_ = scale_beside(ax, self.image_, "correlation", ticks=ticks) if colorbar else None
        return self

    def _write_values(self, ax) -> np.ndarray:
        text = np.empty(self.correlation.shape, dtype=object)
        for (i, j), value in np.ndenumerate(self.correlation):
            text[i, j] = ax.text(
                j,
                i,
                f"{value:z.2f}".replace("-", "−") if np.isfinite(value) else "–",
                ha="center",
                va="center",
                fontsize="small",
                color="white" if abs(value) > 0.6 else "black",
            )
        return text

    @classmethod
    def from_correlation(cls, correlation, *, output_names=None, ax=None, **plot_options):
        """Draw a correlation matrix.

        Parameters
        ----------
        correlation : (P, P) array or DataFrame, or Bunch
            The matrix, or what ``output_correlation()`` of a fitted regressor returns (with ``correlation``
            and ``output_names``).
        output_names : P names, optional
            Default: those of the Bunch or DataFrame; for six unnamed outputs CX CY CZ Cl Cm Cn.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        CouplingDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If the matrix is not square, or holds values beyond -1 and 1.
        """
        check_matplotlib(f"{cls.__name__}.from_correlation")
        if hasattr(correlation, "correlation"):
            output_names = correlation.output_names if output_names is None else output_names
            correlation = correlation.correlation
        matrix = _check_correlation(correlation)
        names = names_of(correlation, len(matrix), output_names, COEFFICIENTS)
        return cls(correlation=matrix, output_names=names).plot(ax, **plot_options)

    @classmethod
    def from_estimator(cls, estimator, *, ax=None, **plot_options):
        """Draw the correlation that a fitted regressor has learned.

        Parameters
        ----------
        estimator : fitted DependentGPRegressor, or a Pipeline that ends in one
            Anything whose last step has ``output_correlation()``.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        CouplingDisplay
            The display, drawn.
        """
        check_matplotlib(f"{cls.__name__}.from_estimator")
        last = estimator.steps[-1][1] if hasattr(estimator, "steps") else estimator
        return cls.from_correlation(last.output_correlation(), ax=ax, **plot_options)


def _check_correlation(correlation) -> np.ndarray:
    matrix = np.asarray(correlation, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
        raise ValueError(f"Got a correlation of shape {matrix.shape}, but expected (P, P).")
    largest = np.max(np.abs(matrix), where=np.isfinite(matrix), initial=0.0)
    if largest > 1 + 1e-6:
        raise ValueError(
            f"Got correlations up to {largest:.4g} in size, but expected at most 1: a covariance is divided by "
            "the standard deviations first."
        )
    return matrix
