"""Published benchmarks of dependent outputs, with skdgp's defaults, and other methods.

    python tests/benchmarks/published.py FOLDER --out OUT [--methods M] [--seeds 0 1 2 3 4]

Parts of some outputs are hidden, and predicted from the rest of these and from the other outputs,
which are known in these rows. Methods "on the other outputs" take as inputs those that are known in
most rows of the gap; their few missing values are replaced by the mean. GPAR has the settings of its
authors' examples (https://github.com/wesselb/gpar), with the case's gaps as they are.
SMSE of an output is the mean squared error of its hidden values over their mean squared distance
from a mean, see ``Case``. FOLDER holds:

- ``fx2007-processed.csv``, ``bra.mat``, ``cam.mat``, ``chi.mat`` and ``sot.mat``, from ``data/fx``
  and ``data/weather`` of https://github.com/trungngv/cogp;
- ``co2c0000337.rd.000.gz``, from ``examples/data/smni_eeg/c_1_co2c0000337.tar.gz`` of
  https://github.com/GAMES-UChile/mogptk;
- ``jura/jura_prediction.csv`` and ``jura/jura_validation.csv``, from the R package gstat: scored by
  the mean absolute error of cadmium.

A case whose file is missing is left out, with a message.

The Friedman cases need no file: complete outputs, where methods differ in time alone.

No setting is chosen by a hidden value. Each run is kept as OUT/published/CASE-METHOD-SEED.json, and
not run again while that file is there; the tables are of all runs that are there.
"""

import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import Kept, finish, parsed, parser_of
from scipy.io import loadmat
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.impute import SimpleImputer
from sklearn.linear_model import BayesianRidge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import interval_coverage

SINGLE_LIMIT = 2000  # rows of scikit-learn
LCM_LIMIT, N_LATENT = 4000, 4


class Case(NamedTuple):
    """Inputs (n, 1), outputs (n, P) with NaN where not known, hidden values (n, P) with NaN elsewhere.

    ``centre`` (P,): the means that SMSE is measured from, of known values or of hidden ones, as in
    the publication.
    """

    X: np.ndarray
    Y: np.ndarray
    hidden: np.ndarray
    tested: dict[str, int]
    centre: np.ndarray
    name: str = ""
    # From an output to the values of which the absolute error is taken
    inverse: Callable = np.asarray


def case_of(x, truth, gaps, *, by_hidden=False):
    """Return the case that hides these gaps, a dict of name to (column, rows)."""
    Y, hidden = truth.copy(), np.full_like(truth, np.nan)
    for column, rows in gaps.values():
        Y[rows, column], hidden[rows, column] = np.nan, truth[rows, column]
    tested = {name: column for name, (column, _) in gaps.items()}
    centre = np.full(truth.shape[1], np.nan)
    for column in tested.values():
        centre[column] = np.nanmean((hidden if by_hidden else Y)[:, column])
    return Case(np.reshape(x, (-1, 1)), Y, hidden, tested, centre)


def exchange_rates(folder):
    """Return US dollars for ten currencies and three metals on the 251 working days of 2007."""
    per_dollar = np.genfromtxt(folder / "fx2007-processed.csv", delimiter=",")
    rates = np.where(per_dollar == -1, np.nan, 1 / per_dollar)
    gaps = {"CAD": (3, slice(49, 100)), "JPY": (5, slice(99, 150)), "AUD": (8, slice(149, 200))}
    return case_of(np.arange(1.0, len(rates) + 1), rates, gaps)


def air_temperature(folder):
    """Return air temperatures, every five minutes, at four stations from 10 to 15 July 2013."""
    stations = [loadmat(folder / f"{name}.mat") for name in ("bra", "cam", "chi", "sot")]
    x = stations[0]["x"][:, 0]
    degrees = np.column_stack([station["y"][:, 3] for station in stations]).astype(float)
    known = (x >= 10) & (x <= 15)
    x, degrees = x[known], np.where(degrees == -1, np.nan, degrees)[known]
    gaps = {"Cambermet": (1, (x >= 10.2) & (x <= 10.8)), "Chimet": (2, (x >= 13.5) & (x <= 14.2))}
    return case_of(x, degrees, gaps)


