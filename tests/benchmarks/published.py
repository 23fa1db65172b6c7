"""Published benchmarks of dependent outputs, with skdgp's defaults and other packages on the same data.

    python tests/benchmarks/published.py FOLDER --out OUT [--cases C] [--methods M] [--seeds 0 1 2 3 4] [--redo]

Parts of some outputs are hidden, and predicted from the rest of these and from the other outputs.
SMSE of an output is the mean squared error of its hidden values over their mean squared distance
from a mean, see ``Case``. FOLDER holds:

- ``fx2007-processed.csv``, ``bra.mat``, ``cam.mat``, ``chi.mat``, ``sot.mat`` and
  ``sarcos_inv_test.mat``, from ``data/fx``, ``data/weather`` and ``data/sarcos`` of
  https://github.com/trungngv/cogp;
- ``co2c0000337.rd.000.gz``, from ``examples/data/smni_eeg/c_1_co2c0000337.tar.gz`` of
  https://github.com/GAMES-UChile/mogptk.

The Friedman cases need no file: complete outputs, where methods differ in time alone.

Nguyen & Bonilla (2014) learn torques of the SARCOS arm from 44,484 samples in ``sarcos_inv.mat``,
which could not be had: here their test file is divided, so their figures are not comparable. No
setting is chosen by a hidden value. Each run is kept as OUT/published/CASE-METHOD-SEED.json, and
not run again unless ``--redo`` says so; the tables are of all runs that are there.
OUT/published.png shows the exchange rates.
"""

import sys
import time
import warnings
from contextlib import redirect_stdout
from functools import partial
from importlib.util import find_spec
from io import StringIO
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _common import finish, parsed, parser_of
from comparison import Kept
from scipy.io import loadmat
from scipy.linalg import solve_triangular
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import interval_coverage

# SMSE and NLPD; Nguyen & Bonilla (2014), tables 1 and 2; Alvarez et al. (2010); Requeima et al.
# (2019), from memory
PUBLISHED: dict[str, dict[str, tuple[float, float | None]]] = {
    "exchange_rates": {
        "collaborative (COGP)": (0.2125, -0.8394),
        "convolved, exact": (0.2427, -2.9474),
        "convolved, variational": (0.2795, None),
        "intrinsic coregionalisation": (0.3927, None),
        "independent": (0.5996, 0.4082),
    },
    "air_temperature": {
        "collaborative (COGP)": (0.1077, 2.1712),
        "convolved, exact": (0.1125, 2.2219),
        "independent": (0.8944, 12.5319),
    },
    "EEG": {"autoregressive (GPAR-NL)": (0.26, None), "independent": (1.75, None)},
}
SINGLE_LIMIT = 2000  # rows of scikit-learn
LCM_LIMIT = 2000  # values; 200 steps for the 3051 of the exchange rates did not end in 27 minutes


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


def sarcos(folder):
    """Return torques of joints 4 and 7: of 4449 samples 1000 are hidden, and 2000 of joint 4 are known."""
    samples = np.random.default_rng(0).permutation(
        loadmat(folder / "sarcos_inv_test.mat")["sarcos_inv_test"]
    )
    gaps = {"joint 4": (0, slice(3449, None)), "joint 7": (1, slice(3449, None))}
    case = case_of(samples[:, 0], samples[:, [24, 27]], gaps)
    case.Y[2000:, 0] = np.nan
    return case._replace(X=samples[:, :21])


def friedman(folder, n):
    """Return three mixtures of two functions of Friedman (1991, equation 61), at n samples with noise and 1000 more."""
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(n + 1000, 5))
    a, b, c, d, e = np.stack([X.T, np.roll(X.T, 2, axis=0)], axis=1)
    first, second = 10 * np.sin(np.pi * a * b) + 20 * (c - 0.5) ** 2 + 10 * d + 5 * e
    truth = np.column_stack([first, second, first - 0.5 * second])
    gaps = {f"output {k + 1}": (k, slice(n, None)) for k in range(3)}
    return case_of(X[:, 0], truth + 0.1 * rng.normal(size=truth.shape), gaps)._replace(X=X)


def toy(folder):
    """Return two outputs of one signal."""
    x = np.linspace(0, 6, 60)
    noise = 0.05 * np.random.default_rng(0).normal(size=(60, 2))
    return case_of(x, np.sin(x)[:, None] * [1, -2] + noise, {"second": (1, slice(20, 40))})


CASES = {
    "exchange_rates": exchange_rates,
    "air_temperature": air_temperature,
    "EEG": eeg,
    "SARCOS": sarcos,
    **{f"Friedman_{n}": partial(friedman, n=n) for n in (100, 300, 500, 2000)},
}


