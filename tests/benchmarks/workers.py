"""One evaluation of the sparse bound and its gradient, summed by threads, by processes, by workers of dask.

    python tests/benchmarks/workers.py ../shared/data [--out FOLDER]

The regressors and coefficients of a whole flight, and the flight several times over: what workers cost more than threads
does not grow with the samples. All use the same cores, so nobody can win here: the difference is the price of sending
the state and fetching the sums. Without the folder of flights, random numbers of the same shape.
"""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from _common import finish, interleaved, parser_of
from joblib import parallel_config

from skdgp._parallel import sharing
from skdgp.inference import Data, SparsePosterior, shares_of
from skdgp.kernels import ConvolvedGaussian, LinearTrend


def whole_flight(folder, n):
    """Return regressors and coefficients, (n, 15) and (n, 6)."""
    if folder is None:
        rng = np.random.default_rng(0)
        return rng.normal(size=(n, 15)), rng.normal(size=(n, 6))
    from heldout import flights

    task = flights(folder)
    X = (task.X - task.X.mean(axis=0)) / task.X.std(axis=0)
    Y = task.Y / np.nanstd(task.Y, axis=0)
    return X, Y - np.nanmean(Y, axis=0)


def evaluation(X, Y, n_inducing, shares):
    """Return a function that does what one step of a search asks for."""
    kernel = (LinearTrend() + ConvolvedGaussian(2)).initialize(X[:500], Y[:500], np.random.RandomState(0))
    features = kernel.features(X[:: len(X) // n_inducing][:n_inducing])
    noise = np.full(Y.shape[1], 0.1)

    def evaluate():
        posterior = SparsePosterior(kernel, features, noise, shares)
        return posterior.log_marginal_likelihood, posterior.bound_gradient()

    return evaluate


def measure(X, Y, n_inducing, configs, repeats):
    shares = shares_of(Data.from_table(X, Y))
    evaluate = evaluation(X, Y, n_inducing, shares)
    row, seconds = {"samples": len(X)}, {}
    for _ in range(repeats):
        for name, config in configs.items():
            with parallel_config(**config) if config else nullcontext(), sharing(shares):
                evaluate()  # the shares are sent
                found = interleaved({name: evaluate}, 2)
            seconds[name] = min(found[name], seconds.get(name, np.inf))
    row |= {f"{name} [s]": value for name, value in seconds.items()}
    return row


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("data", nargs="?", type=Path, help="folder of the shared data")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(words)
    n, n_inducing, copies = (400, 5, (1,)) if options.smoke else (14400, 100, (1, 4))
    X, Y = whole_flight(options.data, n)
    configs = {"threads": {}, "processes": {"backend": "loky", "n_jobs": options.workers}}
    with cluster(options) as client:
        if client is not None:
            configs["dask"] = {"backend": "dask", "client": client}
        rows = [measure(np.tile(X, (k, 1)), np.tile(Y, (k, 1)), n_inducing, configs, options.repeats) for k in copies]
    finish(options, "workers", one_evaluation=rows)


def cluster(options):
    """Return a context with a client of a cluster on this machine, or with None."""
    if options.no_peers:
        return nullcontext()
    try:
        from distributed import Client
    except ImportError:
        print("dask.distributed is not installed", file=sys.stderr)
        return nullcontext()
    return Client(n_workers=options.workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")


if __name__ == "__main__":
    main()
