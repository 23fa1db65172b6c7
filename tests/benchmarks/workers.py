"""One evaluation of the sparse bound and its gradient, summed by threads, by processes, by workers of dask.

    python tests/benchmarks/workers.py ../shared/data [--out FOLDER]

The regressors and coefficients of a whole flight, and the flight several times over. All use the same cores, so nobody
can win by having more of them. The price of a call is measured with matrices of the same size and nothing to compute:
sending the state, fetching the sums; an evaluation with its gradient has one such call and one with small sums. Without
the folder of flights, random numbers of the same shape.
"""

import sys
from contextlib import nullcontext

import numpy as np
from _common import finish, interleaved, parser_of
from joblib import parallel_config

from skdgp._compute.parallel import share_map
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


def seconds(call, configs, repeats):
    """Return the shortest time of a call under each configuration of joblib."""
    found = dict.fromkeys(configs, np.inf)
    for _ in range(repeats):
        for name, config in configs.items():
            with parallel_config(**config) if config else nullcontext():
                call()
                found[name] = min(found[name], interleaved({name: call}, 2)[name])
    return {f"{name} [s]": value for name, value in found.items()}


def price(n_features, shares):
    """Return a call that sends and fetches as the first sums do."""
    state, own = np.zeros((n_features, n_features)), max(1, n_features * 3 // 8)

    def sums(state, share):
        return np.ones((own, own))

    return lambda: share_map(sums, (state,), shares)


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(words)
    n, n_inducing, copies = (400, 5, (1,)) if options.smoke else (14400, 100, (1, 4))
    X, Y = whole_flight(options.data, n)
    configs = {"threads": {}, "processes": {"backend": "loky", "n_jobs": options.workers}}
    with cluster(options) as client:
        if client is not None:
            configs["dask"] = {"backend": "dask", "client": client}
        evaluations, prices = [], []
        for k in copies:
            data = np.tile(X, (k, 1)), np.tile(Y, (k, 1))
            shares = shares_of(Data.from_table(*data))
            call = evaluation(*data, n_inducing, shares)
            evaluations.append({"samples": len(data[0])} | seconds(call, configs, options.repeats))
        for n_features in (8 * n_inducing, 4 * n_inducing):
            call = price(n_features, shares)
            prices.append({"features": n_features} | seconds(call, configs, options.repeats))
    finish(options, "workers", one_evaluation=evaluations, price_of_a_call=prices)


def cluster(options):
    """Return a context with a client of a cluster on this machine, or with None."""
    if options.no_peers:
        return nullcontext()
    try:
        import dask
        from distributed import Client
    except ImportError:
        print("dask.distributed is not installed", file=sys.stderr)
        return nullcontext()
    memory = {"MALLOC_TRIM_THRESHOLD_": 2**27, "MALLOC_MMAP_THRESHOLD_": 2**25}  # see docs/scaling.md
    dask.config.set({f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in memory.items()})
    return Client(n_workers=options.workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")


if __name__ == "__main__":
    main()