def eeg(folder):
    """Return voltages of seven electrodes at 256 Hz: the first trial of control subject 337."""
    path, names = folder / "co2c0000337.rd.000.gz", ["F3", "F4", "F5", "F6", "FZ", "F1", "F2"]
    sites, values = np.genfromtxt(path, usecols=[1], dtype=str), np.genfromtxt(path, usecols=[3])
    gaps = {name: (names.index(name), slice(156, 256)) for name in ("FZ", "F1", "F2")}
    voltages = np.column_stack([values[sites == name] for name in names])
    return case_of(np.arange(256) / 256, voltages, gaps, by_hidden=True)


def friedman(folder, n):
    """Return three mixtures of two functions of Friedman (1991, equation 61), at n samples with noise and 1000 more."""
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(n + 1000, 5))
    a, b, c, d, e = np.stack([X.T, np.roll(X.T, 2, axis=0)], axis=1)
    first, second = 10 * np.sin(np.pi * a * b) + 20 * (c - 0.5) ** 2 + 10 * d + 5 * e
    truth = np.column_stack([first, second, first - 0.5 * second])
    gaps = {f"output {k + 1}": (k, slice(n, None)) for k in range(3)}
    return case_of(X[:, 0], truth + 0.1 * rng.normal(size=truth.shape), gaps)._replace(X=X)


def jura(folder, logarithms=False):
    """Return cadmium, nickel and zinc in Swiss Jura; cadmium is hidden at the last 100 of 359 sites."""
    parts = [
        pd.read_csv(folder / "jura" / f"jura_{name}.csv") for name in ("prediction", "validation")
    ]
    both = pd.concat(parts, ignore_index=True)
    metals = both[["Cd", "Ni", "Zn"]].to_numpy(float)
    gaps = {"Cd": (0, slice(len(parts[0]), None))}
    case = case_of(both["Xloc"], np.log(metals) if logarithms else metals, gaps)
    X = both[["Xloc", "Yloc"]].to_numpy()
    return case._replace(X=X, inverse=np.exp if logarithms else np.asarray)


def toy(folder):
    """Return two outputs of one signal."""
    x = np.linspace(0, 6, 60)
    noise = 0.05 * np.random.default_rng(0).normal(size=(60, 2))
    return case_of(x, np.sin(x)[:, None] * [1, -2] + noise, {"second": (1, slice(20, 40))})


CASES = {
    "exchange_rates": exchange_rates,
    "air_temperature": air_temperature,
    "EEG": eeg,
    "Jura": jura,
    "Jura, logarithms": partial(jura, logarithms=True),
    **{f"Friedman_{n}": partial(friedman, n=n) for n in (500, 2000)},
}


def skdgp(case, seed):
    model = DependentGPRegressor(random_state=seed).fit(case.X, case.Y)
    return model.impute(case.X, case.Y, return_std=True)


def process_of(n_inputs, seed):
    """Return scikit-learn's process with a width for each input, and noise."""
    kernel = ConstantKernel() * RBF(np.ones(n_inputs)) + WhiteKernel()
    return GaussianProcessRegressor(
        kernel,
        n_restarts_optimizer=2
        if n_inputs == 1
        else 0,  # in one input searches end at several optima
        normalize_y=True,
        random_state=seed,
    )


def by_output(case, seed, make, regressors=True, others=True):
    """Fit each tested output alone, to at most 2000 rows, from the regressors, the other outputs or both."""
    mean, std = np.full((2, *case.Y.shape), np.nan)
    for k in case.tested.values():
        observed = np.isfinite(case.Y[:, k])
        known = np.isnan(case.Y[~observed]).mean(axis=0) < 0.5
        parts = [case.X] * regressors + [case.Y[:, known]] * others
        inputs = make_pipeline(SimpleImputer(), StandardScaler()).fit_transform(np.hstack(parts))
        rows = np.flatnonzero(observed)[:SINGLE_LIMIT]
        model = make(inputs.shape[1], seed).fit(inputs[rows], case.Y[rows, k])
        mean[:, k], std[:, k] = model.predict(inputs, return_std=True)
    return mean, std


_JURA = {"scale": 10.0, "noise": 0.1, "replace": True}
# Settings of the examples; a scale of 0.1 years is 25 working days
GPAR = {
    "exchange_rates": {"scale": 25.0, "linear": True, "linear_scale": 10.0, "rq": True},
    "EEG": {"scale": 0.02},
    "air_temperature": _JURA | {"scale": 0.2, "linear": True, "linear_scale": 10.0},
    "Jura": _JURA,
    "Jura, logarithms": _JURA,
}