def skdgp(case, seed):
    model = DependentGPRegressor(random_state=seed).fit(case.X, case.Y)
    return model.predict(case.X, return_std=True, include_noise=True)


def scikit_learn(case, seed):
    """Fit each tested output alone, to at most 2000 rows."""
    mean, std = np.full((2, *case.Y.shape), np.nan)
    X, width = StandardScaler().fit_transform(case.X), np.ones(case.X.shape[1])
    for k in case.tested.values():
        kernel, rows = (
            ConstantKernel() * RBF(width) + WhiteKernel(),
            np.flatnonzero(np.isfinite(case.Y[:, k])),
        )
        rows = rows[:SINGLE_LIMIT]
        n_restarts = 2 if X.shape[1] == 1 else 0  # in one input searches end at several optima
        model = GaussianProcessRegressor(
            kernel, n_restarts_optimizer=n_restarts, normalize_y=True, random_state=seed
        )
        mean[:, k], std[:, k] = model.fit(X[rows], case.Y[rows, k]).predict(X, return_std=True)
    return mean, std


def gpytorch_lcm(case, seed):
    """Fit the exact linear model of coregionalisation by Cholesky, from a start that is always the same.

    GPyTorch's variance takes missing values for known ones, so it is computed here from GPyTorch's
    covariance.
    """
    import gpytorch
    import torch
    from _peers import ExactLCM

    if np.isfinite(case.Y).sum() > LCM_LIMIT:
        raise ValueError(f"left out above {LCM_LIMIT} values")
    X, scaler = StandardScaler().fit_transform(case.X), StandardScaler().fit(case.Y)
    Y = scaler.transform(case.Y)
    with (
        gpytorch.settings.observation_nan_policy("mask"),
        gpytorch.settings.max_cholesky_size(LCM_LIMIT),
    ):
        model = ExactLCM(n_steps=200).fit(X, Y)
        mean = scaler.inverse_transform(model.predict(X))
    known = np.isfinite(Y).ravel()
    K = model.model.covar_module(torch.as_tensor(X)).to_dense().detach().numpy()
    noise = np.tile(model.likelihood.task_noises.detach().numpy(), len(X))
    root = np.linalg.cholesky(K[np.ix_(known, known)] + np.diag(noise[known]))
    variance = np.diag(K) + noise - (solve_triangular(root, K[known], lower=True) ** 2).sum(axis=0)
    return mean, scaler.scale_ * np.sqrt(variance.reshape(Y.shape))


def gpar(case, seed):
    """Fit the autoregressive model with the settings of its authors' script for the EEG."""
    from gpar import GPARRegressor

    np.random.seed(seed)  # noqa: NPY002, what GPAR draws from
    nonlinear = {"linear": False, "nonlinear": True, "scale": 0.02, "nonlinear_scale": 1.0}
    model = GPARRegressor(**nonlinear, noise=0.01, impute=True, replace=False, normalise_y=True)
    x = case.X[:, 0]
    with redirect_stdout(StringIO()):  # it counts samples
        model.fit(x, case.Y)
        mean, low, high = model.predict(x, num_samples=200, credible_bounds=True, latent=False)
    return mean, (high - low) / 3.92


METHODS = {  # function, package
    "skdgp": (skdgp, "skdgp"),
    "scikit-learn, each output alone": (scikit_learn, "sklearn"),
    "GPyTorch LCM": (gpytorch_lcm, "gpytorch"),
    "GPAR": (gpar, "gpar"),
}


def run(case, method, seed):
    """Return scores of one fit by name, with its prediction of the tested outputs; or the error that ended it."""
    function, package = METHODS[method]
    if find_spec(package) is None:
        return {"error": "not installed"}
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mean, std = function(case, seed)
    except Exception as error:  # of another package: a row of the table says so
        if method == "skdgp":
            raise
        return {"error": str(error).partition("\n")[0][:100] or type(error).__name__}
    return {
        "seconds": time.process_time() - start,
        "outputs": list(case.tested),
        **scores(case, mean, std),
    }


def scores(case, mean, std):
    """Return SMSE, share of hidden values in the 95 % band, negative log density, and curves, of each tested output."""
    found: dict[str, list] = {"SMSE": [], "held": [], "NLPD": [], "mean": [], "std": []}
    for k in case.tested.values():
        asked = np.isfinite(case.hidden[:, k])
        y, m, s = case.hidden[asked, k], mean[asked, k], std[asked, k]
        found["SMSE"].append(np.mean((y - m) ** 2) / np.mean((y - case.centre[k]) ** 2))
        found["held"].append(float(interval_coverage(y, m, s)))
        found["NLPD"].append(np.mean(((y - m) / s) ** 2 + np.log(2 * np.pi * s**2)) / 2)
        found["mean"].append(mean[:, k].tolist())
        found["std"].append(std[:, k].tolist())
    return found


