"""One likelihood and its gradient, side by side with LAPACK, scikit-learn and GPyTorch.

    python tests/benchmarks/likelihood.py [--out FOLDER]

The paper's size: 755 samples of six outputs, six latent processes, 15 regressors, a width for each.
LAPACK's potrf and potri of the same N x N matrix are what every exact method needs. Ratios, not
times, are the result: all take turns on the same machine.
"""

import sys
import time
from functools import partial
from timeit import timeit
from typing import NamedTuple

import numpy as np
from _common import finish, parser_of
from numpy.random import default_rng
from scipy.linalg import lapack
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from skdgp.inference import Data, log_likelihood
from skdgp.kernels import ConvolvedGaussian

FLOOR = "LAPACK potrf + potri"
OURS = "skdgp"
NOISE = 0.1
LENGTH = 3.0
PAUSE = 0.1  # s: idle threads of BLAS hold the cores for a while


class Case(NamedTuple):
    """How much there is: samples, outputs, shared latents, regressors."""

    n: int = 755
    P: int = 6
    M: int = 6
    d: int = 15

    def table(self):
        rng = default_rng(0)
        return rng.normal(size=(self.n, self.d)), rng.normal(size=(self.n, self.P))


def lapack_calls(case):
    rng = default_rng(0)
    N = case.n * case.P
    A = rng.normal(size=(N, N)) / N
    A = np.asfortranarray(A + A.T + 10 * np.eye(N))

    def factor_and_invert():
        L, _ = lapack.dpotrf(A.copy(order="F"), lower=1, overwrite_a=1, clean=0)
        lapack.dpotri(L, lower=1, overwrite_c=1)

    return factor_and_invert


def ours(case):
    X, Y = case.table()
    kernel = ConvolvedGaussian(case.M, private_latents=False)
    kernel = kernel.initialize(X, Y, 0)
    data = Data.from_table(X, Y)
    noise = np.full(case.P, NOISE)
    return lambda: log_likelihood(kernel, noise, data, eval_gradient=True)


def sklearn_alone(case):
    """Each output by itself."""
    X, Y = case.table()
    kernel = ConstantKernel() * RBF(np.full(case.d, LENGTH)) + WhiteKernel(NOISE)
    models = [GaussianProcessRegressor(kernel, optimizer=None).fit(X, y) for y in Y.T]
    words = {"eval_gradient": True, "clone_kernel": False}
    return lambda: [each.log_marginal_likelihood(each.kernel_.theta, **words) for each in models]


def gpytorch_cholesky(case):
    from _gpytorch import cholesky, exact_lcm, likelihood_and_gradient

    evaluate = likelihood_and_gradient(
        *exact_lcm(*case.table(), case.M, length_scale=LENGTH, noise=NOISE)
    )

    def by_cholesky():
        with cholesky():
            evaluate()

    return by_cholesky


CONTENDERS = {
    FLOOR: lapack_calls,
    OURS: ours,
    "scikit-learn, each output alone": sklearn_alone,
    "GPyTorch LCM, Cholesky": gpytorch_cholesky,
}


def ready(case):
    """Return the contenders that are installed, each ready to evaluate."""
    found = {}
    for name, make in CONTENDERS.items():
        try:
            found[name] = make(case)
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
    return found


def compare(case, repeats):
    """Return a row for each contender: seconds, over LAPACK."""
    contenders = ready(case)
    pause = partial(time.sleep, PAUSE)
    seconds = dict.fromkeys(contenders, np.inf)
    for _ in range(repeats):  # in turns: whatever slows the machine slows all of them
        for name, function in contenders.items():
            seconds[name] = min(seconds[name], timeit(function, pause, number=1))
    return [
        {"what": name, "seconds": each, "over LAPACK": each / seconds[FLOOR]}
        for name, each in seconds.items()
    ]


def main(words=None):
    options = parser_of(__doc__, smoke=True).parse_args(words)
    rows = compare(Case(20, 6, 2, 3), 1) if options.smoke else compare(Case(), 3)
    finish(options, "likelihood", one_likelihood_and_gradient=rows)


if __name__ == "__main__":
    main()
