"""Regressors of a thrust that nothing gives: throttle and airspeed, for the coefficients that need them."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp._compute.typing import Matrix

# Regressors of a thrust that nothing gives
ENGINE_REGRESSORS = ("throttle", "airspeed")


N_BLOCKS = 5  # of consecutive rows, which are held out in turn
# least gain of a further regressor, over the error: smaller ones are equal (as of the verdict)
LEAST_GAIN = 0.02
# fraction of the blocks, at least, in which it lowers the error; a guess
MOST_BLOCKS = 0.6
# smaller errors of a linear model, over the spread, are equal
LEAST_ERROR = 0.01


class EngineRegressors(NamedTuple):
    """The regressors of a set, with those that an unknown thrust needs.

    Attributes
    ----------
    names : list of str
    without_effect : ndarray of bool (P, d)
        Whether a regressor of throttle and airspeed is of no use to an output.
    """

    names: list[str]
    without_effect: Matrix


def engine_regressors(names: list[str], X: Matrix, Y: Matrix) -> EngineRegressors:
    """Return a set of regressors, with those of throttle and airspeed that some coefficient needs.

    For each coefficient each choice of the two is judged by the errors of a linear model on blocks of
    consecutive rows that are held out in turn. More regressors are taken if they lower the error as
    a whole, and in most blocks. A coefficient that does not need a regressor of another one has no
    slope by it: throttle explains the thrust in CX and may lead CZ astray.

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
        return EngineRegressors(names, np.zeros((Y.shape[1], len(names)), bool))
    fixed = [name for name in names if name not in ENGINE_REGRESSORS]
    engine = [name for name in ENGINE_REGRESSORS if name in names]
    choices: list[tuple[str, ...]] = []
    for size in range(len(engine) + 1):
        choices += combinations(engine, size)
    errors = []
    for choice in choices:
        columns = [names.index(name) for name in (*fixed, *choice)]
        errors.append(_held_out_errors(X[:, columns], Y))
    needed = []
    for of_output in np.transpose(errors, (2, 0, 1)):
        needed.append(choices[_best_choice(of_output)])
    unneeded = {*engine}.difference(*needed)
    chosen = [name for name in names if name not in unneeded]
    without_effect = np.zeros((len(needed), len(chosen)), bool)
    for useless, choice in zip(without_effect, needed, strict=True):
        useless[:] = np.isin(chosen, [name for name in engine if name not in choice])
    return EngineRegressors(chosen, without_effect)


def _best_choice(errors: Matrix) -> int:
    """Return the place of the best choice by errors (choices, blocks), which grow in size."""
    best = 0
    for place in range(1, len(errors)):
        gain = 1 - np.sqrt(np.mean(errors[place] ** 2) / np.mean(errors[best] ** 2))
        is_mostly_better = np.mean(errors[place] < errors[best]) >= MOST_BLOCKS
        if gain > LEAST_GAIN and is_mostly_better:
            best = place
    return best


def _held_out_errors(X: Matrix, Y: Matrix) -> Matrix:
    """Return the errors (blocks, P) of linear models of Y (n, P) on blocks held out in turn, over the spread of Y."""
    spread = np.std(Y, axis=0)
    unit = np.where(spread > 0, spread, 1.0)
    blocks = np.arange(len(Y)) * N_BLOCKS // len(Y)
    errors = []
    for block in range(N_BLOCKS):
        held_out = blocks == block
        model = make_pipeline(StandardScaler(), Ridge(alpha=1.0)).fit(X[~held_out], Y[~held_out])
        residuals = model.predict(X[held_out]) - Y[held_out]
        errors.append(np.sqrt(np.mean(residuals**2, axis=0)) / unit)
    return np.maximum(errors, LEAST_ERROR)
