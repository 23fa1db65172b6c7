"""The misfit: the error of the function that residuals show where flights come back to the same regressors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Indices, Matrix, Predictor, Vector


@dataclass(frozen=True)
class MisfitSettings:
    """Which pairs of samples show the misfit."""

    #: Most samples
    rows: int = 15000
    #: Nearest samples that are looked at
    candidates: int = 40
    #: Errors of samples that are farther apart in time have independent noise [s]
    largest_lag: float = 10.0
    #: Parts of the time series whose means show the standard error of the whole
    parts: int = 16


SETTINGS = MisfitSettings()


def misfit_variance(
    posterior: Predictor,
    X: Matrix,
    Y: Matrix,
    clock: Matrix,
    settings: MisfitSettings = SETTINGS,
) -> Vector:
    r"""Return the variance (P,) of the model discrepancy at the training samples of a posterior.

    Residuals e of two samples with near regressors share the error of the function, but no noise if
    they are from different flights or 10 s apart. So their products have the mean square of this
    error as their mean. With the mean m of n products and its standard error s, the least that they
    show is

    .. math:: v_i = \max(0, m_i - s_i), \quad m_i = \frac{1}{n} \sum_a e_{ia} e_{ib}.

    b is the nearest of the 40 samples nearest to a, by regressors over their standard deviations; a
    sample without one does not count. s is the scatter over 16 parts of
    the time series; it is multiplied by :math:`\sqrt 2`, since two parts share the products of their
    samples. For the right model the mean product is the negative posterior covariance, so v is zero
    but by chance. It is positive where the function has kinks or jumps that the kernel's widths
    smooth away. Errors that change their sign within the distance of neighbours do not show.

    Parameters
    ----------
    posterior : ExactPosterior, SparsePosterior or regressor
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    clock : ndarray (n, 2)
        Time [s] and flight number of each sample.
    settings : MisfitSettings

    Returns
    -------
    ndarray (P,)
        In squared units of Y.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from skdgp.inference import misfit_variance
    >>> rng = np.random.default_rng(0)
    >>> x, time = rng.uniform(-1, 1, (4000, 1)), np.arange(4000.0)
    >>> y = np.abs(x) + rng.normal(0, 0.3, x.shape)
    >>> line = LinearRegression().fit(x, y)
    >>> misfit = misfit_variance(line, x, y, np.column_stack([time, 0 * time]))
    >>> float(np.sqrt(misfit[0]).round(1)), float(np.std(np.abs(x) - line.predict(x)).round(1))
    (0.3, 0.3)
    """
    rows = np.flatnonzero(np.isfinite(Y).any(axis=1))
    rows = rows[:: -(-len(rows) // settings.rows)]
    X = X[rows]
    error = Y[rows] - posterior.predict(X)
    first, second = _pairs(X, clock[rows], settings)
    variance = np.zeros(Y.shape[1])
    for i, products in enumerate((error[first] * error[second]).T):
        products = products[np.isfinite(products)]
        if len(products) >= settings.parts:
            variance[i] = max(0.0, products.mean() - _standard_error(products, settings.parts))
    return variance


def _pairs(X: Matrix, clock: Matrix, settings: MisfitSettings) -> tuple[Indices, Indices]:
    """Return samples, and the nearest one of each that has independent noise, among its nearest ones."""
    time, flight = clock.T
    scaled = X / column_scale(X)
    near: Any = KDTree(scaled).query(scaled, k=min(settings.candidates, len(X)))[1]
    later = np.abs(time[near] - time[:, None]) > settings.largest_lag
    apart = later | (flight[near] != flight[:, None])
    first = np.flatnonzero(apart.any(axis=1))
    return first, near[first, apart[first].argmax(axis=1)]


def _standard_error(products: Vector, n_parts: int) -> float:
    """Return the standard error of the mean of products; two parts share products of samples."""
    means = [part.mean() for part in np.array_split(products, n_parts)]
    return np.sqrt(2 / n_parts) * np.std(means, ddof=1)
