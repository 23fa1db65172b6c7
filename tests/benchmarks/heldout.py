"""Seconds of fitting until a flight that was not learned from is predicted with a given error: ours and GPyTorch's.

    python tests/benchmarks/heldout.py ../shared/data [--out FOLDER] [--tried]

Every method gets the same: the smoothed, scaled regressors of the identification pipeline and the measured
coefficients. The error is the mean over the six coefficients of RMSE / std of the truth, on every sample of the test
flight. The clock runs while a method fits, not while it is scored. Ours is asked for what it knows after so many
seconds by interrupting it, as a user would: each point is a fit of its own, from the start. GPyTorch and scikit-learn
get a linear trend, fitted before by least squares. GPyTorch's small matrices may be faster on one thread than on all:
both are run. ``--tried`` runs the configurations of
GPyTorch from which the best was taken by its error on the test flight itself: more than we allow ourselves.
"""

import sys
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import finish, parsed, parser_of, use_torch_threads
from _peers import IndependentProcesses, OnTrend
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor, listening, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import normalized_rmse
from skdgp.model_selection import thin_targets

SAMPLES = 755
BUDGETS = [1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 45, 60, 90]  # s
TRIED_BUDGETS = [10, 20, 40]
BEST = {"n_latent": 6, "n_inducing": 50, "batch": 512, "rate": 0.05, "decay": 1500}
STEADY, STEADY_150 = {"decay": None}, {"decay": None, "n_inducing": 150}
TRIED = {  # by what they differ from the best; the rows of its table
    "the best": {},
    "rate .05 throughout": STEADY,
    "150 inducing points, rate .02 throughout": {**STEADY_150, "rate": 0.02},
    "150 inducing points, rate .05 falling in 1000": {"n_inducing": 150, "decay": 1000},
    "150 inducing points, rate .1 falling in 1000": {"n_inducing": 150, "decay": 1000, "rate": 0.1},
    "150, rate .05 throughout, by k-means": {**STEADY_150, "kmeans": True},
    "150, rate .05 throughout, length scales from 3": {**STEADY_150, "length_scale": 3.0},
    "150, rate .05 throughout, natural gradients .1": {**STEADY_150, "natural": 0.1},
    "100 inducing points, rate .05 throughout": {**STEADY, "n_inducing": 100},
    "100 inducing points, rate .05 throughout, natural gradients .1": {**STEADY, "n_inducing": 100, "natural": 0.1},
    "150, rate .05 throughout, batches of 256": {**STEADY_150, "batch": 256},
}


class Task(NamedTuple):
    """Regressors and targets (NaN: not observed), and what is asked."""

    X: np.ndarray
    Y: np.ndarray
    thinned: np.ndarray
    Xt: np.ndarray
    truth: np.ndarray

    def error(self, mean):
        return float(normalized_rmse(self.truth, mean))


def flights(folder, aircraft="viggen_uav", train="train_latlon", test="test_twoalt"):
    """Return the task of learning a flight, or a list of flights, and predicting another."""
    folder = Path(folder) / "flights"
    craft = Aircraft.from_json(folder / f"{aircraft}.json")
    parts = [train] if isinstance(train, str) else train
    read = {part: read_flight(folder / f"{aircraft}_{part}.parquet") for part in (*parts, test)}
    train, test = pd.concat([read[part].assign(flight=part) for part in parts], ignore_index=True), read[test]
    targets = aerodynamic_coefficients(train, craft)
    pipeline = make_identification_pipeline(craft)[:-1]
    X, Xt = np.asarray(pipeline.fit_transform(train)), np.asarray(pipeline.transform(test))
    truth = test[[f"{name}_true" for name in targets]].to_numpy()
    return Task(X, targets.to_numpy(), thin_targets(targets, SAMPLES).to_numpy(), Xt, truth)


def toy(n=400):
    """Return a task of the same form that takes no time."""
    rng = np.random.default_rng(0)
    X, Xt = rng.normal(size=(2, n, 2))
    f = lambda x: np.column_stack([np.sin(x[:, 0]), np.cos(x[:, 0]) + x[:, 1]])  # noqa: E731
    Y = f(X) + 0.1 * rng.normal(size=(n, 2))
    return Task(X, Y, thin_targets(Y, 50), Xt, f(Xt))


class _Deadline:
    """A listener that presses Ctrl-C when the time is over."""

    def __init__(self, seconds):
        self.end = time.perf_counter() + seconds

    def __call__(self, stage, n_evaluations, log_likelihood):
        if time.perf_counter() > self.end:
            raise KeyboardInterrupt


