"""Selection of kernels: by evidence (BIC), and by what blocks of the log that were held out show."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.checkpoint import FitRecord, run_recorded
from skdgp.inference._fit import Hyperparameters, fit_exact, some_rows, spread


@dataclass(frozen=True)
class Choice:
    """Which kernel was chosen, and the criterion in nats of those that were tried, the first ones.

    ``found`` are its hyperparameters where Ctrl-C ended the search: the best that there are.
    """

    index: int
    scores: list[float]
    found: Hyperparameters | None = None


def choose_kernel(
    kernels, X, Y, *, optimizer, max_iter, random_state, input_noise=None, record: FitRecord | None = None, clock=None
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
    clock : ndarray (n, 2) or None
        As for ``fit_exact``.

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
        fit = run_recorded(record, f"candidate-{k}", partial(fit_exact, kernel, X, Y), **options)
        if fit.interrupted:
            return Choice(max(k - 1, 0), scores, (best or fit).found(interrupted=True))
        n_hyperparameters = fit.posterior.kernel.n_dims + Y.shape[1]
        scores.append(fit.value - 0.5 * n_hyperparameters * np.log(np.isfinite(Y).sum()))
        if best is not None and scores[-1] <= scores[-2]:
            return Choice(k - 1, scores)
        best = fit
    return Choice(k, scores)


BLOCKS = 4  # of the log, held out in turn
BLOCK_VALUES = 1200  # observed values, at most, that a comparison by blocks uses
BLOCK_ITERATIONS = 20  # of each fit
GAP = 0.1  # of a block on either side of it that is not learned from: neighbours repeat each other
FEWEST_ROWS = 40  # for blocks that mean something


def held_out_errors(
    name, kernel, X, Y, *, optimizer, max_iter, random_state, input_noise=None, record=None, clock=None
):
    """Return the mean squared error of each output in blocks of rows that were not learned from, over its variance.

    Rows in the order of the log: a block is a stretch of flight, and what is learned from the others is asked there, as
    of another flight. The evidence cannot say this: where residuals repeat each other for seconds, it takes them for
    structure.

    Parameters
    ----------
    name : str
        Of the comparison's fits in a checkpoint.
    kernel : MultiOutputKernel
        Without values.
    X, Y, optimizer, max_iter, random_state, input_noise, record, clock
        As for ``choose_kernel``.

    Returns
    -------
    errors : ndarray (P,) or None
        NaN for an output without values in the blocks; None where there are too few rows, or Ctrl-C stopped a fit.
    found : Hyperparameters or None
        Of the fit that Ctrl-C stopped.
    """
    observed = np.flatnonzero(np.isfinite(Y).any(axis=1))
    n = max(1, int(BLOCK_VALUES * len(observed) / np.isfinite(Y).sum()))
    rows = spread(observed, n, check_random_state(random_state))
    if len(rows) < FEWEST_ROWS:
        return None, None
    options = {"optimizer": optimizer, "max_iter": min(max_iter, BLOCK_ITERATIONS), "random_state": random_state}
    error = np.full((len(rows), Y.shape[1]), np.nan)
    edges = np.linspace(0, len(rows), BLOCKS + 1).astype(int)
    for k, (a, b) in enumerate(pairwise(edges)):
        gap = int(GAP * (b - a))
        learned, asked = np.concatenate([rows[: max(a - gap, 0)], rows[b + gap :]]), rows[a:b]
        if (np.isfinite(Y[learned]).sum(axis=0) < 2).any():
            return None, None
        own = {"input_noise": input_noise, "clock": None if clock is None else clock[learned], **options}
        fit = run_recorded(record, f"{name}-block-{k}", partial(fit_exact, kernel, X[learned], Y[learned]), **own)
        if fit.interrupted:
            return None, fit.found(interrupted=True)
        error[a:b] = (Y[asked] - fit.posterior.predict(X[asked])) ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output without values has no mean
        return np.nanmean(error, axis=0) / np.nanvar(Y[rows], axis=0), None
