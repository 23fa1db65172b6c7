"""Predictions of an exact and of a compact posterior, over the matrix products and triangular solves they need.

    python tests/benchmarks/prediction.py [--out FOLDER] [--rows 28800]

755 samples of six outputs, 12 regressors, two shared and six private latents and a linear trend: N = 4530. Of an exact
posterior the floor of a mean is K alpha, that of a standard deviation K alpha and L^-1 K^T, timed on the same shapes in
the same turns, the covariances K given. One row at a time is asked of the estimator, as a controller would.
"""

import pickle
import time
from types import SimpleNamespace

import numpy as np
from _common import extra_memory, finish, interleaved, parser_of
from scipy.linalg.blas import dtrsm

from skdgp import DependentGPRegressor
from skdgp.inference import _exact
from skdgp.kernels import ConvolvedGaussian


def flight(n, d, P, seed):
    """Return regressors that a few slow motions make, and outputs that depend on them, with noise."""
    rng = np.random.default_rng(0)  # the same aircraft whatever the flight
    mixing, bend, weights = rng.normal(size=(4, d)), rng.normal(size=(d, 20)), rng.normal(size=(20, P))
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 60, n)[:, None]
    motion = np.sin(t * rng.uniform(0.2, 2.0, 4) + rng.uniform(0, 6, 4))
    X = motion @ mixing + 0.1 * rng.normal(size=(n, d))
    Y = np.tanh(X @ bend / d) @ weights
    return X, Y + 0.1 * Y.std(axis=0) * rng.normal(size=Y.shape)


def floor_of(posterior, n_rows, with_solve):
    """Return a function that does the products, and on request the solves, of a prediction, chunk by chunk.

    The solve overwrites, so each chunk is copied first: about one part in a hundred of the time.
    """
    P, N = posterior.kernel.n_outputs, posterior.data.n_values
    step = min(n_rows, max(1, int(_exact.CHUNK_BYTES / 8 / N / P)))
    K = np.random.default_rng(0).normal(size=(P * step, N))
    L, alpha = posterior.L, posterior.alpha

    def work():
        for _ in range(-(-n_rows // step)):
            K @ alpha
            if with_solve:
                dtrsm(1.0, L, np.copy(K).T, lower=1, overwrite_b=1)

    return work


def batch(model, X, repeats):
    """Return rows: what was asked, seconds, over the floor, and the memory it took beside the result."""
    posterior, rows = model.posterior_, []
    for name, with_std in (("mean", False), ("mean and std", True)):
        floor = floor_of(posterior, len(X), with_std)

        def ours(with_std=with_std):
            return model.predict(X, return_std=with_std)

        found = interleaved({"floor": floor, "ours": ours}, repeats)
        rows.append(
            {
                f"{len(X)} samples": name,
                "floor s": found["floor"],
                "ours s": found["ours"],
                "ratio": found["ours"] / found["floor"],
                "MB": round(extra_memory(ours) / 1e6),
            }
        )
    return rows


def milliseconds(function, repeats):
    """Return the median of many calls: what a loop at a fixed rate feels."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def one_row(models, x, X, repeats):
    """Return rows: the model, its size in a file, one row's times, a whole flight's."""
    rows = []
    for name, model in models.items():
        calls = 20 * repeats if name == "exact" else 200 * repeats
        model.predict(x, return_std=True)
        rows.append(
            {
                "model": name,
                "file MB": len(pickle.dumps(model)) / 1e6,
                "row, mean ms": milliseconds(lambda: model.predict(x), calls),  # noqa: B023
                "row, mean and std ms": milliseconds(lambda: model.predict(x, return_std=True), calls),  # noqa: B023
                f"{len(X)} samples, mean s": milliseconds(lambda: model.predict(X), 1) / 1e3,  # noqa: B023
                "mean and std s": None
                if name == "exact"
                else milliseconds(lambda: model.predict(X, return_std=True), 1) / 1e3,  # noqa: B023
                "mean moved": None if name == "exact" else float(model.compaction_.mean_rms.max()),
                "std changed": None if name == "exact" else float(model.compaction_.std_rms.max()),
            }
        )
    return rows


def online(models, X, Y, repeats):
    """Return rows: the milliseconds that a further sample of all outputs takes, and the mean after it."""
    rows = []
    for name, model in models.items():
        model = pickle.loads(pickle.dumps(model))
        model.partial_fit(X[:1], Y[:1])
        samples = iter(range(1, len(X)))
        n = min(10 * repeats, len(X) - 1)

        def one(model=model, samples=samples):
            k = next(samples)
            model.partial_fit(X[k : k + 1], Y[k : k + 1])

        rows.append({"model": name, "one more sample ms": milliseconds(one, n)})
    return rows


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--rows", type=int, default=28800, help="samples predicted at a time")
    options = parser.parse_args(words)
    sizes = SimpleNamespace(n=755, P=6, d=12, rows=options.rows, inducing=(500, 1500))
    if options.smoke:
        sizes = SimpleNamespace(n=20, P=3, d=4, rows=50, inducing=(20,))
    X, Y = flight(sizes.n, sizes.d, sizes.P, seed=1)
    new, new_Y = flight(sizes.rows, sizes.d, sizes.P, seed=2)
    model = DependentGPRegressor(ConvolvedGaussian(2), optimizer=None, random_state=0).fit(X, Y)
    models = {"exact": model} | {f"compact({n})": model.compact(n) for n in sizes.inducing}
    finish(
        options,
        "prediction",
        whole_flight=batch(model, new, options.repeats),
        one_row=one_row(models, new[:1].copy(), new, options.repeats),
        online=online(models, new[:200], new_Y[:200], options.repeats),
    )


if __name__ == "__main__":
    main()
