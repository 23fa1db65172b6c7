"""Methods of the field on the same samples: errors on an unseen flight, and what 95 % bands hold.

    python tests/benchmarks/comparison.py ../shared/data --out OUT

Each method learns the measured coefficients of one flight and predicts another. ``skdgp pipeline``
is ``make_identification_pipeline`` with its own regressors; others learn the classical regressors of
channels smoothed by ``FlightSmoother``, scaled. NRMSE is of every sample
of the test flight, against the truth where it is known. The fraction of values in 95 % bands is of
every tenth sample: bands of the function against the truth, bands of measurements against measured
coefficients. AP2: ten blocks in time, odd ones learned from, even ones predicted.
"""

from functools import partial

import _peers as peers
import numpy as np
from _common import Kept, contest, finish, parser_of
from _inputs import task_of
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import make_identification_pipeline
from skdgp.identification import flight_regressors
from skdgp.metrics import interval_coverage, normalized_rmse
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightSmoother,
    RateNondimensionalizer,
    RegressorSelector,
)

SAMPLES = 755
BANDS_EVERY = 10
FLIGHTS = ["viggen", "c172p", "viggen lateral", "lateral to latlon", "AP2, real"]


def pipeline(task):
    """Return moments of the test flight by the default pipeline."""
    model = make_identification_pipeline(task.aircraft)
    model.set_params(dependentgpregressor__random_state=0).fit(task.train, task.targets)
    return moments_of(model, task.test)


def moments_of(model, flight):
    """Return the mean of a flight, and deviations of the function and of measurements at one row in ten."""
    X, ratio, *_ = flight_regressors(model, flight)
    some = X[::BANDS_EVERY]
    words = {"include_input_noise": ratio[::BANDS_EVERY]}
    bands = [
        model[-1].predict(some, return_std=True, include_noise=noise, **words)[1]
        for noise in (False, True)
    ]
    return model.predict_rows(X, ratio), bands


def peer(make, all_samples=True):
    """Return the same for a method that learns regressors."""

    def moments(task):
        steps = make_pipeline(
            FlightSmoother(),
            ElevonSplitter(),
            RateNondimensionalizer(span=task.aircraft.span, chord=task.aircraft.chord),
            RegressorSelector("classical"),
            StandardScaler(),
        )
        Y = task.targets if all_samples else thin_targets(task.targets, SAMPLES)
        rows = Y.notna().all(axis=1).to_numpy()
        X = np.asarray(steps.fit_transform(task.train))[rows]
        asked = np.asarray(steps.transform(task.test))
        model = make().fit(X, Y.to_numpy()[rows])
        return model.predict(asked), model.bands(asked[::BANDS_EVERY])

    return moments


PIPELINE = "skdgp pipeline"
METHODS = {
    "least squares": peer(lambda: peers.EachOutput(peers.EquationError)),
    "stepwise, second order": peer(
        lambda: peers.EachOutput(partial(peers.EquationError, 2, stepwise=True))
    ),
    "boosted trees after a trend": peer(lambda: peers.OnTrend(peers.trees())),
    "scikit-learn processes after a trend": peer(
        lambda: peers.OnTrend(peers.EachOutput(peers.Process)), all_samples=False
    ),
    "GPyTorch sparse LCM after a trend": peer(lambda: peers.OnTrend(peers.sparse_lcm())),
    PIPELINE: pipeline,
}


def scored(task, method):
    """Return the scores of one method."""
    mean, bands = METHODS[method](task)
    measured = task.measured.to_numpy()
    asked = measured if task.truth is None else task.truth
    error = normalized_rmse(asked, mean, multioutput="raw_values").tolist()
    result = {"outputs": list(task.targets), "NRMSE": error}
    kinds = {"truth": task.truth, "measured": measured}
    for (kind, y), std in zip(kinds.items(), bands, strict=False):
        if y is not None:
            held = interval_coverage(y[::BANDS_EVERY], mean[::BANDS_EVERY], std)
            result[f"{kind}, %"] = 100 * held
    return result


def errors(runs):
    """Return a row for each method: its errors on the flights, and medians over these."""
    cells = contest(runs.assign(error=runs["NRMSE"].map(np.mean)), "flight")
    medians = runs.groupby("method")[["truth, %", "seconds"]].median()
    cells[["in band of truth, %", "CPU s"]] = medians
    return cells.reset_index(names="method").to_dict("records")


def of_pipeline(table):
    """Return a row for each flight: errors of the pipeline."""
    rows = []
    for run in table[table["method"] == PIPELINE].to_dict("records"):
        row = {"flight": run["flight"], "NRMSE": np.mean(run["NRMSE"])}
        row |= dict(zip(run["outputs"], run["NRMSE"], strict=True))
        for kind in ("truth, %", "measured, %"):
            row[f"in band of {kind}"] = run[kind]
        rows.append(row)
    return rows


def main(words=None):
    options = parser_of(__doc__, data=True).parse_args(words)
    kept = Kept(options, "comparison")
    for flight in FLIGHTS:
        task = task_of(flight, options.data)
        for method in METHODS:
            kept.run({"flight": flight, "method": method}, scored, task, method)
    finish(options, "comparison", errors=errors(kept.table), pipeline=of_pipeline(kept.table))


if __name__ == "__main__":
    main()
