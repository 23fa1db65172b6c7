"""Mean and standard deviation of a whole flight, by this package, scikit-learn and GPyTorch.

    python tests/benchmarks/prediction_peers.py [--out FOLDER]

28,800 rows of six outputs after learning from 755 samples, at given hyperparameters: six shared latents and 15
regressors, for scikit-learn six processes of one output. The factorisation is done before; memory is what the
prediction adds to a process of its own, at its peak. GPyTorch by Cholesky and in chunks of 200 rows: it forms the joint
covariance of a chunk to take its diagonal, and larger chunks are slower.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from _common import extra_memory, finish, in_own_process, interleaved, parser_of, use_torch_threads
from likelihood import LENGTH, NOISE, Case

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian

CHUNK = 200


def asked(case, rows):
    return np.random.default_rng(2).normal(size=(rows, case.d))


def ours(case, rows):
    X, Y = case.table()
    kernel = ConvolvedGaussian(case.M, private_latents=False)
    model = DependentGPRegressor(kernel, trend=None, inference="exact", optimizer=None, random_state=0).fit(X, Y)
    Xs = asked(case, rows)
    return lambda return_std: model.predict(Xs, return_std=return_std)


def sklearn_alone(case, rows):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF

    X, Y = case.table()
    models = [GaussianProcessRegressor(RBF(LENGTH), alpha=NOISE, optimizer=None).fit(X, y) for y in Y.T]
    Xs = asked(case, rows)
    return lambda return_std: [model.predict(Xs, return_std=return_std) for model in models]


def gpytorch_cholesky(case, rows):
    use_torch_threads()
    import gpytorch
    import torch
    from _gpytorch import cholesky, exact_lcm

    model, likelihood = exact_lcm(*case.table(), case.M, length_scale=LENGTH, noise=NOISE)
    model.eval()
    likelihood.eval()
    parts = torch.as_tensor(asked(case, rows)).split(CHUNK)

    def predict(return_std):
        skipped = gpytorch.settings.skip_posterior_variances(not return_std)
        with torch.no_grad(), cholesky(), gpytorch.settings.max_cholesky_size(10**6), skipped:
            for part in parts:
                found = model(part)
                _ = found.stddev if return_std else found.mean

    predict(True)  # caches the factor
    return predict


CONTENDERS = {
    "skdgp": ours,
    "scikit-learn, each output alone": sklearn_alone,
    "GPyTorch LCM, Cholesky": gpytorch_cholesky,
}


def memory(name, case, rows):
    predict = CONTENDERS[name](case, rows)
    return extra_memory(lambda: predict(True))


def compare(case, rows, names, repeats, isolated=True):
    functions = {}
    for name in names:
        try:
            functions[name] = CONTENDERS[name](case, rows)
        except ImportError as error:
            print(f"{name}: left out, {error}", file=sys.stderr)
    means = interleaved({name: lambda f=f: f(False) for name, f in functions.items()}, repeats)
    both = interleaved({name: lambda f=f: f(True) for name, f in functions.items()}, repeats)
    table = []
    for name in functions:
        peak = in_own_process(__file__, "--memory", name, rows, *case) if isolated else memory(name, case, rows)
        row = {"what": name, "mean, s": means[name], "mean and std, s": both[name]}
        table.append(row | {"peak memory, MB": None if peak is None else round(peak / 1e6)})
    return table


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    case, rows = (Case(20, 3, 2, 3), 50) if options.smoke else (Case(), 28800)
    names = ["skdgp"] if options.no_peers else list(CONTENDERS)
    finish(options, "prediction_peers", prediction=compare(case, rows, names, options.repeats, not options.smoke))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--memory"]:
        name, rows, *sizes = sys.argv[2:]
        print(json.dumps(memory(name, Case(*map(int, sizes)), int(rows))))
    else:
        main()
