"""Which rows of a log to learn from, and when more of it teaches nothing: by information, beside even thinning.

    python tests/benchmarks/information.py FOLDER [--out OUT] [--flights NAME ...] [--seeds 0 1 2] [--redo]

FOLDER is that of the shared data. Rows: hyperparameters are learned once, from 600 even rows with the dependent
processes; the posterior of 100, 300 or 1000 rows is then scored on the test flight, against truth where there is one.
The rows are spread evenly, drawn at random, or chosen one by one from 3600 by the covariance of the model, averaged
over the outputs with each in units of its noise: the row of the largest posterior variance (a pivoted Cholesky
factorisation), or the row that lowers the mean posterior variance over the log most (`informative_targets`). Curve: the
trend alone, or with the dependent processes, learns from the first sixth of the log; `expected_learning_curve` then
says how far off the model will be after more of it, beside what is found at these hyperparameters, with 600 even rows
of the whole log. Each run is kept as OUT/information/NAME.json, and not run again unless ``--redo`` says so.
"""

from __future__ import annotations

import sys
import warnings

import comparison
import numpy as np
from _common import finish, parsed
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.inference import Data, ExactPosterior, input_noise_loading
from skdgp.metrics import normalized_rmse
from skdgp.model_selection import expected_learning_curve, informative_targets, thin_targets

FLIGHTS = {"viggen_latlon": "delta, to two altitudes (truth)", "ampyx_ap2": "AP2, real, other blocks"}
LEARNED, CANDIDATES, POINTS = 600, 3600, 400
SIZES = (100, 300, 1000)
PARTS = (1 / 24, 1 / 12, 1 / 6, 1 / 3, 2 / 3, 1)
FIRST = 1 / 6
RULES = {"even": "even", "random": "random", "variance": "largest variance", "mean": "lowest mean variance"}


class Log:
    """A task with its regressors, made once."""

    def __init__(self, name, options):
        self.task = comparison.toy() if options.smoke else comparison.task_of(name, options.data)
        regressors = ["alpha", "beta", "elevator"] if options.smoke else "quasi-steady"
        self.parameters = {"max_iter": 2} if options.smoke else {}
        self.pipeline = make_identification_pipeline(self.task.aircraft, regressors=regressors)
        self.X = np.asarray(self.pipeline[:-1].fit_transform(self.task.train))
        self.Xt = np.asarray(self.pipeline[:-1].transform(self.task.test))
        self.Y = self.task.targets.to_numpy()
        self.rows = np.flatnonzero(np.isfinite(self.Y).all(axis=1))
        self.asked = self.task.measured if self.task.truth is None else self.task.truth
        self.clock = {name: self.task.train[name].to_numpy() for name in ("time", "flight") if name in self.task.train}

    def fitted(self, targets, seed, structure):
        """Return a model that is learned exactly."""
        options = {"input_noise": "learned", "early_stopping": True, "inference": "exact", "random_state": seed}
        return DependentGPRegressor(structure=structure, **options, **self.parameters).fit(
            self.X, targets.to_numpy(), **self.clock
        )

    def error(self, model, rows):
        """Return the mean NRMSE of the posterior of some rows, at the hyperparameters of a model."""
        loading = None if model._root is None else input_noise_loading(model.posterior_, self.X[rows], model._root)
        data = Data.from_table(self.X[rows], (self.Y[rows] - model._center) / model._scale, loading)
        mean = ExactPosterior(model.kernel_, model.posterior_.noise, data).predict(self.Xt)
        return float(normalized_rmse(self.asked, mean * model._scale + model._center))

    def linear_error(self, rows):
        line = LinearRegression().fit(self.X[rows], self.Y[rows])
        return float(normalized_rmse(self.asked, line.predict(self.Xt)))


def spread(rows, n):
    return rows[((np.arange(n) + 0.5) * len(rows) / n).astype(int)]


def largest_variance(model, X, n):
    """Return n rows of X, each that of the largest posterior variance: a pivoted Cholesky factorisation."""
    noise = model.posterior_.noise

    def covariance(A, B):
        return sum(model.kernel_.block(i, i, A, B) / one for i, one in enumerate(noise)) / len(noise)

    variance = np.array([covariance(x[None], x[None])[0, 0] for x in X])
    L, found = np.zeros((n, len(X))), []
    for k in range(n):
        score = variance.copy()
        score[found] = -np.inf
        best = int(score.argmax())
        L[k] = (covariance(X[best : best + 1], X)[0] - L[:k, best] @ L[:k]) / np.sqrt(variance[best] + 1)
        variance = np.maximum(variance - L[k] ** 2, 0.0)
        found.append(best)
    return np.array(found)