def tables(runs):
    """Return a table of each case: methods that ran, then what is published."""
    found = {}
    for case in dict.fromkeys(run["case"] for run in runs):
        of_case = [run for run in runs if run["case"] == case]
        outputs: list[str] = next((run["outputs"] for run in of_case if "outputs" in run), [])
        rows = [
            row([run for run in of_case if run["method"] == method], method, outputs)
            for method in METHODS
        ]
        for name, (smse, nlpd) in PUBLISHED.get(case, {}).items():
            rows.append(empty(f"published: {name}", outputs) | {"SMSE": smse, "NLPD": nlpd})
        found[case] = list(filter(None, rows))
    return found


def empty(method, outputs):
    names = (
        "seeds",
        "CPU s",
        *(f"SMSE {name}" for name in outputs),
        "SMSE",
        "SMSE, worst",
        "in the band %",
        "NLPD",
    )
    return {"method": method, **dict.fromkeys(names)}


def row(runs, method, outputs):
    """Return the means over seeds of one method; None where it was not asked for."""
    errors = [run["error"] for run in runs if "error" in run]
    if errors or not runs:
        return empty(f"{method}: {errors[0]}", outputs) if errors else None
    smse = np.array([run["SMSE"] for run in runs])
    return {
        "method": f"**{method}**" if method == "skdgp" else method,
        "seeds": len(runs),
        "CPU s": round(float(np.median([run["seconds"] for run in runs])), 1),
        **{
            f"SMSE {name}": float(value)
            for name, value in zip(outputs, smse.mean(axis=0), strict=True)
        },
        "SMSE": float(smse.mean()),
        "SMSE, worst": float(smse.mean(axis=1).max()),
        "in the band %": 100 * float(np.mean([run["held"] for run in runs])),
        "NLPD": float(np.mean([run["NLPD"] for run in runs])),
    }


def picture(case, runs):
    """Draw the gaps: known and hidden values, skdgp with its band, and the process of the output alone."""
    import matplotlib.pyplot as plt

    from skdgp._display.style import PALETTE, tidy

    figure, axes = plt.subplots(
        1, len(case.tested), figsize=(9.6, 3.2), layout="constrained", squeeze=False
    )
    for i, (ax, (name, k)) in enumerate(zip(axes[0], case.tested.items(), strict=True)):
        x = case.X[:, 0]
        ax.plot(x, case.Y[:, k], ".", color=PALETTE["grey"], markersize=3, label="known")
        ax.plot(x, case.hidden[:, k], ".", color="black", markersize=3, label="hidden")
        for method, colour in {
            "skdgp": "blue",
            "scikit-learn, each output alone": "vermillion",
        }.items():
            found = [run for run in runs if run["method"] == method and "mean" in run]
            for run in found[:1]:
                mean, half = np.array(run["mean"][i]), 1.96 * np.array(run["std"][i])
                ax.plot(x, mean, color=PALETTE[colour], linewidth=1, label=method)
                ax.fill_between(
                    x, mean - half, mean + half, color=PALETTE[colour], alpha=0.15, linewidth=0
                )
        ax.set(title=name, xlabel="day")
        tidy(ax)
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
    )
    return figure


def main(words=None):
    parser = parser_of(__doc__, redo=True, smoke=True)
    parser.add_argument("data", type=Path, nargs="?", help="folder of the data, see above")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    options = parsed(parser, words)
    cases = {name: CASES[name] for name in options.cases}
    if options.smoke:
        cases, options.seeds = {"toy": toy}, [0]
    methods = ["skdgp"] if options.no_peers else options.methods
    kept = Kept(options.out, "published")
    for name, load in cases.items():
        case = load(options.data)
        for method, seed in product(methods, options.seeds):
            key = f"{name}-{method}-{seed}"
            left_out = (method == "GPAR" and name != "EEG") or (
                method == "GPyTorch LCM" and seed != options.seeds[0]
            )
            if left_out or (key in kept and not options.redo):
                continue
            result = {"case": name, "method": method, "seed": seed, **run(case, method, seed)}
            kept.keep(key, result)
            said = (
                result.get("error")
                or f"SMSE {np.mean(result['SMSE']):.4f}, {result['seconds']:.0f} s"
            )
            print(f"{key}: {said}", file=sys.stderr, flush=True)
        if options.out and find_spec("matplotlib") and name in ("exchange_rates", "toy"):
            of_case = [run for run in kept.memory.values() if run["case"] == name]
            picture(case, of_case).savefig(options.out / "published.png", dpi=110)
    finish(options, "published", **tables(list(kept.memory.values())))


if __name__ == "__main__":
    main()
