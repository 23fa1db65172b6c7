"""Statistics of predictions: central intervals, R^2, and how many independent values a series is worth."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.stats import norm
from sklearn.metrics import r2_score

from skdgp._compute.typing import Matrix, Vector

WINDOW = 5.0  # autocorrelation times over which correlations are summed


def check_deviations(name: str, values: Any, n: int, expected: str) -> Vector:
    """Return standard deviations (n,); raise ValueError with what was expected if they are no finite numbers >= 0."""
    std = np.asarray(values, dtype=float)
    if std.shape != (n,) or not (np.isfinite(std) & (std >= 0)).all():
        raise ValueError(f"Got {name}={values!r}, but expected {expected}.")
    return std


def r2_of_observed(y_true: Matrix, y_pred: Matrix, sample_weight: Vector | None = None) -> float:
    """Return the coefficient of determination, averaged over the outputs that have targets.

    Targets (n, P) are NaN where an output was not observed; ``sample_weight`` (n,) are weights of the rows.
    """
    scores = []
    for target, predicted in zip(y_true.T, y_pred.T, strict=True):
        rows = np.isfinite(target)
        if rows.any():
            weights = None if sample_weight is None else np.asarray(sample_weight)[rows]
            scores.append(r2_score(target[rows], predicted[rows], sample_weight=weights))
    return float(np.mean(scores)) if scores else float("nan")


def autocorrelation_time(residuals: Vector) -> float:
    r"""Return the integrated autocorrelation time, in samples, at least 1.

    The mean of n values with autocorrelation rho has the variance of the mean of n / tau
    independent values, with

    .. math:: \tau = 1 + 2 \sum_{k=1}^{K} \rho_k,

    summed up to the first K of at least 5 tau, since later terms add only noise (Sokal 1997,
    section 3).

    Parameters
    ----------
    residuals : ndarray (n,)
        In the order of recording. Shuffled residuals are uncorrelated: tau is about 1.

    Returns
    -------
    float
        tau, in samples.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.inference import autocorrelation_time
    >>> white = np.random.default_rng(0).normal(size=5000)
    >>> round(autocorrelation_time(white))
    1
    >>> round(autocorrelation_time(np.repeat(white, 8)))
    8
    """
    centred = residuals - np.mean(residuals)
    n = len(centred)
    size = next_fast_len(2 * n)
    power = np.abs(rfft(centred, size)) ** 2
    covariance = irfft(power, size)[:n]
    if not covariance[0] > 0:
        return 1.0
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    enough = np.arange(n) >= WINDOW * tau
    last = np.argmax(enough) if enough.any() else -1
    return float(max(1.0, tau[last]))


def half_width(level: float) -> float:
    """Return half the width of the central interval of a probability inside (0, 1), in standard deviations."""
    if not isinstance(level, Real) or not 0 < float(level) < 1:
        raise ValueError(
            f"Got level={level!r}, but expected a probability inside (0, 1), such as 0.95."
        )
    return float(norm.ppf(0.5 + float(level) / 2))


def remaining_error(value: float, std: float, prior_std: float) -> float:
    r"""Return the root mean square of an error that was estimated, and not removed.

    With the prior variance :math:`\tau^2` and :math:`w = \tau^2 / (\tau^2 + \sigma^2)` it is that of the
    posterior, :math:`\sqrt{w^2 v^2 + w \sigma^2}` for an estimate :math:`v \pm \sigma`.
    """
    weight = prior_std**2 / (prior_std**2 + std**2)
    return float(np.hypot(weight * value, np.sqrt(weight) * std))
