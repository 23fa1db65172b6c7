"""One likelihood and gradient against the LAPACK calls that any exact method needs, measured side by side.

    python tests/benchmarks/likelihood.py

Ratios, not times, are the result: both columns come from the same run on the same machine. Memory is the peak of what
the evaluation allocates, in units of one N x N matrix.
"""

import time
import tracemalloc

import numpy as np
from scipy.linalg import lapack

from skdgp.inference import Data, log_likelihood
from skdgp.kernels import ConvolvedGaussian

CASES = [  # samples, outputs, shared latents, regressors, filters
    (250, 6, 2, 12, "diag"),
    (755, 6, 2, 12, "diag"),
    (755, 6, 6, 15, "diag"),
    (755, 6, 6, 15, "tied"),
    (400, 6, 2, 12, "full"),
]


def best_of(function, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def lapack_calls(N, rng):
    A = rng.normal(size=(N, N)) / N
    A = np.asfortranarray(A + A.T + 10 * np.eye(N))

    def factor_and_invert():
        L, _ = lapack.dpotrf(A.copy(order="F"), lower=1, overwrite_a=1, clean=0)
        lapack.dpotri(L, lower=1, overwrite_c=1)

    return factor_and_invert


def main(repeats=3):
    rng = np.random.default_rng(0)
    print(f"{'n':>5} {'P':>2} {'M':>2} {'d':>2} {'filters':>8} {'N':>6} {'LAPACK s':>9} {'ours s':>7} ratio memory/N^2")
    for n, P, M, d, covariance_type in CASES:
        X, Y = rng.normal(size=(n, d)), rng.normal(size=(n, P))
        kernel = ConvolvedGaussian(M, private_latents=False, covariance_type=covariance_type).initialize(X, Y, 0)
        data, noise = Data.from_table(X, Y), np.full(P, 0.1)
        ours = best_of(lambda: log_likelihood(kernel, noise, data, eval_gradient=True), repeats)  # noqa: B023
        floor = best_of(lapack_calls(n * P, rng), repeats)
        tracemalloc.start()
        log_likelihood(kernel, noise, data, eval_gradient=True)
        memory = tracemalloc.get_traced_memory()[1] / (8 * (n * P) ** 2)
        tracemalloc.stop()
        print(
            f"{n:5d} {P:2d} {M:2d} {d:2d} {covariance_type:>8} {n * P:6d} {floor:9.3f} {ours:7.3f} {ours / floor:6.2f} "
            f"{memory:11.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
