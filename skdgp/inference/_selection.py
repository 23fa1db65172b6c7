"""Selection of the number of latents by evidence (BIC)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.checkpoint import Record, kept_in
from skdgp.inference._fit import Hyperparameters, fit_exact, some_rows


@dataclass(frozen=True)
class Choice:
    """Which kernel was chosen, and the criterion in nats of those that were tried, the first ones.

    ``found`` are its hyperparameters where Ctrl-C ended the search: the best that there are.
    """

    index: int
    scores: list[float]
    found: Hyperparameters | None = None


def choose_kernel(
    kernels, X, Y, *, optimizer, max_iter, random_state, input_noise=None, record: Record | None = None, clock=None
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
    optimizer, max_iter, random_state, input_noise, clock
        As for ``fit_exact``.
    record : Record or None
        Where the fits are kept, if they are.

    Returns
    -------
    Choice
        At Ctrl-C the best of the kernels that were done; of the first, if none was.
    """
    rows = some_rows(Y, check_random_state(random_state))
    X, Y, clock = X[rows], Y[rows], None if clock is None else clock[rows]
    options = {
        "optimizer": optimizer,
        "max_iter": max_iter,
        "random_state": random_state,
        "input_noise": input_noise,
        "clock": clock,
    }
    scores: list[float] = []
    best = None
    for k, kernel in enumerate(kernels):
        fit = kept_in(record, f"candidate-{k}", partial(fit_exact, kernel, X, Y), **options)
        if fit.interrupted:
            return Choice(max(k - 1, 0), scores, (best or fit).found(interrupted=True))
        n_hyperparameters = fit.posterior.kernel.n_dims + Y.shape[1]
        scores.append(fit.value - 0.5 * n_hyperparameters * np.log(np.isfinite(Y).sum()))
        if best is not None and scores[-1] <= scores[-2]:
            return Choice(k - 1, scores)
        best = fit
    return Choice(k, scores)