def ours(task, Y, budgets, **parameters):
    """Yield seconds, evaluations, error of fits interrupted after so many seconds, the last of one that ended."""
    for budget in (*budgets, float("inf")):
        model = DependentGPRegressor(random_state=0, **parameters)
        with warnings.catch_warnings(record=True) as caught, listening(_Deadline(budget)):
            warnings.simplefilter("always", ConvergenceWarning)
            start = time.perf_counter()
            model.fit(task.X, Y)
            seconds = time.perf_counter() - start
        yield seconds, model.n_evaluations_, task.error(model.predict(task.Xt))
        if not any("interrupted" in str(warning.message) for warning in caught):
            return


def gpytorch(task, budgets, threads=1, **configuration):
    """Yield seconds, steps, error of a sparse variational process of the residuals of a linear model."""
    use_torch_threads(threads)
    from _gpytorch import clocked, train_variational

    next(train_variational(task.X[:20], task.thinned[:20] * 0, n_inducing=2))  # what torch does once in a process
    trend = LinearRegression().fit(task.X, task.Y)
    rest = task.Y - trend.predict(task.X)
    scale = rest.std(axis=0)
    for seconds, step, predict in clocked(
        train_variational(task.X, rest / scale, **{**BEST, **configuration}), budgets
    ):
        yield seconds, step, task.error(trend.predict(task.Xt) + scale * predict(task.Xt))


def timed(model, task, Y):
    """Yield seconds, evaluations (unknown), error of a model of the rows that were observed."""
    seen = np.isfinite(Y).all(axis=1)
    start = time.perf_counter()
    model.fit(task.X[seen], Y[seen])
    yield time.perf_counter() - start, None, task.error(model.predict(task.Xt))


def run(name, points):
    """Return a row for each point and say them as they come."""
    rows = []
    for seconds, steps, error in points:
        rows.append({"method": name, "seconds": seconds, "steps": steps, "NRMSE": error})
        print(f"{name}: {seconds:.1f} s, {steps} steps, NRMSE {error:.4f}", flush=True)
    return rows


def curves(task, budgets, peers):
    """Return error over seconds of every method."""
    rows = run("least squares", timed(LinearRegression(), task, task.Y))
    rows += run("skdgp, exact, 755 samples", ours(task, task.thinned, budgets, inference="exact"))
    rows += run("skdgp, sparse, all samples", ours(task, task.Y, budgets, inference="sparse"))
    if peers:
        rows += run("scikit-learn, 755 samples", timed(OnTrend(IndependentProcesses()), task, task.thinned))
        rows += run("GPyTorch, sparse variational, all samples, one thread", gpytorch(task, budgets))
        rows += run("GPyTorch, sparse variational, all samples, all threads", gpytorch(task, budgets, threads=None))
        slower = TRIED["150 inducing points, rate .02 throughout"]
        rows += run(
            "GPyTorch, 150 inducing points, rate .02, all threads", gpytorch(task, budgets, threads=None, **slower)
        )
    return rows


def reaching(rows, errors):
    """Return how many seconds each method took to reach each error; None where it did not."""
    found = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        times = {
            f"{error:.3f}": min((r["seconds"] for r in own if r["NRMSE"] <= error), default=None) for error in errors
        }
        best = min(own, key=lambda row: row["NRMSE"])
        found.append({"method": method, **times, "best": best["NRMSE"], "after": best["seconds"]})
    return found


def tried(task, budgets):
    """Return the errors of every configuration of GPyTorch after the given seconds."""
    found = []
    for name, configuration in TRIED.items():
        points = run(name, gpytorch(task, budgets, **configuration))
        errors = {f"NRMSE after {b} s": row["NRMSE"] for b, row in zip(budgets, points, strict=True)}
        found.append({"configuration": name, **errors, "steps": points[-1]["steps"]})
    return found


def has_gpytorch():
    try:
        import gpytorch  # noqa: F401
    except ImportError:
        print("GPyTorch: left out, it is not installed", file=sys.stderr)
        return False
    return True


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--tried", action="store_true", help="the configurations of GPyTorch instead of the curves")
    options = parsed(parser, words)
    task = toy() if options.smoke else flights(options.data)
    peers = not options.no_peers and has_gpytorch()
    if options.tried:
        finish(options, "tried", configurations=tried(task, [0.1] if options.smoke else TRIED_BUDGETS))
        return
    rows = curves(task, [0.1] if options.smoke else BUDGETS, peers)
    errors = [0.25, 0.243, 0.235, 0.23, 0.226, 0.22]
    finish(options, "heldout", error_over_time=rows, seconds_until=reaching(rows, errors))


if __name__ == "__main__":
    main()
