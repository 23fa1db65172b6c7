"""Error on flights that were not learned from, over the number of rows that were.

    python tests/benchmarks/rows.py FOLDER [--sportcub FOLDER] [--out OUT] [--flights NAME ...] [--seeds 0 1 2] [--redo]

FOLDER is that of the shared data; ``--sportcub`` that of sportcub.py. The default regressor of ``identify`` and least
squares learn the same rows, spread evenly over the flights by ``thin_targets``, from the regressors of the default
pipeline. NRMSE is the mean over the six coefficients, against the truth where the test flight has it, else against the
measured coefficients. Each run is kept as OUT/rows/FLIGHT-ROWS-SEED.json, and not run again unless ``--redo`` says so.
"""

import sys
import time
import warnings
from pathlib import Path

import comparison
import numpy as np
import pandas as pd
import sportcub
from _common import finish, parsed
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from skdgp import make_identification_pipeline
from skdgp.metrics import normalized_rmse
from skdgp.model_selection import thin_targets

SIZES = (100, 300, 1000, 3000, "all")
FLIGHTS = {
    "viggen_latlon": "delta, to two altitudes (truth)",
    "ampyx_ap2": "AP2, real, other blocks",
    "sportcub": "Sport Cub, real, other records",
}


def task_of(name, options):
    """Return the task of comparison.py or sportcub.py, and the regressors of its pipeline."""
    if name != "sportcub":
        return comparison.task_of(name, options.data), "quasi-steady"
    cub = sportcub.task_of(options.sportcub, "direct")
    train, test = (pd.concat(part.tables, ignore_index=True) for part in (cub.train, cub.test))
    targets, measured = (pd.concat(part.coefficients, ignore_index=True) for part in (cub.train, cub.test))
    return comparison.Task(cub.aircraft, train, test, targets, measured.to_numpy(), None, 0), sportcub.REGRESSORS


class Learner:
    """A task with its regressors, made once."""

    def __init__(self, task, regressors):
        pipeline = make_identification_pipeline(task.aircraft, regressors=regressors)
        self.task, self.regressor = task, pipeline[-1]
        self.X = np.asarray(pipeline[:-1].fit_transform(task.train))
        self.Xt = np.asarray(pipeline[:-1].transform(task.test))
        self.clock = {name: task.train[name].to_numpy() for name in ("time", "flight") if name in task.train}
        self.n_rows = int(task.targets.notna().any(axis=1).sum())

    def run(self, n_rows, seed):
        """Return errors and times of both methods."""
        targets = thin_targets(self.task.targets, n_rows)
        rows = targets.notna().all(axis=1).to_numpy()
        model = clone(self.regressor).set_params(random_state=seed)
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(self.X, targets.to_numpy(), **self.clock)
        seconds = time.process_time() - start
        line = LinearRegression().fit(self.X[rows], targets.to_numpy()[rows])
        return {
            "rows": n_rows,
            "seed": seed,
            "skdgp": self.error(model),
            "least squares": self.error(line),
            "trend": float(np.mean(getattr(model, "weights_", {}).get("trend", 0.0))),
            "inference": str(model.inference_),
            "cpu_seconds": seconds,
        }

    def error(self, model):
        asked = self.task.measured if self.task.truth is None else self.task.truth
        return float(normalized_rmse(asked, model.predict(self.Xt)))


def table(runs):
    """Return a row for each flight and number of rows; the errors of skdgp are over the seeds."""
    rows, best = [], {}
    order = {name: k for k, name in enumerate(FLIGHTS)}
    keys = sorted({(run["flight"], run["rows"]) for run in runs}, key=lambda key: (order[key[0]], key[1]))
    for flight, n in keys:
        found = [run for run in runs if (run["flight"], run["rows"]) == (flight, n)]
        errors = [run["skdgp"] for run in found]
        before = best.get(flight)
        best[flight] = min(np.median(errors), before or np.inf)
        rows.append(
            {
                "flight": FLIGHTS.get(flight, flight),
                "rows": n,
                "NRMSE least squares": found[0]["least squares"],
                "NRMSE skdgp, median": float(np.median(errors)),
                "NRMSE lowest": min(errors),
                "NRMSE highest": max(errors),
                "median over best of fewer rows": before and float(np.median(errors) / before),
                "seeds": len(found),
                "inference": "; ".join(sorted({run["inference"] for run in found})),
                "weight of the trend": float(np.mean([run["trend"] for run in found])),
                "CPU s": float(np.median([run["cpu_seconds"] for run in found])),
            }
        )
    return rows


def main(words=None):
    parser = comparison.runs_parser(__doc__, FLIGHTS)
    parser.add_argument("--sportcub", type=Path, help="unpacked copy of jgoppert/sysid_litreview_26")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    options = parsed(parser, words)
    if options.sportcub is None:
        options.flights = [name for name in options.flights if name != "sportcub"]
    kept = comparison.Kept(options.out, "rows")
    for seed in options.seeds:
        for flight in options.flights:
            learner = Learner(*task_of(flight, options))
            for n in sorted({learner.n_rows if n == "all" else n for n in SIZES}):
                name = f"{flight}-{n}-{seed}"
                if n > learner.n_rows or (name in kept and not options.redo):
                    continue
                kept.keep(name, {"flight": flight, **learner.run(n, seed)})
                found = {method: round(kept.memory[name][method], 3) for method in ("skdgp", "least squares")}
                print(f"{name}: NRMSE {found}", file=sys.stderr, flush=True)
    finish(options, "rows", error_over_rows=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
