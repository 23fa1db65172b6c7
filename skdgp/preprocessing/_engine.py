"""Regressors of a thrust that nothing gives: throttle and airspeed, where the coefficients need them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp._compute.typing import Matrix, Vector

# Regressors of a thrust that nothing gives
ENGINE_REGRESSORS = ("throttle", "airspeed")


N_BLOCKS = 5  # of consecutive rows, which are held out in turn
# least gain of a further regressor, over the error: smaller ones are equal (as of the verdict)
LEAST_GAIN = 0.02
# fraction of the blocks, at least, in which it lowers the error; a guess
MOST_BLOCKS = 0.6
# smaller errors of a linear model, over the spread, are equal
LEAST_ERROR = 0.01


def engine_regressors(names: list[str], X: Matrix, Y: Matrix) -> list[str]:
    """Return a set of regressors, with those of throttle and airspeed that the coefficients need.

    Each choice of the two is judged by the errors of linear models on blocks of consecutive rows that
    are held out in turn. More regressors are taken if they lower the error as a whole, and in most
    blocks.

    Parameters
    ----------
    names : list of str
        The set, with throttle and airspeed.
    X : ndarray (n, d)
        Regressors by these names.
    Y : ndarray (n, P)
        Coefficients, NaN where not to be learned from.
    """
    is_learned = np.isfinite(np.column_stack([X, Y])).all(axis=1)
    X, Y = X[is_learned], Y[is_learned]
    if len(Y) < N_BLOCKS * len(names):  # too few to judge
        return names
    engine = [name for name in ENGINE_REGRESSORS if name in names]
    choices = []
    errors = []
    for size in range(len(engine) + 1):
        for choice in combinations(engine, size):
            columns = [name in choice or name not in engine for name in names]
            choices.append(columns)
            errors.append(_held_out_errors(X[:, columns], Y))
    chosen = choices[_best_choice(np.array(errors))]
    return [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]


def _best_choice(errors: Matrix) -> int:
    """Return the place of the best choice by errors (choices, blocks), which grow in size."""
    best = 0
    for place in range(1, len(errors)):
        gain = 1 - np.sqrt(np.mean(errors[place] ** 2) / np.mean(errors[best] ** 2))
        is_mostly_better = np.mean(errors[place] < errors[best]) >= MOST_BLOCKS
        if gain > LEAST_GAIN and is_mostly_better:
            best = place
    return best


def _held_out_errors(X: Matrix, Y: Matrix) -> Vector:
    """Return the errors (blocks,) of linear models of Y (n, P) on blocks held out in turn, over the spread of Y."""
    spread = np.std(Y, axis=0)
    unit = np.where(spread > 0, spread, 1.0)
    blocks = np.arange(len(Y)) * N_BLOCKS // len(Y)
    errors = []
    for block in range(N_BLOCKS):
        held_out = blocks == block
        model = make_pipeline(StandardScaler(), Ridge(alpha=1.0)).fit(X[~held_out], Y[~held_out])
        residuals = (model.predict(X[held_out]) - Y[held_out]) / unit
        errors.append(np.sqrt(np.mean(residuals**2)))
    return np.maximum(errors, LEAST_ERROR)
