"""The autocorrelation time of residuals: how many neighbouring samples count as one."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

WINDOW = 5.0  # autocorrelation times over which the correlations are summed


def autocorrelation_time(residuals) -> float:
    r"""Return how many neighbouring values count as one, at least 1.

    The variance of a mean of n values with autocorrelation rho is that of n / tau independent ones, with the
    integrated autocorrelation time

    .. math:: \tau = 1 + 2 \sum_{k=1}^{K} \rho_k,

    summed up to the first K of at least 5 tau (Sokal 1997, section 3): beyond it the sum gathers noise.

    Parameters
    ----------
    residuals : ndarray (n,)
        In the order in which they were recorded. Shuffled ones repeat nothing: 1, but for chance.

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
    power = np.abs(rfft(centred, next_fast_len(2 * n))) ** 2
    covariance = irfft(power)[:n]
    if not covariance[0] > 0:
        return 1.0
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    enough = np.arange(n) >= WINDOW * tau
    return float(max(1.0, tau[np.argmax(enough)] if enough.any() else tau[-1]))
