"""One likelihood and its gradient, side by side with LAPACK, scikit-learn and GPyTorch.

    python tests/benchmarks/likelihood.py [--out FOLDER]

The paper's size: 755 samples of six outputs, six latent processes, 15 regressors, a width for each.
LAPACK's potrf and potri of the same N x N matrix are what every exact method needs. Ratios, not
times, are the result: all take turns on the same machine.
"""

import os
import sys
from typing import NamedTuple

import numpy as np
from _common import finish, interleaved, parser_of
from scipy.linalg import lapack

from skdgp.inference import Data, log_likelihood
from skdgp.kernels import ConvolvedGaussian

FLOOR, OURS = "LAPACK potrf + potri", "skdgp"
NOISE, LENGTH = 0.1, 3.0


class Case(NamedTuple):
    """How much there is: samples, outputs, shared latents, regressors."""

    n: int = 755
    P: int = 6
    M: int = 6
    d: int = 15

    @property
    def N(self):
        return self.n * self.P

    def table(self):
        rng = np.random.default_rng(0)
        return rng.normal(size=(self.n, self.d)), rng.normal(size=(self.n, self.P))


def lapack_calls(case):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(case.N, case.N)) / case.N
    A = np.asfortranarray(A + A.T + 10 * np.eye(case.N))

    def factor_and_invert():
        L, _ = lapack.dpotrf(A.copy(order="F"), lower=1, overwrite_a=1, clean=0)
        lapack.dpotri(L, lower=1, overwrite_c=1)

    return factor_and_invert


def ours(case):
    X, Y = case.table()
    kernel = ConvolvedGaussian(case.M, private_latents=False)
    kernel, data, noise = kernel.initialize(X, Y, 0), Data.from_table(X, Y), np.full(case.P, NOISE)
    return lambda: log_likelihood(kernel, noise, data, eval_gradient=True)


def sklearn_alone(case):
    """Each output by itself."""
    X, Y = case.table()
    evaluations = [_sklearn(X, y) for y in Y.T]
    return lambda: [evaluate() for evaluate in evaluations]


def sklearn_stacked(case):
    """One output of as many values as the six have together."""
    X, Y = case._replace(n=case.N, P=1).table()
    return _sklearn(X, Y[:, 0])


def _sklearn(X, y):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    kernel = ConstantKernel() * RBF(np.full(X.shape[1], LENGTH)) + WhiteKernel(NOISE)
    model = GaussianProcessRegressor(kernel, optimizer=None).fit(X, y)
    return lambda: model.log_marginal_likelihood(
        model.kernel_.theta, eval_gradient=True, clone_kernel=False
    )


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
    "scikit-learn, one output of N values": sklearn_stacked,
    "GPyTorch LCM, Cholesky": gpytorch_cholesky,
}
NEEDED = {"scikit-learn, one output of N values": 6}  # Times N^2 d doubles that it was seen to take


def ready(case):
    """Return the contenders that are installed and fit the memory, each ready to evaluate."""
    found = {}
    for name, make in CONTENDERS.items():
        if NEEDED.get(name, 0) * 8 * case.N**2 * case.d > os.sysconf(
            "SC_AVPHYS_PAGES"
        ) * os.sysconf("SC_PAGE_SIZE"):
            print(f"{name}: left out, not enough memory", file=sys.stderr)
            continue
        try:
            found[name] = make(case)
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
    return found


def compare(case, repeats):
    """Return a row for each contender: seconds, over LAPACK."""
    seconds = interleaved(ready(case), repeats)
    return [
        {"what": name, "seconds": time, "over LAPACK": time / seconds[FLOOR]}
        for name, time in seconds.items()
    ]


def main(words=None):
    options = parser_of(__doc__, smoke=True).parse_args(words)
    rows = compare(Case(20, 6, 2, 3), 1) if options.smoke else compare(Case(), 3)
    finish(options, "likelihood", one_likelihood_and_gradient=rows)


if __name__ == "__main__":
    main()
