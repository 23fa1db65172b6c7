"""Seconds, memory and error of whole default fits as flights grow, beside trees and GPyTorch on the same rows.

    python tests/benchmarks/times.py ../shared/data [--no-peers] [--out FOLDER]

2,000 samples are 50 s of viggen's train_latlon, 14,400 all of it; 144,000 are both training
flights, brought to five times their rate between samples. "Ours" is the regressor of identification
with its defaults, choice of structure included; the trees learn what a linear trend leaves, each
output by itself; GPyTorch's is its sparse variational model, 2000 steps. The error is that of the
coefficients of test_twoalt, whose truth is known. Each fit has its own process.
"""

import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import extra_memory, finish, in_own_process, parsed, parser_of
from _peers import OnTrend, SparseLCM, trees

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import normalized_rmse

SIZES = (2000, 14400, 144000)
DENSER = 5
RATE = 40.0  # Hz


class Task(NamedTuple):
    """Regressors and targets (NaN: not observed), and what is asked."""

    X: np.ndarray
    Y: np.ndarray
    Xt: np.ndarray
    truth: np.ndarray

    def error(self, mean):
        return float(normalized_rmse(self.truth, mean))


def flights(folder, train=("train_latlon",)):
    """Return the task of learning flights of the viggen, and predicting another."""
    folder = Path(folder) / "flights"
    craft = Aircraft.from_json(folder / "viggen_uav.json")
    *parts, test = (
        read_flight(folder / f"viggen_uav_{part}.parquet") for part in (*train, "test_twoalt")
    )
    parts = [part.assign(flight=name) for name, part in zip(train, parts, strict=True)]
    table = pd.concat(parts, ignore_index=True)
    targets = aerodynamic_coefficients(table, craft)
    pipeline = make_identification_pipeline(craft)[:-1]
    X, Xt = np.asarray(pipeline.fit_transform(table)), np.asarray(pipeline.transform(test))
    return Task(X, targets.to_numpy(), Xt, test[[f"{name}_true" for name in targets]].to_numpy())


def table(folder, n):
    """Return regressors, targets, times and flights of n samples, and the task that scores a model of them."""
    if n <= len((task := flights(folder)).X):
        return task.X[:n], task.Y[:n], np.arange(n) / RATE, np.zeros(n), task
    task = flights(folder, ("train_latlon", "train_lateral"))
    parts = [dense(*part) for part in zip(np.split(task.X, 2), np.split(task.Y, 2), strict=True)]
    X, Y, time_ = map(np.concatenate, zip(*parts, strict=True))
    return X, Y, time_, np.repeat([0, 1], len(X) // 2), task


def dense(X, Y):
    """Return regressors, targets and times at five times the rate, by linear interpolation."""
    known = np.isfinite(Y).all(axis=1)
    place = np.arange(DENSER * len(X)) / DENSER
    X, Y = (
        np.column_stack([np.interp(place, np.flatnonzero(known), v[known]) for v in part.T])
        for part in (X, Y)
    )
    return X, Y, place / RATE


def fitted(method, X, Y, time_, flight):
    """Return a function that predicts coefficients."""
    if method == "ours":
        return DependentGPRegressor(random_state=0).fit(X, Y, time=time_, flight=flight).predict
    known = np.isfinite(Y).all(axis=1)
    model = OnTrend(trees() if method == "trees" else SparseLCM())
    return model.fit(X[known], Y[known]).predict


def one(folder, method, n):
    """Return the row of one method and size."""
    X, Y, time_, flight, task = table(folder, n)
    taken, models = [], []

    def fit():
        start = time.perf_counter()
        models.append(fitted(method, X, Y, time_, flight))
        taken.append(time.perf_counter() - start)

    memory = extra_memory(fit)
    error = task.error(models[0](task.Xt))
    return {
        "samples": len(X),
        "method": method,
        "fit [s]": taken[0],
        "memory [GB]": memory / 1e9,
        "error": error,
    }


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    parser.add_argument(
        "--one", nargs=2, metavar=("METHOD", "SAMPLES"), help="only this row, as JSON"
    )
    options = parsed(parser, words)
    if options.one:
        print(json.dumps(one(options.data, options.one[0], int(options.one[1]))))
        return
    methods = ["ours"] if options.no_peers else ["ours", "trees", "gpytorch"]
    calls = [(method, n) for n in options.sizes for method in methods]
    rows = [in_own_process(Path(__file__), options.data, "--one", *call) for call in calls]
    finish(options, "times", whole_fits=[row for row in rows if row])


if __name__ == "__main__":
    sys.exit(main())
