"""What trends are worth, on training flights alone: no test flight is read.

    python tests/benchmarks/structure.py ../shared/data [--out FOLDER] [--samples N]

Learned from N samples spread over one training flight, scored on the measured coefficients of another, or, where there
is one flight alone, on the odd eighths of it after learning from the even ones. Inputs are those of the identification
pipeline; inference is exact, regressors count as exact.
"""

import json
import time
import warnings

import numpy as np
from _common import finish, parsed, parser_of
from sklearn.exceptions import ConvergenceWarning
from sklearn.preprocessing import PolynomialFeatures

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import negative_log_predictive_density, normalized_rmse
from skdgp.model_selection import thin_targets

PAIRS = {  # aircraft, learned from, scored on
    "viggen lateral to latlon": ("viggen_uav", "train_lateral", "train_latlon"),
    "viggen latlon to lateral": ("viggen_uav", "train_latlon", "train_lateral"),
    "c172p eighths": ("c172p", "train_latlon", None),
}
PARTS = {  # samples, regressors, and what is compared
    "trend": (
        300,
        "quasi-steady",
        {"constant": {"trend": "constant"}, "linear": {}, "PolynomialFeatures(2)": {"trend": PolynomialFeatures(2)}},
    )
}
EVERY = 4  # of the rows that are scored


class Task:
    """Inputs and measured coefficients of two flights, or of the even and odd eighths of one."""

    def __init__(self, pair, data, regressors, n_samples):
        name, learned, scored = PAIRS[pair]
        folder = data / "flights"
        aircraft = Aircraft.from_json(folder / f"{name}.json")
        flight = read_flight(folder / f"{name}_{learned}.parquet")
        inputs = make_identification_pipeline(aircraft, regressors=regressors)[:-1]
        X, Y = inputs.fit_transform(flight), aerodynamic_coefficients(flight, aircraft)
        if scored is None:
            even = np.arange(len(Y)) * 8 // len(Y) % 2 == 0
            self.test = X[~even], Y[~even]
            Y = Y[even].reset_index(drop=True)
            X = X[even]
        else:
            other = read_flight(folder / f"{name}_{scored}.parquet")
            self.test = inputs.transform(other), aerodynamic_coefficients(other, aircraft)
        self.train = np.asarray(X), thin_targets(Y, n_samples)
        self.test = np.asarray(self.test[0])[::EVERY], self.test[1].to_numpy()[::EVERY]


def toy(n_samples):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(60, 2))
    task = Task.__new__(Task)
    task.train = task.test = X, np.column_stack([X[:, 0] ** 2, X @ [1.0, -1.0]]) + rng.normal(0, 0.1, (60, 2))
    return task


def row_of(pair, part, variant, task, parameters, max_iter):
    model = DependentGPRegressor(inference="exact", max_iter=max_iter, random_state=0).set_params(**parameters)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(*task.train)
    seconds = time.perf_counter() - start
    X, Y = task.test
    mean, std = model.predict(X, return_std=True, include_noise=True)
    return {
        "pair": pair,
        part: variant,
        "NRMSE": float(normalized_rmse(Y, mean)),
        "NLPD": float(negative_log_predictive_density(Y, mean, std)),
        "log likelihood": float(model.log_marginal_likelihood_value_),
        "hyperparameters": len(model.theta_),
        "seconds": seconds,
    }


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--samples", type=int, help="to learn from")
    options = parsed(parser, words)
    tables = {}
    for part in options.parts:
        n_samples, regressors, variants = PARTS[part]
        n_samples = options.samples or n_samples
        tables[part] = []
        for pair in ["toy"] if options.smoke else PAIRS:
            task = toy(n_samples) if options.smoke else Task(pair, options.data, regressors, n_samples)
            for variant, parameters in variants.items():
                row = row_of(pair, part, variant, task, parameters, 2 if options.smoke else 60)
                print(json.dumps(row), flush=True)
                tables[part].append(row)
    finish(options, "structure", **tables)


if __name__ == "__main__":
    main()
