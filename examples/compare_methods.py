"""
Compare methods
===============

Compare the errors of several methods on a flight that they did not learn from::

    python examples/compare_methods.py

It takes about a minute. Every method learns the same rows with the same regressors; the trees learn
all rows. docs/results.md compares more methods on other flights. For your own method add a line to
``methods``: any object with ``fit`` and ``predict``. Needs matplotlib: pip install "skdgp[plot]".
"""

import argparse
import time
import warnings

import numpy as np
from matplotlib.figure import Figure
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import LassoLarsIC, LinearRegression
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

from skdgp import DependentGPRegressor
from skdgp.datasets import load_example_flights
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import make_identification_pipeline
from skdgp.metrics import interval_coverage, normalized_rmse
from skdgp.model_selection import thin_targets


class OnTrend:
    """A linear trend by least squares, and a regressor of its residuals, scaled to variance one."""

    def __init__(self, regressor):
        self.regressor = regressor

    def fit(self, X, Y):
        rest = Y - (trend := LinearRegression().fit(X, Y)).predict(X)
        self.trend, self.scale = trend, rest.std(axis=0)
        self.regressor.fit(X, rest / self.scale)
        return self

    def predict(self, X):
        return self.trend.predict(X) + self.scale * self.regressor.predict(X)


def methods(n_regressors):
    """Return the methods by name, and the names of the methods that learn all rows."""
    process = GaussianProcessRegressor(
        ConstantKernel() * RBF(np.full(n_regressors, 3.0), (1e-1, 1e4))
        + WhiteKernel(0.1, (1e-6, 1e2))
    )
    terms = make_pipeline(PolynomialFeatures(2, include_bias=False), LassoLarsIC("bic"))
    trees = HistGradientBoostingRegressor(random_state=0)
    return {
        "least squares": LinearRegression(),
        "second-order terms by BIC": MultiOutputRegressor(terms),
        "trend + boosted trees": OnTrend(MultiOutputRegressor(trees)),
        "trend + six Gaussian processes": OnTrend(MultiOutputRegressor(process)),
        "skdgp": DependentGPRegressor(random_state=0),
    }, {"trend + boosted trees"}


def draw(names, errors, path):
    """Draw a bar for each method and coefficient."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    ax = figure.subplots()
    width = 0.8 / len(errors)
    for k, (method, values) in enumerate(errors.items()):
        ax.bar(
            np.arange(len(names)) + (k - len(errors) / 2 + 0.5) * width, values, width, label=method
        )
    ax.set_xticks(range(len(names)), names)
    ax.set_ylabel("RMSE / standard deviation of the truth")
    ax.legend(frameon=False, fontsize="small")
    figure.suptitle("Example flights: errors on a flight that no method has seen")
    figure.savefig(path, dpi=150)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=250,
        help="rows to learn from, 90 or more (default: %(default)s)",
    )
    parser.add_argument(
        "--output", default="comparison.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    flights = load_example_flights()
    targets = aerodynamic_coefficients(flights.train, flights.aircraft)
    measured = aerodynamic_coefficients(flights.test, flights.aircraft).to_numpy()
    truth = flights.test[[f"{name}_true" for name in targets]].to_numpy()
    inputs = make_identification_pipeline(flights.aircraft)[:-1]
    X, asked = (
        np.asarray(inputs.fit_transform(flights.train)),
        np.asarray(inputs.transform(flights.test)),
    )
    few = thin_targets(targets, options.samples).notna().all(axis=1).to_numpy()
    every = targets.notna().all(axis=1).to_numpy()

    compared, of_all_rows = methods(X.shape[1])
    errors = {}
    for name, method in compared.items():
        rows, start = every if name in of_all_rows else few, time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            method.fit(X[rows], targets.to_numpy()[rows])
        seconds = time.perf_counter() - start
        errors[name] = normalized_rmse(truth, method.predict(asked), multioutput="raw_values")
        each = " ".join(f"{error:.3f}" for error in errors[name])
        print(
            f"{name:32} NRMSE {errors[name].mean():.3f} ({each}), {rows.sum()} rows, "
            f"{seconds:.0f} s",
            flush=True,
        )

    mean, std = compared["skdgp"].predict(asked, return_std=True, include_noise=True)
    print(
        f"skdgp's 95 % band holds {100 * interval_coverage(measured, mean, std):.0f} % of "
        f"measured coefficients"
    )
    draw(list(targets), errors, options.output)
    print(options.output)


if __name__ == "__main__":
    main()
