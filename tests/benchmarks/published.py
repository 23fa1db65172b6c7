"""Published benchmarks of dependent outputs, with skdgp's defaults, and other methods.

    python tests/benchmarks/published.py FOLDER --out OUT [--methods M]

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

No setting is chosen by a hidden value.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import Kept, contest, finish, parser_of
from _peers import Process
from scipy.io import loadmat
from sklearn.experimental import enable_iterative_imputer  # noqa: F401 - makes it importable
from sklearn.impute import IterativeImputer, SimpleImputer
from sklearn.linear_model import BayesianRidge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import interval_coverage

SINGLE_LIMIT = 2000  # rows of scikit-learn
LCM_LIMIT = 4000
N_LATENT = 4


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
    Y = truth.copy()
    hidden = np.full_like(truth, np.nan)
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
    x = x[known]
    degrees = np.where(degrees == -1, np.nan, degrees)[known]
    gaps = {"Cambermet": (1, (x >= 10.2) & (x <= 10.8)), "Chimet": (2, (x >= 13.5) & (x <= 14.2))}
    return case_of(x, degrees, gaps)


def eeg(folder):
    """Return voltages of seven electrodes at 256 Hz: the first trial of control subject 337."""
    path = folder / "co2c0000337.rd.000.gz"
    names = ["F3", "F4", "F5", "F6", "FZ", "F1", "F2"]
    sites = np.genfromtxt(path, usecols=[1], dtype=str)
    values = np.genfromtxt(path, usecols=[3])
    gaps = {name: (names.index(name), slice(156, 256)) for name in ("FZ", "F1", "F2")}
    voltages = np.column_stack([values[sites == name] for name in names])
    return case_of(np.arange(256) / 256, voltages, gaps, by_hidden=True)


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


CASES = {
    "exchange rates, 13": exchange_rates,
    "air temperature, 4 stations": air_temperature,
    "EEG, 7 electrodes": eeg,
    "Jura": jura,
    "Jura, logarithms": partial(jura, logarithms=True),
}


def toy(folder):
    """Return two outputs, one with a gap, for a run that only shows that the script runs."""
    x = np.arange(40.0)
    outputs = np.column_stack([np.sin(x / 5), np.cos(x / 5)])
    return case_of(x, outputs, {"second": (1, slice(10, 20))})


PUBLISHED = {
    "exchange rates, 13": "0.2125, COGP",
    "air temperature, 4 stations": "0.1077, COGP",
    "EEG, 7 electrodes": "0.26, GPAR",
    "Jura": "0.4525, GPRN",
    "Jura, logarithms": "0.3996, GPAR",
}


def predicted(case):
    model = DependentGPRegressor(random_state=0).fit(case.X, case.Y)
    return model.predict(case.X, return_std=True, include_noise=True)


def iterated(case):
    """Complete the scaled table of regressors and outputs in two rounds of regressions, without deviations."""
    scaler = StandardScaler()
    table = scaler.fit_transform(np.hstack([case.X, case.Y]))
    model = DependentGPRegressor(structure="joint", random_state=0)
    filled = IterativeImputer(model, max_iter=2, random_state=0).fit_transform(table)
    mean = scaler.inverse_transform(filled)[:, case.X.shape[1] :]
    return mean, np.full_like(mean, np.nan)


def by_output(case, make, regressors=True, others=True, **switches):
    """Fit each tested output alone, to at most 2000 rows, from the regressors, the other outputs or both.

    ``switches`` are of the prediction.
    """
    mean, std = np.full((2, *case.Y.shape), np.nan)
    for k in case.tested.values():
        observed = np.isfinite(case.Y[:, k])
        known = np.isnan(case.Y[~observed]).mean(axis=0) < 0.5
        parts = [case.X] * regressors + [case.Y[:, known]] * others
        inputs = make_pipeline(SimpleImputer(), StandardScaler()).fit_transform(np.hstack(parts))
        rows = np.flatnonzero(observed)[:SINGLE_LIMIT]
        model = make().fit(inputs[rows], case.Y[rows, k])
        mean[:, k], std[:, k] = model.predict(inputs, return_std=True, **switches)
    return mean, std


_JURA = {"scale": 10.0, "noise": 0.1, "replace": True}
# Settings of the examples; a scale of 0.1 years is 25 working days
GPAR = {
    "exchange rates, 13": {"scale": 25.0, "linear": True, "linear_scale": 10.0, "rq": True},
    "EEG, 7 electrodes": {"scale": 0.02},
    "air temperature, 4 stations": _JURA | {"scale": 0.2, "linear": True, "linear_scale": 10.0},
    "Jura": _JURA,
    "Jura, logarithms": _JURA,
}


def gpar(case):
    """Fit GPAR, outputs with most values first; the deviation is the width of its 95 % interval over 3.92."""
    from gpar import GPARRegressor

    np.random.seed(0)  # noqa: NPY002 - GPAR draws by it
    settings = {"linear": False, "nonlinear_scale": 1.0, "noise": 0.01, **GPAR.get(case.name, {})}
    if len(case.X) > 500:
        settings["x_ind"] = np.linspace(case.X.min(), case.X.max(), 151)
    model = GPARRegressor(nonlinear=True, impute=True, normalise_y=True, **settings)
    order = np.argsort(np.isnan(case.Y).sum(axis=0), kind="stable")
    model.fit(case.X, case.Y[:, order])
    found = model.predict(case.X, num_samples=200, credible_bounds=True, latent=False)
    mean, low, high = (values[:, np.argsort(order)] for values in found)
    return mean, (high - low) / 3.92


def lcm(case):
    """Fit GPyTorch's LCM of four processes to scaled outputs, as its example of incomplete tasks: 100 steps of Adam.

    Of more than 4000 values every second row is left out.
    """
    from _gpytorch import gapped_lcm

    X = StandardScaler().fit_transform(case.X)
    scaler = StandardScaler()
    Y = scaler.fit_transform(case.Y)
    if np.isfinite(Y).sum() > LCM_LIMIT:
        Y[1::2] = np.nan
    mean, std = gapped_lcm(X, Y, N_LATENT)
    return scaler.inverse_transform(mean), std * scaler.scale_


PROCESS = partial(Process, searches=3)
METHODS = {
    "skdgp, `predict`": predicted,
    "skdgp on regressors and other outputs": partial(
        by_output, make=partial(DependentGPRegressor, random_state=0), include_noise=True
    ),
    "skdgp in `IterativeImputer`": iterated,
    "GPAR": gpar,
    "GPyTorch's LCM, four processes": lcm,
    "Bayesian ridge on the other outputs": partial(by_output, make=BayesianRidge, regressors=False),
    "scikit-learn's process on regressors and other outputs": partial(by_output, make=PROCESS),
    "the same, one width": partial(by_output, make=partial(PROCESS, one_width=True)),
    "scikit-learn's process, each output alone": partial(by_output, make=PROCESS, others=False),
}


def scored(case, method):
    """Return errors, and fraction in the 95 % band, of each tested output."""
    mean, std = METHODS[method](case)
    errors = []
    held = []
    for k in case.tested.values():
        asked = np.isfinite(case.hidden[:, k])
        y = case.hidden[asked, k]
        m = mean[asked, k]
        s = std[asked, k]
        if case.name.startswith("Jura"):
            errors.append(np.mean(np.abs(case.inverse(y) - case.inverse(m))))
        else:
            errors.append(np.mean((y - m) ** 2) / np.mean((y - case.centre[k]) ** 2))
        if np.isfinite(s).all():
            held.append(interval_coverage(y, m, s))
    result = {"error": np.mean(errors)}
    if held:
        result["held"] = 100 * np.mean(held)
    return result


def main(words=None):
    parser = parser_of(__doc__, data=True, smoke=True)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args(words)
    others = {name for name in METHODS if not name.startswith("skdgp")}
    kept = Kept(options, "published", others=others)
    for name, load in ({"toy": toy} if options.smoke else CASES).items():
        case = load(options.data)._replace(name=name)
        for method in options.methods:
            # kept runs of other methods are named with their seed
            kept.run({"case": name, "method": method, "seed": 0}, scored, case, method)
    cells = contest(kept.table, "case")
    cells.loc["published figures"] = pd.Series(PUBLISHED)
    errors = cells.reset_index(names="method").to_dict("records")
    finish(options, "published", errors=errors)


if __name__ == "__main__":
    main()
