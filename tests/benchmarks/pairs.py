"""Pairs of flights of seven aircraft: the average of posteriors beside its members and least squares.

    python tests/benchmarks/pairs.py REPOSITORY ../shared/data --out OUT

REPOSITORY is an unpacked copy of github.com/josemiguelbento/UAV-OAT-controlo, see _inputs.py. Each
pipeline learns the measured coefficients of some flights and predicts those of others: NRMSE, mean
over the coefficients, over that of least squares from the same regressors. Members are those of the
same fit, each alone. Coverage is of measured coefficients at one row in ten.
"""

from pathlib import Path

import numpy as np
from _common import Kept, finish, parser_of, winners
from _inputs import REPOSITORY, task_of
from comparison import BANDS_EVERY, moments_of
from sklearn.linear_model import LinearRegression

from skdgp import make_identification_pipeline
from skdgp.metrics import interval_coverage, normalized_rmse

# Inputs by their titles in the table
PAIRS = {name: name for name in REPOSITORY} | {
    "Ampyx AP2, first quarter left out": "AP2, quarter 1",
    "third": "AP2, quarter 3",
    "fourth": "AP2, quarter 4",
    "viggen to test_twoalt": "viggen",
    "c172p to test_calm": "c172p",
}
KINDS = {
    "average": "average",
    "joint": "all terms",
    "trend": "trend",
}


def result(task):
    """Return what the average and each member are worth."""
    pipeline = make_identification_pipeline(task.aircraft)
    pipeline[-1].set_params(n_latent=2, random_state=0)
    pipeline.fit(task.train, task.targets)
    last = pipeline[-1]
    mean, (_, std) = moments_of(pipeline, task.test)
    X, known = (np.asarray(pipeline[:-1].transform(part)) for part in (task.test, task.train))
    trusted = task.targets.notna().all(axis=1).to_numpy()
    least_squares = LinearRegression().fit(known[trusted], task.targets[trusted])
    measured = task.measured.to_numpy()
    some = slice(None, None, BANDS_EVERY)
    found = {
        "least squares": normalized_rmse(measured, least_squares.predict(X)),
        "average": normalized_rmse(measured, mean),
        "coverage": interval_coverage(measured[some], mean[some], std),
    }
    for name, member in zip(last.weights_, last.posterior_.members, strict=False):
        alone = member.predict(X) * last.scale_ + last.center_
        found[name] = normalized_rmse(measured, alone)
    return found


def of_pairs(runs):
    """Return a row for each pair, ratios to least squares; then geometric means."""
    table = runs.set_index("pair")[["least squares", *KINDS, "coverage"]]
    ratios = table[[*KINDS]].div(table["least squares"], axis=0).rename(columns=KINDS)
    means = f"geometric mean of the {len(table)}"
    ratios.loc[means] = np.exp(np.log(ratios).mean(skipna=False))
    table.loc[means, "least squares"] = 1.0
    return [
        {"pair": pair, "least squares": table.loc[pair, "least squares"]}
        | winners(row)
        | {"in the band, %": 100 * table.loc[pair, "coverage"]}
        for pair, row in ratios.iterrows()
    ]


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("repository", type=Path, help="the unpacked copy of the repository")
    parser.add_argument("data", type=Path, help="folder of the shared data")
    options = parser.parse_args(words)
    kept = Kept(options, "pairs")
    for pair, name in PAIRS.items():
        task = task_of(name, options.data, options.repository)
        kept.run({"pair": pair}, result, task)
    finish(options, "pairs", of_pairs=of_pairs(kept.table))


if __name__ == "__main__":
    main()
