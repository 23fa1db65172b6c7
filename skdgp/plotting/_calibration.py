"""Intervals that hold as often as they say, or not."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from skdgp._vocabulary import COEFFICIENTS, LONGITUDINAL
from skdgp.plotting._arrays import check_columns_of, check_std, choose, names_of
from skdgp.plotting._coefficients import predict_with_std
from skdgp.plotting._style import CYCLE, PALETTE, check_matplotlib, panels, symbol, tidy

LEVELS = np.append(np.arange(0.05, 0.96, 0.05), 0.99)


class CalibrationDisplay:
    """Share of values inside their interval against the interval's probability, per output.

    The interval of probability c is mean +/- z std with z = Phi^-1((1 + c) / 2). A curve on the diagonal: the
    standard deviations are right. Below it: too small (overconfident). Above it: too large.

    Use :meth:`from_estimator` or :meth:`from_predictions`. All parameters are kept as attributes.

    Parameters
    ----------
    nominal : (L,)
        Probabilities of the intervals.
    observed : (L, P)
        Share of values inside; NaN for an output never observed.
    output_names : P names
        The outputs.
    n_values : (P,) int
        How many values each share was counted over.

    Attributes
    ----------
    lines_ : list of Line2D
        One per output drawn.
    diagonal_ : Line2D
        Where a calibrated model lies.
    ax_, figure_ : Axes, Figure
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
    """

    def __init__(self, *, nominal, observed, output_names, n_values):
        self.nominal = nominal
        self.observed = observed
        self.output_names = output_names
        self.n_values = n_values

    def plot(self, ax=None, *, outputs=None, legend=True):
        """Draw the curves.

        Parameters
        ----------
        ax : Axes or Figure, optional
            Where to draw; default: a new pyplot figure.
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
        chosen = choose(self.output_names, outputs)
        ax = panels(ax, 1, 1, figsize=(4.6, 4.6))[0, 0]
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
        ax.text(4, 96, "too wide", va="top", fontsize="small", color=PALETTE["grey"])
        ax.text(96, 4, "too narrow", ha="right", fontsize="small", color=PALETTE["grey"])
        if legend and chosen:
            ax.legend(loc="upper left", bbox_to_anchor=(0.01, 0.92), frameon=False, fontsize="small")
        self.ax_, self.figure_ = ax, ax.figure
        return self

    def _draw_line(self, ax, k):
        # Dashes beside colours: longitudinal solid, the rest dashed.
        name = self.output_names[k]
        return ax.plot(
            100 * self.nominal,
            100 * self.observed[:, k],
            color=CYCLE[k % len(CYCLE)],
            linestyle="-" if name in LONGITUDINAL or name not in COEFFICIENTS else (0, (4, 1.5)),
            linewidth=1.4,
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
        nominal = _check_levels(levels)
        observed, n_values = observed_coverage(values, mean, check_std(std, values.shape), nominal)
        display = cls(
            nominal=nominal,
            observed=observed,
            output_names=names_of(measured, values.shape[1], output_names, COEFFICIENTS),
            n_values=n_values,
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


def observed_coverage(values, mean, std, levels) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of ``values`` inside each interval ``(L, P)``, and how many values were counted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(values - mean) / std
    distance[(values == mean) & (std == 0)] = 0.0
    bound = norm.ppf((1 + levels) / 2)
    shares = np.full((len(levels), values.shape[1]), np.nan)
    counts = np.count_nonzero(~np.isnan(distance), axis=0)
    for k, column in enumerate(np.sort(distance, axis=0).T):
        if counts[k]:
            shares[:, k] = np.searchsorted(column[: counts[k]], bound, side="right") / counts[k]
    return shares, counts


def _check_levels(levels) -> np.ndarray:
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    if levels.ndim != 1 or not ((levels > 0) & (levels < 1)).all():
        raise ValueError(f"Got levels {levels}, but expected probabilities between 0 and 1, such as 0.95.")
    return np.sort(levels)
