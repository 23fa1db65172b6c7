"""Selection of the number of latents by evidence (BIC)."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.checkpoint import FitRecord, run_recorded
from skdgp.inference._fit import Found, fit_exact, some_rows


class Choice(NamedTuple):
    """Which kernel was chosen, and the criterion in nats of those that were tried, the first ones.

    ``found`` are its hyperparameters where Ctrl-C ended the search: the best that there are.
    """

    index: int
    scores: list[float]
    found: Found | None = None


def choose_kernel(
    kernels, X, Y, *, optimizer, max_iter, random_state, input_noise=None, record: FitRecord | None = None
) -> Choice:
    r"""Choose among kernels, from few hyperparameters to many, by the Bayesian information criterion.

    With L the marginal likelihood at its maximum over the q hyperparameters, noise variances among them, and N observed
    values, the first kernel is taken whose

    .. math:: \log L - \frac{1}{2}\, q \log N

    the next one does not exceed (Schwarz 1978, halved and turned over): more hyperparameters than the data can tell
    raise L by chance, and predict worse.

    Parameters
    ----------
    kernels : sequence of MultiOutputKernel
        Without values; fewest hyperparameters first.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed. Where more than 2400 values were, rows spread over them are used.
    optimizer, max_iter, random_state, input_noise
        As for ``fit_exact``.
    record : FitRecord or None
        Where the fits are kept, if they are.

    Returns
    -------
    Choice
        At Ctrl-C the best of the kernels that were done; of the first, if none was.
    """
    rows = some_rows(Y, check_random_state(random_state))
    X, Y = X[rows], Y[rows]
    options = {"optimizer": optimizer, "max_iter": max_iter, "random_state": random_state, "input_noise": input_noise}
    scores, best = [], None
    for k, kernel in enumerate(kernels):
        fit = run_recorded(record, f"candidate-{k}", partial(fit_exact, kernel, X, Y), **options)
        if fit.interrupted:
            return Choice(max(k - 1, 0), scores, (best or fit).found(interrupted=True))
        n_hyperparameters = fit.posterior.kernel.n_dims + Y.shape[1]
        scores.append(fit.value - 0.5 * n_hyperparameters * np.log(np.isfinite(Y).sum()))
        if best is not None and scores[-1] <= scores[-2]:
            return Choice(k - 1, scores)
        best = fit
    return Choice(k, scores)
