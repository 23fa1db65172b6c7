"""One likelihood and its gradient, side by side with LAPACK, scikit-learn, GPyTorch, GPy and mogptk.

    python tests/benchmarks/likelihood.py [--out FOLDER]

The paper's size: 755 samples of six outputs, six latent processes, 15 regressors, a width for each.
LAPACK's potrf and potri of the same N x N matrix are what every exact method needs. Ratios, not
times, are the result: all take turns on the same machine. Memory is what the evaluation adds to a
process of its own, at its peak.
"""

import json
import sys
from typing import NamedTuple

import numpy as np
from _common import (
    available_memory,
    extra_memory,
    finish,
    in_own_process,
    interleaved,
    parser_of,
    use_torch_threads,
)
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
    workspace = np.empty((data.n_values, data.n_values))  # as in a fit
    return lambda: log_likelihood(kernel, noise, data, eval_gradient=True, workspace=workspace)


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
    use_torch_threads()
    from _gpytorch import cholesky, exact_lcm, likelihood_and_gradient

    evaluate = likelihood_and_gradient(
        *exact_lcm(*case.table(), case.M, length_scale=LENGTH, noise=NOISE)
    )

    def by_cholesky():
        with cholesky():
            evaluate()

    return by_cholesky


def gpytorch_default(case):
    use_torch_threads()
    import torch
    from _gpytorch import exact_lcm, likelihood_and_gradient

    model = exact_lcm(*case.table(), case.M, length_scale=LENGTH, noise=NOISE, dtype=torch.float32)
    return likelihood_and_gradient(*model)


def gpy_lcm(case):
    import GPy

    X, Y = case.table()
    kernels = [GPy.kern.RBF(case.d, lengthscale=LENGTH, ARD=True) for _ in range(case.M)]
    kernel = GPy.util.multioutput.LCM(case.d, case.P, kernels, W_rank=1)
    model = GPy.models.GPCoregionalizedRegression([X] * case.P, list(Y.T[..., None]), kernel=kernel)
    theta, step = np.array(model.optimizer_array), [0.0]

    def evaluate():
        step[0] += 1e-7  # the same theta again would be answered from its cache
        model._objective_grads(theta + step[0])

    return evaluate


def mogptk_convolved(case):
    use_torch_threads()
    import torch
    from mogptk import gpr
    from mogptk.gpr.multioutput import GaussianConvolutionProcessKernel

    X, Y = case.table()
    stacked = np.column_stack([np.repeat(np.arange(case.P), case.n), np.tile(X, (case.P, 1))])
    kernel = gpr.AddKernel(
        *(GaussianConvolutionProcessKernel(case.P, case.d) for _ in range(case.M))
    )
    for part in kernel.kernels:
        part.variance.assign(torch.full((case.P, case.d), LENGTH**2 / 3))
        part.base_variance.assign(torch.full((case.d,), LENGTH**2 / 3))
    return gpr.Exact(kernel, stacked, Y.T.reshape(-1, 1), variance=[NOISE] * case.P).loss


CONTENDERS = {
    FLOOR: lapack_calls,
    OURS: ours,
    "scikit-learn, each output alone": sklearn_alone,
    "scikit-learn, one output of N values": sklearn_stacked,
    "GPyTorch LCM, Cholesky": gpytorch_cholesky,
    "GPyTorch LCM, default, single precision": gpytorch_default,
    "GPy LCM": gpy_lcm,
    "mogptk convolved": mogptk_convolved,
}
NEEDED = {"scikit-learn, one output of N values": 6, "mogptk convolved": 6}
"""Times N^2 d doubles that these were seen to take."""


def ready(case, names=CONTENDERS):
    """Return the contenders that are installed and fit the memory, each ready to evaluate."""
    found = {}
    for name in names:
        if NEEDED.get(name, 0) * 8 * case.N**2 * case.d > available_memory():
            print(f"{name}: left out, not enough memory", file=sys.stderr)
            continue
        try:
            found[name] = CONTENDERS[name](case)
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
    return found


def default_against_exact(case):
    """Return how far the gradient of GPyTorch's default settings is from that of the same model by Cholesky."""
    try:
        import torch
        from _gpytorch import cholesky, exact_lcm, gradient
    except ImportError:
        return []
    use_torch_threads()
    sizes = {"length_scale": LENGTH, "noise": NOISE}
    with cholesky():
        exact = gradient(*exact_lcm(*case.table(), case.M, **sizes))
    rows = []
    for name, dtype in {"single": torch.float32, "double": torch.float64}.items():
        default = gradient(*exact_lcm(*case.table(), case.M, **sizes, dtype=dtype))
        error, length = np.linalg.norm(default - exact), np.linalg.norm(exact)
        cosine = float(default @ exact / np.linalg.norm(default) / length)
        rows.append(
            {
                "precision": name,
                "norm of the difference / norm": error / length,
                "cosine of the angle": cosine,
            }
        )
    return rows


def memory(case, name):
    """Return the bytes that one evaluation adds to its process."""
    CONTENDERS[name](Case(20, case.P, case.M, case.d))()  # libraries take their buffers
    return extra_memory(CONTENDERS[name](case))


def compare(case, names, repeats, isolated=True):
    """Return a row for each contender: seconds, over LAPACK, memory."""
    functions = ready(case, names)
    seconds = interleaved(functions, repeats)
    functions.clear()
    rows = []
    for name, time in seconds.items():
        peak = in_own_process(__file__, "--memory", name, *case) if isolated else memory(case, name)
        over = None if peak is None else peak / (8 * case.N**2)
        rows.append(
            {
                "what": name,
                "seconds": time,
                "over LAPACK": time / seconds[FLOOR],
                "peak memory / N^2 doubles": over,
            }
        )
    return rows


def main(words=None):
    options = parser_of(__doc__, smoke=True).parse_args(words)
    case = Case(20, 6, 2, 3) if options.smoke else Case()
    names = [FLOOR, OURS] if options.no_peers else list(CONTENDERS)
    rows = compare(case, names, options.repeats, not options.smoke)
    check = [] if options.no_peers else default_against_exact(case)
    finish(
        options, "likelihood", one_likelihood_and_gradient=rows, gradient_of_gpytorchs_default=check
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--memory"]:
        print(json.dumps(memory(Case(*map(int, sys.argv[3:])), sys.argv[2])))
    else:
        main()