def rows_run(log, seed):
    """Return the errors of all rules and sizes."""
    model = log.fitted(thin_targets(log.task.targets, LEARNED), seed, "joint")
    candidates = log.rows[:: max(1, len(log.rows) // CANDIDATES)]
    most = min(max(SIZES), len(candidates))
    pivots = candidates[largest_variance(model, log.X[candidates], most)]
    found = []
    for n in (min(size, most) for size in SIZES):
        picked = {"even": spread(log.rows, n)}
        picked["random"] = np.random.default_rng(seed).choice(log.rows, n, replace=False)
        picked["variance"] = pivots[:n]
        told = informative_targets(model, log.X, log.Y, n, n_candidates=CANDIDATES, n_points=POINTS)
        picked["mean"] = np.flatnonzero(np.isfinite(told).all(axis=1))
        found += [
            {"rows": n, "how": rule, "nrmse": log.error(model, np.sort(rows)), "linear": log.linear_error(rows)}
            for rule, rows in picked.items()
        ]
    return found


def curve_run(log, seed):
    """Return the expected and the found errors after parts of the log, of the trend and of the dependent processes."""
    return [one for structure in ("trend", "joint") for one in curve_of(log, seed, structure)]


def curve_of(log, seed, structure):
    """Return the errors of one structure."""
    step = float(np.median(np.diff(log.task.train["time"])))
    recorded = step * log.task.train.groupby(log.clock.get("flight", np.zeros(len(log.X)))).cumcount().to_numpy()
    seconds = [part * recorded.max() for part in PARTS]
    first = log.task.targets.copy()
    first.iloc[recorded > FIRST * recorded.max()] = np.nan
    recorded = recorded[log.rows]
    model = log.fitted(thin_targets(first, 400), seed, structure)
    log.pipeline.steps[-1] = (log.pipeline.steps[-1][0], model)
    options = {"seconds": seconds, "n_samples": LEARNED}
    curves = [
        expected_learning_curve(log.pipeline, log.task.train, include_noise=noise, **options) for noise in (False, True)
    ]
    even = spread(log.rows, min(LEARNED, len(log.rows)))
    found = []
    for k, second in enumerate(seconds):
        rows = np.intersect1d(even, log.rows[recorded <= second])
        means = [curve.filter(like="normalized_rmse").iloc[k].mean() for curve in curves]
        found.append({
            "structure": structure, "seconds": second, "rows": len(rows), "expected": means[0], "with noise": means[1],
            "above": float(curves[1]["above"].iloc[k]), "found": log.error(model, rows),
        })  # fmt: skip
    return found


def main(words=None):
    parser = comparison.runs_parser(__doc__, FLIGHTS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    options = parsed(parser, words)
    if options.smoke:
        options.flights, options.seeds = ["toy"], [0]
    kept = comparison.Kept(options.out, "information")
    for flight in options.flights:
        log = None
        runs = {f"{flight}-curve": (curve_run, 0)} | {
            f"{flight}-rows-{seed}": (rows_run, seed) for seed in options.seeds
        }
        for name, (run, seed) in runs.items():
            if name in kept and not options.redo:
                continue
            log = log or Log(flight, options)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                kept.keep(name, {"flight": flight, "seed": seed, "found": run(log, seed)})
            print(f"{name}: done", file=sys.stderr, flush=True)
    rows = [row for flight in options.flights for row in rows_table(flight, kept.memory, options.seeds)]
    curve = [row for flight in options.flights for row in curve_table(flight, kept.memory[f"{flight}-curve"]["found"])]
    finish(options, "information", rows_to_learn_from=rows, more_of_the_log=curve)


def curve_table(flight, found):
    """Return a row for each structure and part of a log."""
    whole = {one["structure"]: one["found"] for one in found}
    return [
        {
            "flight": FLIGHTS.get(flight, flight),
            "model": one["structure"],
            "seconds": one["seconds"],
            "rows": one["rows"],
            "NRMSE expected": one["expected"],
            "NRMSE expected, with noise": one["with noise"],
            "NRMSE found": one["found"],
            "expected, with noise, over all": 1 + one["above"],
            "found over all": one["found"] / whole[one["structure"]],
        }
        for one in found
    ]


def rows_table(flight, memory, seeds):
    """Return a row for each size: the median over seeds of each rule."""
    every = [one | {"seed": seed} for seed in seeds for one in memory[f"{flight}-rows-{seed}"]["found"]]
    found = []
    for n in dict.fromkeys(one["rows"] for one in every):
        own = [one for one in every if one["rows"] == n]
        row = {"flight": FLIGHTS.get(flight, flight), "rows": n}
        for rule, words in RULES.items():
            row[f"NRMSE {words}"] = float(np.median([one["nrmse"] for one in own if one["how"] == rule]))
        even, best = ({one["seed"]: one["nrmse"] for one in own if one["how"] == rule} for rule in ("even", "mean"))
        ratios = [best[seed] / even[seed] for seed in even]
        row["the last over even, by seed"] = f"{min(ratios):.3f} to {max(ratios):.3f}"
        for rule in ("even", "mean"):
            linear = float(np.median([one["linear"] for one in own if one["how"] == rule]))
            row[f"NRMSE least squares, {RULES[rule]}"] = linear
        found.append(row)
    return found


if __name__ == "__main__":
    main()
