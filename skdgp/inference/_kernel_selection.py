"""Model selection: kernels by the Bayesian information criterion, structures by the error of held-out blocks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._fit import Fit, fit_exact, fit_sparse, inducing_centres
from skdgp.inference._rows import quarters, some_rows
from skdgp.inference._search import Hyperparameters


@dataclass(frozen=True)
class Choice:
    """The index of the chosen kernel, and the criterion in nats of each kernel that was tried.

    ``found`` holds the best hyperparameters so far if Ctrl-C ended the search, else None.
    """

    index: int
    scores: list[float]
    found: Hyperparameters | None = None


def choose_kernel(
    kernels: Sequence,
    X: Matrix,
    Y: Matrix,
    *,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: Any = None,
) -> Choice:
    r"""Choose among kernels by the Bayesian information criterion, starting with the fewest hyperparameters.

    L is the marginal likelihood at its maximum over the q hyperparameters, noise variances included, and N is the
    number of observed values. The criterion (Schwarz 1978, times -1/2) is

    .. math:: \log L - \frac{1}{2}\, q \log N.

    Kernels are fitted in turn until the criterion does not increase; the last one before that is chosen. The second
    term penalises hyperparameters that raise L by chance and make predictions worse.

    Parameters
    ----------
    kernels : sequence of MultiOutputKernel
        Without values, ordered by increasing number of hyperparameters.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed. Above 1800 observed values, a subset spread over the rows is used.
    optimizer, max_iter, random_state, input_noise
        As for ``fit_exact``.

    Returns
    -------
    Choice
        After Ctrl-C, the best kernel of those whose fit was complete, or the first kernel if none was.
    """
    rows = some_rows(Y, check_random_state(random_state))
    X, Y = X[rows], Y[rows]
    options = {
        "optimizer": optimizer,
        "max_iter": max_iter,
        "random_state": random_state,
        "input_noise": input_noise,
    }
    scores: list[float] = []
    best = None
    for k, kernel in enumerate(kernels):
        fit = fit_exact(kernel, X, Y, **options)
        if fit.interrupted:
            return Choice(max(k - 1, 0), scores, (best or fit).marked(interrupted=True).learned)
        n_hyperparameters = fit.posterior.kernel.n_dims + Y.shape[1]
        scores.append(fit.value - 0.5 * n_hyperparameters * np.log(np.isfinite(Y).sum()))
        if best is not None and scores[-1] <= scores[-2]:
            return Choice(k - 1, scores)
        best = fit
    return Choice(k, scores)


BLOCK_ROWS = 2000  # largest number of rows for a comparison by blocks
FEWEST_ROWS = 40  # rows below which blocks are too short for a comparison


def held_out_errors(fit: Fit, X: Matrix, Y: Matrix, n_inducing: int) -> Vector | None:
    """Return the mean squared error of each output in held-out blocks of rows, over its variance.

    Each quarter of the log is predicted from the others, with the hyperparameters of the fit. Rows are in the order of
    the log, so predicting a block resembles predicting another flight. The marginal likelihood cannot replace this
    comparison: it explains residuals that are correlated over seconds as structure. Hyperparameters are not learned
    from the other rows alone: where these lack a manoeuvre, they would be those of another model.

    Parameters
    ----------
    fit : Fit
        Of all rows.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    n_inducing : int
        As for ``fit_sparse``.

    Returns
    -------
    ndarray (P,) or None
        NaN for an output without values. None if there are too few rows.
    """
    rows = np.flatnonzero(np.isfinite(Y).any(axis=1))
    rows = rows[:: -(-len(rows) // BLOCK_ROWS)]
    if len(rows) < FEWEST_ROWS:
        return None
    learned = Hyperparameters(fit.posterior.kernel, fit.learned.noise, fit.learned.root)
    options: dict[str, Any] = {
        "n_inducing": n_inducing,
        "optimizer": None,
        "max_iter": 0,
        "random_state": 0,
        "found": learned,
        "centres": inducing_centres(learned.kernel, X[rows], n_inducing, np.random.RandomState(0)),
    }
    error = np.full((len(rows), Y.shape[1]), np.nan)
    for rest, block, place in quarters(rows):
        posterior = fit_sparse(learned.kernel, X[rest], Y[rest], **options).posterior
        error[place] = (Y[block] - posterior.predict(X[block])) ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output without values has no mean
        return np.nanmean(error, axis=0) / np.nanvar(Y[rows], axis=0)
