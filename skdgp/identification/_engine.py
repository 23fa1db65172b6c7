"""Regressors of a thrust that nothing gives: throttle and airspeed, for the coefficients that need them."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp._compute.messages import without_warnings
from skdgp._compute.typing import Indices, Matrix
from skdgp.preprocessing import RegressorSelector

# Regressors of a thrust that nothing gives
ENGINE_REGRESSORS = ("throttle", "airspeed")
# Least gain of a further regressor, over the error: smaller ones are equal (as of the verdict)
LEAST_GAIN = 0.02
# Fraction of the blocks, at least, in which it lowers the error; a guess
MOST_BLOCKS = 0.6
# Smaller errors of a linear model, over the spread, are equal
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


def engine_regressors(
    selector: RegressorSelector, table: pd.DataFrame, targets: Any, n_blocks: int = 5
) -> EngineRegressors:
    """Return a set of regressors, with those of throttle and airspeed that some coefficient needs.

    For each coefficient each choice of the two is judged by the errors of a linear model on blocks of
    consecutive rows that are held out in turn. More regressors are taken if they lower the error as
    a whole, and in most blocks. A coefficient that does not need a regressor of another one has no
    slope by it: throttle explains the thrust in CX and may lead CZ astray.

    Parameters
    ----------
    selector : RegressorSelector
        Of the set.
    table : DataFrame
        Flights before the selection.
    targets : array-like (n, P)
        Coefficients, NaN where not to be learned from.
    n_blocks : int
    """
    everything = clone(selector).set_params(extra=[*selector.extra, "airspeed"])
    with without_warnings():
        names = list(everything.fit(table).regressors_)
    Y = np.asarray(targets, dtype=float)
    everything_known = np.column_stack([table[names].to_numpy(float), Y])
    is_learned = np.isfinite(everything_known).all(axis=1)
    Y = Y[is_learned]
    if len(Y) < n_blocks * len(names):  # too few to judge
        return EngineRegressors(names, np.zeros((Y.shape[1], len(names)), bool))
    fixed = [name for name in names if name not in ENGINE_REGRESSORS]
    engine = [name for name in ENGINE_REGRESSORS if name in names]
    blocks = np.arange(len(Y)) * n_blocks // len(Y)
    choices = [choice for k in range(len(engine) + 1) for choice in combinations(engine, k)]
    errors = []
    for choice in choices:
        X = table.loc[is_learned, [*fixed, *choice]].to_numpy(float)
        errors.append(_held_out_errors(X, Y, blocks))
    needed = [choices[_best_choice(of_choices)] for of_choices in np.transpose(errors, (2, 0, 1))]
    chosen = [name for name in names if name in fixed or any(name in each for each in needed)]
    without_effect = np.zeros((len(needed), len(chosen)), bool)
    for output, each in enumerate(needed):
        for place, name in enumerate(chosen):
            without_effect[output, place] = name in engine and name not in each
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


def _held_out_errors(X: Matrix, Y: Matrix, blocks: Indices) -> Matrix:
    """Return the errors (blocks, P) of linear models of Y (n, P) on blocks held out in turn, over the spread of Y."""
    spread = np.std(Y, axis=0)
    errors = []
    for block in np.unique(blocks):
        held_out = blocks == block
        model = make_pipeline(StandardScaler(), Ridge(alpha=1.0)).fit(X[~held_out], Y[~held_out])
        residuals = model.predict(X[held_out]) - Y[held_out]
        relative = np.sqrt(np.mean(residuals**2, axis=0)) / np.where(spread > 0, spread, 1.0)
        errors.append(np.maximum(relative, LEAST_ERROR))
    return np.array(errors)
