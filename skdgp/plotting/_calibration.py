"""CalibrationDisplay: how often intervals hold what they should."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from skdgp._flight.channels import COEFFICIENTS
from skdgp.metrics._metrics import LEVELS, check_levels, shares_inside, standardized
from skdgp.plotting._arrays import check_columns_of, check_std, choose, names_of
from skdgp.plotting._coefficients import grid, predict_with_std
from skdgp.plotting._style import CYCLE, MARKERS, PALETTE, QUIET, check_matplotlib, dashes, panels, symbol, tidy

N_BINS = 20


class CalibrationDisplay:
    """How often intervals hold, against what they promise, and where in its distribution each value lies, per output.

    The interval of probability c is mean +/- z std with z = Phi^-1((1 + c) / 2). A curve on the diagonal: the
    standard deviations are right. Below it: too small (overconfident). Above it: too large.

    The probability integral transform Phi((y - mean) / std) of honest predictions is uniform (Dawid 1984; Gneiting,
    Balabdaoui & Raftery 2007). A histogram like a hill: deviations too large. Like a bowl: too small. Aslant: the mean
    is off to one side, which coverage does not tell.

    Use :meth:`from_estimator` or :meth:`from_predictions`. All parameters are kept as attributes.

    Parameters
    ----------
    nominal : (L,)
        Probabilities of the intervals.
    observed : (L, P)
        Share of values inside; NaN for an output never observed.
    pit : (B, P)
        Density of the probability integral transform in B equal bins from 0 to 1; one is uniform, NaN never observed.
    output_names : P names
        The outputs.
    n_values : (P,) int
        How many values each share was counted over.

    Attributes
    ----------
    lines_ : list of Line2D
        Of the coverage, one per output drawn.
    diagonal_ : Line2D
        Where a calibrated model lies.
    bars_ : list of StepPatch
        Of the histograms, one per output drawn.
    ax_, axes_, figure_ : Axes, ndarray of Axes, Figure
        Where it was drawn.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CalibrationDisplay
    >>> y = np.random.default_rng(0).normal(size=(5000, 1))
    >>> display = CalibrationDisplay.from_predictions(y, 0 * y, 1 + 0 * y, ax=Figure())
    >>> bool(abs(display.observed[:, 0] - display.nominal).max() < 0.03)
    True
    >>> bool(abs(display.plot(Figure(), kind="pit").pit - 1).max() < 0.2)
    True
    """

    def __init__(self, *, nominal, observed, pit, output_names, n_values):
        self.nominal = nominal
        self.observed = observed
        self.pit = pit
        self.output_names = output_names
        self.n_values = n_values

    def plot(self, ax=None, *, kind="coverage", outputs=None, legend=True):
        """Draw the curves, or the histograms.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure. One Axes is divided when there are several panels.
        kind : {"coverage", "pit"}, default="coverage"
            Coverage by level, all outputs in one panel; or the histogram of the probability integral transform, a panel
            per output.
        outputs : names, optional
            Which outputs to draw, default all.
        legend : bool, default=True
            Whether to name the curves.

        Returns
        -------
        CalibrationDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        if kind not in ("coverage", "pit"):
            raise ValueError(f"Got kind={kind!r}, but expected 'coverage' or 'pit'.")
        chosen = choose(self.output_names, outputs)
        if kind == "pit":
            self._draw_histograms(ax, chosen)
        else:
            self._draw_coverage(ax, chosen, legend)
        self.ax_, self.figure_ = self.axes_.flat[0], self.axes_.flat[0].figure
        return self

    def _draw_coverage(self, ax, chosen, legend):
        self.axes_ = panels(ax, 1, 1, figsize=(4.6, 4.6))
        ax = self.axes_[0, 0]
        (self.diagonal_,) = ax.plot([0, 100], [0, 100], color=PALETTE["grey"], linewidth=1.0, linestyle=":")
        self.lines_ = [self._draw_line(ax, k) for k in chosen]
        ax.set(
            xlabel="nominal coverage [%]",
            ylabel="observed coverage [%]",
            xlim=(0, 100),
            ylim=(0, 100),
            xticks=range(0, 101, 20),
            yticks=range(0, 101, 20),
            aspect="equal",
        )
        tidy(ax)
        ax.text(4, 96, "too wide", va="top", fontsize="small", color=QUIET)
        ax.text(96, 4, "too narrow", ha="right", fontsize="small", color=QUIET)
        if legend and chosen:
            ax.legend(loc="upper left", bbox_to_anchor=(0.01, 0.92), frameon=False, fontsize="small")

    def _draw_histograms(self, ax, chosen):
        n_rows, n_cols = grid(len(chosen))
        self.axes_ = panels(ax, n_rows, n_cols, figsize=(3.2 * n_cols, 1 + 1.5 * n_rows), sharex=True, sharey=True)
        edges = np.linspace(0, 1, len(self.pit) + 1)
        self.bars_ = []
        for one, k in zip(self.axes_.T.flat, chosen, strict=False):
            bars = one.stairs(np.nan_to_num(self.pit[:, k]), edges, fill=True, color=CYCLE[k % len(CYCLE)], alpha=0.75)
            one.axhline(1.0, color="#333333", linewidth=1.0, linestyle=":")
            one.set(xlim=(0, 1), xticks=[0, 0.5, 1])
            one.set_title(symbol(self.output_names[k]), loc="left", fontsize="medium")
            tidy(one)
            self.bars_.append(bars)
        for unused in self.axes_.T.flat[len(chosen) :]:
            unused.set_visible(False)
        self.axes_.flat[0].set_ylim(0, 1.05 * np.max(self.pit[:, chosen], initial=1.0, where=self.pit[:, chosen] > 0))
        for left in self.axes_[:, 0]:
            left.set_ylabel("density")
        for bottom in self.axes_[-1]:
            bottom.set_xlabel(r"$\Phi$((measured - mean) / std)")

    def _draw_line(self, ax, k):
        name = self.output_names[k]
        return ax.plot(
            100 * self.nominal,
            100 * self.observed[:, k],
            color=CYCLE[k % len(CYCLE)],
            linestyle=dashes(name),
            linewidth=1.4,
            marker=MARKERS[k % len(MARKERS)],
            markersize=4,
            # Where curves agree, their marks stand beside each other.
            markevery=(k % 5, 5),
            label=symbol(name),
            clip_on=False,
        )[0]

    @classmethod
    def from_predictions(cls, measured, mean, std, *, levels=LEVELS, output_names=None, ax=None, **plot_options):
        """Count how often intervals hold, and draw.

        Parameters
        ----------
        measured, mean, std : (n, P)
            Values (NaN = not observed, left out), their predictions and standard deviations. For measured
            values these must include the measurement noise; for truth they must not.
        levels : (L,), default 5 % to 95 % in steps of 5 %, and 99 %
            Probabilities of the intervals.
        output_names : P names, optional
            Default: those of a DataFrame ``measured``; for six unnamed columns CX CY CZ Cl Cm Cn.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        CalibrationDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If shapes or names do not belong together, a standard deviation is negative, or a level is not
            between 0 and 1.
        """
        check_matplotlib(f"{cls.__name__}.from_predictions")
        values = check_columns_of(measured, None, "measured outputs")
        mean = check_columns_of(mean, values.shape, "mean")
        nominal = check_levels(levels)
        z = standardized(values, mean, check_std(std, values.shape))
        display = cls(
            nominal=nominal,
            observed=shares_inside(z, nominal),
            pit=_densities(norm.cdf(z)),
            output_names=names_of(measured, values.shape[1], output_names, COEFFICIENTS),
            n_values=np.count_nonzero(~np.isnan(z), axis=0),
        )
        return display.plot(ax, **plot_options)

    @classmethod
    def from_estimator(cls, estimator, X, Y, *, include_noise=True, ax=None, **options):
        """Predict with a fitted estimator, count and draw.

        Parameters
        ----------
        estimator : fitted estimator or Pipeline
            Whose ``predict`` takes ``return_std``.
        X : (n, d)
            Regressors, or the flight table of an identification pipeline.
        Y : (n, P)
            Measured outputs; NaN = not observed.
        include_noise : bool, default=True
            Whether to ask for the standard deviation of a new measurement, as measured ``Y`` need. Set it to
            False for truth, and for estimators that do not know the word.
        ax, **options
            See :meth:`from_predictions`.

        Returns
        -------
        CalibrationDisplay
            The display, drawn.
        """
        check_matplotlib(f"{cls.__name__}.from_estimator")
        mean, std = predict_with_std(estimator, X, include_noise)
        if not hasattr(Y, "columns"):
            options.setdefault("output_names", getattr(estimator, "output_names_", None))
        return cls.from_predictions(Y, mean, std, ax=ax, **options)


def _densities(transformed) -> np.ndarray:
    """Return the histogram of each column, (B, P), relative to a uniform one."""
    counts = np.column_stack([np.histogram(column, N_BINS, (0, 1))[0] for column in transformed.T])
    with np.errstate(invalid="ignore"):
        return N_BINS * counts / counts.sum(axis=0)
