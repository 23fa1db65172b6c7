"""How often the 95 % bands of the function hold at the centre of the data, in the middle, at the edge, outside.

    python tests/benchmarks/bands.py --out OUT

Two outputs of normal regressors with noise of standard deviation 0.5 are learned by the defaults.
"linear" is X W with slopes of variance 1 / d, "smooth" adds a sine of the first and a cosine of the
last regressor. Places are distances from the mean of the regressors over the root of d: at most 0.1
(centre), 0.3 to 0.7 (middle), 0.9 to 1.3 (edge), 1.7 to 2.2 (outside); 50 points each. Points of
one fit and one output are correlated, so coverage has a standard error of some 3 % of 20 seeds at
the centre.
"""

import numpy as np
from _common import Kept, finish, parser_of
from numpy.random import default_rng

from skdgp import DependentGPRegressor
from skdgp.metrics import interval_coverage

NOISE = 0.5
POINTS = 50
PLACES = {
    "centre": (0.0, 0.1),
    "middle": (0.3, 0.7),
    "edge": (0.9, 1.3),
    "outside": (1.7, 2.2),
}
# Seeds by the number of rows
SEEDS = {20: 20, 100: 20, 400: 10, 2000: 3}


def linear(X, W):
    return X @ W


def smooth(X, W):
    first = np.sin(1.5 * X[:, :1]) * [1.0, -0.5]
    last = 0.5 * np.cos(1.2 * X[:, -1:]) * [0.5, 1.0]
    return X @ W + first + last


FUNCTIONS = {"linear": linear, "smooth": smooth}


def inside(name, d, n, seed):
    """Return the fraction of points whose function lies in the band, by place."""
    rng = default_rng([seed, d, n])
    W = rng.normal(size=(d, 2)) / np.sqrt(d)
    X = rng.normal(size=(n, d))
    function = FUNCTIONS[name]
    Y = function(X, W) + 3.0 + rng.normal(0, NOISE, (n, 2))
    model = DependentGPRegressor(random_state=0).fit(X, Y)
    held = {}
    for place, (near, far) in PLACES.items():
        direction = rng.normal(size=(POINTS, d))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        asked = direction * np.sqrt(d) * rng.uniform(near, far, (POINTS, 1))
        mean, std = model.predict(asked, return_std=True)
        held[place] = interval_coverage(function(asked, W) + 3.0, mean, std)
    return held


def table(runs):
    """Return a row for each function, number of regressors and of rows, with the mean over seeds in percent."""
    groups = runs.groupby(["function", "regressors", "rows"], sort=False)
    means = 100 * groups[[*PLACES]].mean().add_suffix(", %")
    means.index = [f"{name}, {d} regressors, {n} rows" for name, d, n in means.index]
    return means.reset_index(names="function").to_dict("records")


def main(words=None):
    options = parser_of(__doc__, smoke=True).parse_args(words)
    kept = Kept(options, "bands")
    sizes = {20: 1} if options.smoke else SEEDS
    for name in FUNCTIONS:
        for d in (1,) if options.smoke else (1, 3, 9):
            for n, seeds in sizes.items():
                for seed in range(seeds):
                    key = {"function": name, "regressors": d, "rows": n, "seed": seed}
                    kept.run(key, inside, name, d, n, seed)
    finish(options, "bands", by_place=table(kept.table))


if __name__ == "__main__":
    main()
