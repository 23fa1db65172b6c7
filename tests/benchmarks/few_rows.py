"""Bands with few rows for each regressor: from how many on do they hold, and is it said below?

    python tests/benchmarks/few_rows.py [--out OUT] [--seeds 0 1 2 3]

The truth is linear in 4 and in 8 regressors, with two outputs and 10 % noise. Each row of the table is the mean over
seeds and both numbers of regressors: the share of 200 new observations in the 95 % band, and of the worst fit.
"""

from __future__ import annotations

import warnings

import numpy as np
from _common import finish, parser_of

from skdgp import DependentGPRegressor, FewRowsWarning
from skdgp.metrics import interval_coverage

RATIOS, REGRESSORS, NEW = (3.0, 5.0, 7.5, 10.0, 15.0, 20.0), (4, 8), 200
MODELS = {
    "DependentGPRegressor": DependentGPRegressor,
    "trend alone": lambda **options: DependentGPRegressor(structure="trend", **options),
}


def case(make, n, d, seed, **options):
    """Return the share of new observations in the band, and whether the fit says that rows are few."""
    rng = np.random.default_rng([n, d, seed])
    X = rng.normal(size=(n + NEW, d))
    truth = X @ rng.normal(size=(d, 2))
    truth /= truth.std(axis=0)
    Y = truth + 0.1 * rng.normal(size=truth.shape)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = make(random_state=0, **options).fit(X[:n], Y[:n])
    mean, std = model.predict(X[n:], return_std=True, include_noise=True)
    return interval_coverage(Y[n:], mean, std), any(one.category is FewRowsWarning for one in said)


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
    options = parser.parse_args(words)
    ratios, numbers, fit = (RATIOS[:1], REGRESSORS[:1], {"max_iter": 2}) if options.smoke else (RATIOS, REGRESSORS, {})
    rows = []
    for ratio in ratios:
        row = {"rows for each regressor": ratio}
        for name, make in MODELS.items():
            found = [case(make, int(ratio * d), d, seed, **fit) for d in numbers for seed in options.seeds]
            share, said = np.array(found, dtype=float).T
            row |= {f"{name}: in the band, %": 100 * share.mean(), f"{name}: worst, %": 100 * share.min()}
            row[f"{name}: warned, %"] = 100 * said.mean()
        print(row, flush=True)
        rows.append(row)
    finish(options, "few_rows", coverage=rows)


if __name__ == "__main__":
    main()
