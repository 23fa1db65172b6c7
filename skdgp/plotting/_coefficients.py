"""CoefficientDisplay: measured and estimated coefficients against time."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import COEFFICIENTS
from skdgp.metrics._scorers import predict_with_noise
from skdgp.plotting._arrays import check_columns_of, check_std, check_time, choose, names_of
from skdgp.plotting._comparison import Comparison, check_level, draw_comparison
from skdgp.plotting._style import axis_label, check_matplotlib, legend_above, panels, tidy


class CoefficientDisplay:
    """Measured and estimated outputs with the estimate's band, one panel each (the paper's figure 6).

    Use :meth:`from_estimator` or :meth:`from_predictions`. All parameters are kept as attributes.

    Parameters
    ----------
    time : (n,)
        Time of the samples [s]. No line is drawn across a gap, nor where time goes back (a new flight).
    measured : (n, P)
        Measured outputs; NaN = not observed.
    mean : (n, P)
        Estimated outputs.
    std : (n, P), optional
        Their standard deviations.
    truth : (n, P), optional
        Noise-free outputs, of a simulation.
    output_names : P names, optional
        Default: those of a DataFrame ``measured``; for six unnamed columns CX CY CZ Cl Cm Cn.

    Attributes
    ----------
    axes_ : ndarray of Axes
        The panels.
    figure_ : Figure
        The figure they are in.
    measured_, mean_, bands_, truth_ : lists of artists
        One per panel drawn; None where there was nothing to draw.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import CoefficientDisplay
    >>> time = np.linspace(0, 10, 400)
    >>> mean = np.sin(time[:, None] * np.arange(1, 7))
    >>> display = CoefficientDisplay.from_predictions(time, mean + 0.1, mean, 0.1 + 0 * mean, ax=Figure())
    >>> display.axes_.shape, display.output_names[:2]
    ((3, 2), ('CX', 'CY'))
    """

    def __init__(self, *, time, measured, mean, std=None, truth=None, output_names=None):
        self.time = time
        self.measured = measured
        self.mean = mean
        self.std = std
        self.truth = truth
        self.output_names = output_names

    def plot(self, ax=None, *, kind="values", outputs=None, level=0.95, time_span=None, n_bins=2000, legend=True):
        """Draw the panels.

        Parameters
        ----------
        ax : Axes, Figure, SubFigure or array of Axes, optional
            Where to draw; default: a new pyplot figure. One Axes is divided when there are several panels.
        kind : {"values", "residuals"}, default="values"
            Measured and estimated values, or measured less estimated with the band about zero: the clearer
            picture of a long record.
        outputs : names, optional
            Which outputs to draw, default all.
        level : float, default=0.95
            Probability of the band.
        time_span : (begin, end), optional
            Part of the record to draw [s].
        n_bins : int, default=2000
            Time slices a longer record is drawn with; of each the extremes are kept.
        legend : bool, default=True
            Whether to write what is what above the first panel.

        Returns
        -------
        CoefficientDisplay
            Itself, with the artists as attributes.
        """
        check_matplotlib(f"{type(self).__name__}.plot")
        level = check_level(level)
        if kind not in ("values", "residuals"):
            raise ValueError(f"Got kind={kind!r}, but expected 'values' or 'residuals'.")
        chosen = choose(self.output_names, outputs)
        n_rows, n_cols = grid(len(chosen))
        axes = panels(ax, n_rows, n_cols, figsize=(5 * n_cols, 1 + 1.7 * n_rows), sharex=True)
        drawn = [
            self._draw_panel(one, k, kind, level, time_span, n_bins)
            for one, k in zip(axes.T.flat, chosen, strict=False)
        ]
        for unused in axes.T.flat[len(chosen) :]:
            unused.set_visible(False)
        for bottom in axes[-1]:
            bottom.set_xlabel("time [s]")
        self.measured_, self.mean_, self.bands_, self.truth_ = (list(kind) for kind in zip(*drawn, strict=True))
        self.axes_, self.figure_ = axes, axes.flat[0].figure
        if legend:
            legend_above(axes.flat[0])
        return self

    def _draw_panel(self, ax, k, kind, level, time_span, n_bins):
        columns = (None if v is None else v[:, k] for v in (self.measured, self.mean, self.std, self.truth))
        data = Comparison(self.time, *columns).within(time_span)
        data = data.less_mean() if kind == "residuals" else data
        artists = draw_comparison(ax, data, level=level, n_bins=n_bins)
        label = axis_label(self.output_names[k])
        ax.set_ylabel(f"{label} less estimate" if kind == "residuals" else label)
        tidy(ax)
        return artists

    @classmethod
    def from_predictions(
        cls, time, measured, mean, std=None, *, truth=None, output_names=None, ax=None, **plot_options
    ):
        """Draw predictions beside measurements.

        Parameters
        ----------
        time, measured, mean, std, truth, output_names
            See the class.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        CoefficientDisplay
            The display, drawn.

        Raises
        ------
        ValueError
            If shapes or names do not belong together, or a standard deviation is negative.
        """
        check_matplotlib(f"{cls.__name__}.from_predictions")
        values = check_columns_of(measured, None, "measured outputs")
        display = cls(
            time=check_time(time, len(values)),
            measured=values,
            mean=check_columns_of(mean, values.shape, "mean"),
            std=check_std(std, values.shape),
            truth=None if truth is None else check_columns_of(truth, values.shape, "truth"),
            output_names=names_of(measured, values.shape[1], output_names, COEFFICIENTS),
        )
        return display.plot(ax, **plot_options)

    @classmethod
    def from_estimator(cls, estimator, X, Y, *, time=None, truth=None, include_noise=False, ax=None, **plot_options):
        """Predict with a fitted estimator and draw.

        Parameters
        ----------
        estimator : fitted estimator or Pipeline
            Whose ``predict`` takes ``return_std``.
        X : (n, d)
            Regressors, or the flight table of an identification pipeline.
        Y : (n, P)
            Measured outputs; NaN = not observed.
        time : (n,), optional
            Default: the column ``time`` of ``X``.
        truth : (n, P), optional
            See the class.
        include_noise : bool, default=False
            Whether the band is that of a new measurement (the estimator must know the word), or of the
            noise-free output.
        ax, **plot_options
            See :meth:`plot`.

        Returns
        -------
        CoefficientDisplay
            The display, drawn.
        """
        check_matplotlib(f"{cls.__name__}.from_estimator")
        time = time_of(X) if time is None else time
        mean, std = predict_with_std(estimator, X, include_noise)
        names = None if hasattr(Y, "columns") else getattr(estimator, "output_names_", None)
        return cls.from_predictions(time, Y, mean, std, truth=truth, output_names=names, ax=ax, **plot_options)


def grid(n_panels: int) -> tuple[int, int]:
    """Return rows and columns: two columns for four panels and more, forces left and moments right."""
    n_cols = 1 if n_panels <= 3 else 2
    return -(-n_panels // n_cols), n_cols


def time_of(X) -> np.ndarray:
    """Return the column ``time`` of a flight table."""
    if "time" not in getattr(X, "columns", ()):
        raise ValueError("Got an X without a column 'time': give the samples' times as time=... [s].")
    return X["time"].to_numpy()


def predict_with_std(estimator, X, include_noise: bool):
    """Return mean and std of a fitted estimator; noise, that of regressors too, is asked for only when wanted."""
    return predict_with_noise(estimator, X) if include_noise else estimator.predict(X, return_std=True)
