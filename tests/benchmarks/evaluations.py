"""How many evaluations of the likelihood a fit of the paper's size takes, by where it starts.

    python tests/benchmarks/evaluations.py ../shared/data [--out FOLDER]

Cold: all hyperparameters of all outputs at once, from values taken from the data. Ours: each output alone first, then
jointly with filters alike over the outputs, then free. The line to cross is the log likelihood at which ours ends, less
one hundredth of it. Evaluations are those of all values together; the ones of single outputs are a P^3-th of the work
each, and count in the seconds. The error is that on the test flight. Without the folder of flights, random functions.
"""

import time
from types import SimpleNamespace

import numpy as np
from _common import finish, parser_of

from skdgp import listening
from skdgp.inference import Data, ExactPosterior, fit_exact, log_likelihood, maximize
from skdgp.kernels import ConvolvedGaussian, LinearTrend


def problem(folder, n):
    """Return regressors and normalised targets of n samples, and the error of a posterior on the test flight."""
    if folder is None:
        rng = np.random.default_rng(0)
        X = rng.normal(size=(n, 4))
        Y = np.sin(X @ rng.normal(size=(4, 6)) / 2) + 0.1 * rng.normal(size=(n, 6))
        return X, Y, lambda posterior: float("nan")
    from heldout import flights

    task = flights(folder)
    rows = np.linspace(0, len(task.X) - 1, n).astype(int)
    middle, spread = task.X.mean(axis=0), task.X.std(axis=0)
    center, scale = task.Y[rows].mean(axis=0), task.Y[rows].std(axis=0)

    def error(posterior):
        return task.error(posterior.predict((task.Xt - middle) / spread) * scale + center)

    return (task.X[rows] - middle) / spread, (task.Y[rows] - center) / scale, error


def cold(X, Y, max_iter):
    """Return the posterior that a single climb from the data's own values finds."""
    P = Y.shape[1]
    kernel = (LinearTrend() + ConvolvedGaussian(2)).initialize(X, Y, np.random.RandomState(0))
    data = Data.from_table(X, Y)

    def likelihood(theta):
        return log_likelihood(kernel.clone_with_theta(theta[:-P]), np.exp(theta[-P:]), data, eval_gradient=True)

    theta = np.concatenate([kernel.theta, np.full(P, np.log(0.2))])
    bounds = np.concatenate([kernel.bounds, np.tile(np.log([1e-6, 1e2]), (P, 1))])
    best = maximize(likelihood, theta, bounds, max_iter=max_iter)
    return ExactPosterior(kernel.clone_with_theta(best.theta[:-P]), np.exp(best.theta[-P:]), data)


def ours(X, Y, max_iter):
    """Return the posterior of the fit of the package."""
    kernel = LinearTrend() + ConvolvedGaussian(2)
    return fit_exact(kernel, X, Y, optimizer="fmin_l_bfgs_b", max_iter=max_iter, random_state=0).posterior


def climbed(start, X, Y, max_iter):
    """Return the posterior, and seconds and best value after each evaluation of all values together."""
    steps, began = [], time.perf_counter()

    def heard(stage, n, value):
        if stage == "fit":
            steps.append((time.perf_counter() - began, value))

    with listening(heard):
        posterior = start(X, Y, max_iter)
    return SimpleNamespace(posterior=posterior, seconds=[s for s, _ in steps], values=np.array([v for _, v in steps]))


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--samples", type=int, default=755)
    options = parser.parse_args(words)
    n, most, more = (20, 6, 10) if options.smoke else (options.samples, 60, 300)
    X, Y, error = problem(options.data, n)
    climbs = {"ours": climbed(ours, X, Y, most), "cold": climbed(cold, X, Y, more)}
    final = climbs["ours"].values[-1]
    line = final - 0.01 * abs(final)
    rows = []
    for name, climb in climbs.items():
        crossed = int(np.argmax(climb.values >= line)) if climb.values[-1] >= line else None
        rows.append(
            {
                "start": name,
                "evaluations to the line": None if crossed is None else crossed + 1,
                "seconds to the line": None if crossed is None else climb.seconds[crossed],
                "evaluations": len(climb.values),
                "seconds": climb.seconds[-1],
                "log likelihood": float(climb.values[-1]),
                "NRMSE": float(error(climb.posterior)),
            }
        )
    finish(options, "evaluations", starts=rows)


if __name__ == "__main__":
    main()