def gpar(case, seed):
    """Fit GPAR, outputs with most values first; the deviation is the width of its 95 % interval over 3.92."""
    from gpar import GPARRegressor

    np.random.seed(seed)  # noqa: NPY002 - GPAR draws by it
    settings = {"linear": False, "nonlinear_scale": 1.0, "noise": 0.01, **GPAR.get(case.name, {})}
    if len(case.X) > 500:
        settings["x_ind"] = np.linspace(case.X.min(), case.X.max(), 151)
    model = GPARRegressor(nonlinear=True, impute=True, normalise_y=True, **settings)
    order = np.argsort(np.isnan(case.Y).sum(axis=0), kind="stable")
    model.fit(case.X, case.Y[:, order])
    found = model.predict(case.X, num_samples=200, credible_bounds=True, latent=False)
    mean, low, high = (values[:, np.argsort(order)] for values in found)
    return mean, (high - low) / 3.92


def lcm(case, seed):
    """Fit GPyTorch's LCM of four processes to scaled outputs, as its example of incomplete tasks: 100 steps of Adam.

    Of more than 4000 values every second row is left out but in the tested outputs.
    """
    from _gpytorch import gapped_lcm

    X, scaler = StandardScaler().fit_transform(case.X), StandardScaler()
    Y = scaler.fit_transform(case.Y)
    if np.isfinite(Y).sum() > LCM_LIMIT:
        others = np.setdiff1d(np.arange(Y.shape[1]), list(case.tested.values()))
        Y[np.ix_(np.arange(1, len(Y), 2), others)] = np.nan
    mean, std = gapped_lcm(X, Y, seed, N_LATENT)
    return scaler.inverse_transform(mean), std * scaler.scale_


METHODS = {
    "skdgp": skdgp,
    "GPAR": gpar,
    "GPyTorch's LCM": lcm,
    "Bayesian ridge on the other outputs": partial(
        by_output, make=lambda *_: BayesianRidge(), regressors=False
    ),
    "scikit-learn on regressors and other outputs": partial(by_output, make=process_of),
    "scikit-learn, each output alone": partial(by_output, make=process_of, others=False),
}
COMPLETE = "skdgp", "scikit-learn, each output alone"  # methods of cases without other outputs


def run(case, method, seed):
    """Return the scores of one fit."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        mean, std = METHODS[method](case, seed)
    return {"seconds": time.process_time() - start, **scores(case, mean, std)}


def scores(case, mean, std):
    """Return errors, and fraction in the 95 % band, of each tested output."""
    found = {"SMSE": [], "MAE": [], "held": []}
    for k in case.tested.values():
        asked = np.isfinite(case.hidden[:, k])
        y, m, s = case.hidden[asked, k], mean[asked, k], std[asked, k]
        found["SMSE"].append(np.mean((y - m) ** 2) / np.mean((y - case.centre[k]) ** 2))
        found["MAE"].append(np.mean(np.abs(case.inverse(y) - case.inverse(m))))
        found["held"].append(float(interval_coverage(y, m, s)))
    return found


def table(runs):
    """Return a row for each case and method, means over seeds, then the published figures."""
    rows = []
    for case, method in dict.fromkeys((run["case"], run["method"]) for run in runs):
        some = [run for run in runs if (run["case"], run["method"]) == (case, method)]
        smse, mae = (np.array([run[name] for run in some]) for name in ("SMSE", "MAE"))
        row = {"data": case, "method": method, "SMSE": float(smse.mean())}
        row["MAE, median"] = float(np.median(mae))
        row["in the 95 % band, %"] = 100 * float(np.mean([run["held"] for run in some]))
        row["CPU s"] = float(np.median([run["seconds"] for run in some]))
        rows.append(row)
    return rows


def main(words=None):
    parser = parser_of(__doc__, data=True, smoke=True)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    options = parsed(parser, words)
    cases = CASES
    if options.smoke:
        cases, options.seeds = {"toy": toy}, [0]
    kept = Kept(options.out, "published")
    for name, load in cases.items():
        try:
            case = load(options.data)._replace(name=name)
        except FileNotFoundError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
            continue
        complete = len(case.tested) == case.Y.shape[1]
        methods = [m for m in options.methods if not complete or m in COMPLETE]
        for method, seed in product(methods, options.seeds):
            key = f"{name}-{method}-{seed}"
            if key not in kept:
                kept.keep(key, {"case": name, "method": method, **run(case, method, seed)})
                print(f"{key}: SMSE {np.mean(kept.memory[key]['SMSE']):.4f}", file=sys.stderr)
    finish(options, "published", errors=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
