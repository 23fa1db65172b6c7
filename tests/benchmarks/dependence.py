"""Outputs that depend on each other in known ways: what the defaults learn, beside separate processes of scikit-learn.

    python tests/benchmarks/dependence.py --out OUT

"translated": three copies of a function of one regressor, moved by 0, 1.5 and -1, each with a gap
of its own. "noisy copies": four multiples of one function of three regressors, of which one has
little noise. "mixtures": three mixtures of two functions of two regressors, each without the
samples in a region of its own. "unequal widths": the same white noise through filters of widths 0.5
and 2, with gaps. "15 regressors": of which three matter. "little overlap": two outputs that were
observed in different places, as in GPy's tutorial of coregionalisation; only there do errors and
bands refer to places where the output was not observed.
"""

from functools import partial

import numpy as np
from _common import Kept, contest, finish, parser_of
from _peers import EachOutput, Process
from made_outputs import little_overlap, noisy_copies, translated
from numpy.random import default_rng
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian
from skdgp.metrics import interval_coverage, normalized_rmse

SEEDS = range(100, 105)


def mixtures(rng):
    X = rng.uniform(-2, 2, (550, 2))
    first = np.sin(1.7 * X[:, 0]) * np.cos(X[:, 1])
    second = np.cos(1.3 * X[:, 0] + 0.8 * X[:, 1])
    F = np.column_stack([first, second]) @ [[1.0, -0.8, 0.5], [0.3, 0.6, -1.0]]
    Y = F[:150] + rng.normal(0, 0.1, (150, 3))
    for i in range(3):
        centre = rng.uniform(-1.2, 1.2, 2)
        nearest = np.argsort(np.sum((X[:150] - centre) ** 2, axis=1))[:60]
        Y[nearest, i] = np.nan
    return X[:150], Y, X[150:], F[150:]


def unequal_widths(rng):
    x = np.concatenate([np.sort(rng.uniform(0, 20, 150)), np.linspace(0.5, 19.5, 300)])
    kernel = ConvolvedGaussian(
        1, private_latents=False, amplitude=[[1.0, 1.0]], length_scale=[[[0.5], [2.0]]]
    )
    K = kernel(x[:, None]) + 1e-9 * np.eye(2 * len(x))
    F = (np.linalg.cholesky(K) @ rng.normal(size=2 * len(x))).reshape(2, -1).T
    Y = F[:150] + rng.normal(0, 0.1, (150, 2))
    Y[(x[:150] > 5) & (x[:150] < 9), 1] = np.nan
    Y[(x[:150] > 12) & (x[:150] < 15), 0] = np.nan
    return x[:150, None], Y, x[150:, None], F[150:]


def many_regressors(rng):
    X = rng.normal(size=(650, 15))
    first = np.sin(2 * X[:, 0]) + X[:, 1] * X[:, 2]
    second = np.cos(2 * X[:, 0]) + 0.5 * X[:, 1] ** 2 - X[:, 2]
    F = np.column_stack([first, second])
    return X[:250], F[:250] + rng.normal(0, 0.2, (250, 2)), X[250:], F[250:]


PROBLEMS = {
    "translated": translated,
    "noisy copies": noisy_copies,
    "mixtures": mixtures,
    "unequal widths": unequal_widths,
    "15 regressors": many_regressors,
    "little overlap": little_overlap,
}


def separately(X, Y, points):
    """Return mean and standard deviation of a process of scikit-learn for each output."""
    scaler = StandardScaler()
    model = EachOutput(partial(Process, searches=4)).fit(scaler.fit_transform(X), Y)
    asked = scaler.transform(points)
    return model.predict(asked), model.bands(asked)[0]


def one_structure(X, Y, points):
    """Return mean and standard deviation of one kernel without shifts."""
    model = DependentGPRegressor(structure="joint", random_state=0).fit(X, Y)
    return model.predict(points, return_std=True)


def defaults(X, Y, points):
    return DependentGPRegressor(random_state=0).fit(X, Y).predict(points, return_std=True)


METHODS = {"skdgp": defaults, "one structure": one_structure, "scikit-learn": separately}


def scored(problem, method, seed):
    """Return the error over the spread of the truth, and the percentage of points inside the band."""
    X, Y, points, truth = PROBLEMS[problem](default_rng(seed))
    mean, std = METHODS[method](X, Y, points)
    held = 100 * interval_coverage(truth, mean, std)
    return {"error": normalized_rmse(truth, mean), "held": held}


def main(words=None):
    options = parser_of(__doc__, smoke=True).parse_args(words)
    kept = Kept(options, "dependence")
    for problem in ["unequal widths"] if options.smoke else PROBLEMS:
        for method in METHODS:
            for seed in list(SEEDS)[: 1 if options.smoke else None]:
                key = {"problem": problem, "method": method, "seed": seed}
                kept.run(key, scored, problem, method, seed)
    problems = contest(kept.table, "problem").T.reset_index(names="problem")
    finish(options, "dependence", problems=problems.to_dict("records"))


if __name__ == "__main__":
    main()
