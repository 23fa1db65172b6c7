"""Model selection: kernels by the Bayesian information criterion, structures by the error of held-out blocks."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.checkpoint import FitRecord, run_recorded
from skdgp._compute.typing import Indices, Matrix, Seed, Vector
from skdgp.inference._fit import Hyperparameters, fit_exact, some_rows, stratified


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
    record: FitRecord | None = None,
    clock: Matrix | None = None,
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
    record : FitRecord or None
        Checkpoint in which the fits are saved.
    clock : ndarray (n, 2) or None
        As for ``fit_exact``.

    Returns
    -------
    Choice
        After Ctrl-C, the best kernel of those whose fit was complete, or the first kernel if none was.
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


FEWEST_FLIGHTS, MOST_GROUPS = 3, 8  # flights from which whole flights are held out, in at most so many groups
BLOCKS = 4  # blocks of the log, held out in turn
BLOCK_VALUES = 800  # largest number of observed values for a comparison by blocks
BLOCK_ITERATIONS = 10  # largest number of iterations of each fit
GAP = 0.1  # rows left out on either side of a held-out block, over its length: neighbours are correlated
FEWEST_ROWS = 40  # rows below which blocks are too short for a comparison


def held_out_errors(
    name: str,
    kernel: Any,
    X: Matrix,
    Y: Matrix,
    *,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: Any = None,
    record: Any = None,
    clock: Matrix | None = None,
    flights: Vector | None = None,
) -> tuple[Vector | None, Hyperparameters | None]:
    """Return the mean squared error of each output in held-out flights or blocks of rows, over its variance.

    Up to 8 groups of flights are held out in turn, or 4 blocks of fewer than 3 flights. Rows are in the order of the
    log, so predicting a block resembles predicting another flight. The marginal likelihood cannot replace this
    comparison: it explains residuals that are correlated over seconds as structure.

    Parameters
    ----------
    name : str
        Name of these fits in a checkpoint.
    kernel : MultiOutputKernel
        Without values.
    X, Y, optimizer, max_iter, random_state, input_noise, record, clock
        As for ``choose_kernel``.
    flights : ndarray (n,) or None
        Number of the flight of each row, from 0 on.

    Returns
    -------
    errors : ndarray (P,) or None
        NaN for an output without values in the blocks. None if there are too few rows or Ctrl-C stopped a fit.
    hyperparameters : Hyperparameters or None
        Those of the fit that Ctrl-C stopped.
    """
    observed = np.flatnonzero(np.isfinite(Y).any(axis=1))
    n = max(1, int(BLOCK_VALUES * len(observed) / np.isfinite(Y).sum()))
    rows = stratified(observed, n, check_random_state(random_state))
    if len(rows) < FEWEST_ROWS:
        return None, None
    options = {"optimizer": optimizer, "max_iter": min(max_iter, BLOCK_ITERATIONS), "random_state": random_state}
    error = np.full((len(rows), Y.shape[1]), np.nan)
    for k, (train, test) in enumerate(_splits(rows, None if flights is None else flights[rows])):
        if (np.isfinite(Y[train]).sum(axis=0) < 2).any():
            return None, None
        block = {"input_noise": input_noise, "clock": None if clock is None else clock[train], **options}
        fit = run_recorded(record, f"{name}-block-{k}", partial(fit_exact, kernel, X[train], Y[train]), **block)
        if fit.interrupted:
            return None, fit.found(interrupted=True)
        error[np.searchsorted(rows, test)] = (Y[test] - fit.posterior.predict(X[test])) ** 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output without values has no mean
        return np.nanmean(error, axis=0) / np.nanvar(Y[rows], axis=0), None


def _splits(rows: Indices, flights: Indices | None) -> Iterator[tuple[Indices, Indices]]:
    """Yield training rows and test rows: groups of whole flights, or blocks with a gap on either side."""
    labels = np.unique([] if flights is None else flights)
    if flights is not None and len(labels) >= FEWEST_FLIGHTS:
        for group in np.array_split(labels, min(len(labels), MOST_GROUPS)):
            held_out = np.isin(flights, group)
            yield rows[~held_out], rows[held_out]
        return
    for a, b in pairwise(np.linspace(0, len(rows), BLOCKS + 1).astype(int)):
        gap = int(GAP * (b - a))
        yield np.concatenate([rows[: max(a - gap, 0)], rows[b + gap :]]), rows[a:b]
