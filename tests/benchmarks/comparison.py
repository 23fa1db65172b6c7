"""Every method of the field on the same samples: how far predictions of an unseen flight are off, what bands hold.

    python tests/benchmarks/comparison.py ../shared/data --out OUT [--flights F] [--inputs I] [--methods M] [--redo]

Each method learns the measured coefficients of one flight, from 755 samples spread evenly or from
all of them, and predicts another flight, from the same regressors. These come from raw channels
with plain finite differences, from channels filtered by ``FlightSmoother``, or from
``FlightPathReconstruction``; each scaled. ``pipeline`` is ``make_identification_pipeline`` as it
stands; its inputs are its ``own``, which the others get as well. NRMSE and median relative error
are of every sample of the test flight, against truth where there is one; what 95 % bands hold is of
every tenth sample: bands of the function against truth, bands of measurements against measured
coefficients. AP2: ten blocks in time, odd ones learned from, even ones predicted.

Each run is kept as OUT/comparison/FLIGHT-INPUTS-METHOD.json, and not run again unless ``--redo``
says so; the tables are of all runs that are there. Peers take some hours on one core.
"""

import json
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import finish, parsed, parser_of
from _comparison_methods import INPUTS, METHODS, regressors
from _comparison_tables import tables

from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import interval_coverage, median_relative_error, normalized_rmse
from skdgp.model_selection import thin_targets

SAMPLES = 755
BANDS_EVERY = 10
OWN = "own"  # inputs as the pipeline makes them
FLIGHTS = {
    "viggen_latlon": ("viggen_uav", "train_latlon", "test_twoalt"),
    "c172p": ("c172p", "train_latlon", "test_calm"),
    "viggen_lateral": ("viggen_uav", "train_lateral", "test_twoalt"),
    "viggen_lateral_to_latlon": ("viggen_uav", "train_lateral", "train_latlon"),
    "ampyx_ap2": None,
}


class Task(NamedTuple):
    """A flight to learn from, one to predict, the targets of both, and what is asked of the second."""

    aircraft: Aircraft
    train: pd.DataFrame
    test: pd.DataFrame
    targets: pd.DataFrame
    measured: np.ndarray
    truth: np.ndarray | None
    samples: int

    @property
    def thinned(self):
        return thin_targets(self.targets, self.samples)


def task_of(name, folder):
    """Return the task of the shared data that has this name."""
    folder, loads = Path(folder), {}
    if name == "ampyx_ap2":
        aircraft, train, test, loads = ampyx_ap2(folder)
    else:
        craft, *parts = FLIGHTS[name]
        aircraft = Aircraft.from_json(folder / "flights" / f"{craft}.json")
        train, test = (
            read_flight(folder / "flights" / f"{craft}_{part}.parquet") for part in parts
        )
    targets, measured = (
        aerodynamic_coefficients(table, aircraft, **loads) for table in (train, test)
    )
    truth = [f"{column}_true" for column in targets]
    truth = test[truth].to_numpy() if set(truth) <= set(test) else None
    return Task(aircraft, train, test, targets, measured.to_numpy(), truth, SAMPLES)


def ampyx_ap2(folder):
    """Return aircraft, training and test blocks, and the keywords of the inverse dynamics."""
    table = read_flight(folder / "ampyx_ap2" / "ampyx_ap2.parquet")
    block = np.arange(len(table)) * 10 // len(table)
    table["flight"] = [f"block {b + 1}" for b in block]
    parts = (table[block % 2 == k].reset_index(drop=True) for k in (0, 1))
    loads = {"thrust": None, "external_forces": ["tether"]}
    return Aircraft.from_json(folder / "ampyx_ap2" / "ampyx_ap2.json"), *parts, loads


def toy(n=300):
    """Return a task of the same form that takes no time."""
    rng = np.random.default_rng(0)
    glider = Aircraft(
        mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25
    )

    def flight():
        moves = {
            name: np.convolve(rng.normal(size=n), np.ones(9) / 90, "same")
            for name in ("alpha", "beta", *"pqr")
        }
        surfaces = {name: rng.normal(0, 0.1, n) for name in ("elevator", "aileron", "rudder")}
        table = pd.DataFrame({"time": 0.05 * np.arange(n), "airspeed": 12.0, **moves, **surfaces})
        truth = pd.DataFrame(
            {"CZ": -4 * table.alpha + table.alpha**2, "Cm": -table.alpha - table.elevator}
        )
        return table, truth, truth + rng.normal(0, 0.01, truth.shape)

    (train, _, targets), (test, truth, measured) = flight(), flight()
    return Task(glider, train, test, targets, measured.to_numpy(), truth.to_numpy(), 40)


def run(task, X, Xt, name):
    """Return the scores of one method; X, Xt: regressors of the two flights, which a whole pipeline makes itself."""
    method = METHODS[name]
    rows = (task.targets if method.all_samples else task.thinned).notna().all(axis=1).to_numpy()
    start = time.process_time()
    if method.whole:
        model = method.make().fit_flight(task)
    else:
        model = method.make().fit(X[rows], task.targets.to_numpy()[rows])
    seconds = time.process_time() - start
    if method.whole:
        Xt = np.asarray(model.transform(task.test))
    kept = {"samples": int(rows.sum()), "cpu_seconds": seconds, "date": time.strftime("%Y-%m-%d")}
    return {**kept, **scores(task, model, Xt)}


def scores(task, model, Xt):
    """Return what a fitted model is worth on the test flight, whose regressors are Xt."""
    mean, some = model.predict(Xt), slice(None, None, BANDS_EVERY)
    bands = model.bands(Xt[some])
    asked = task.measured if task.truth is None else task.truth
    holds = {}
    if bands:
        holds["measured"] = covered(task.measured[some], mean[some], bands[1])
        if task.truth is not None:
            holds["truth"] = covered(task.truth[some], mean[some], bands[0])
    return {
        "outputs": list(task.targets),
        "NRMSE": normalized_rmse(asked, mean, multioutput="raw_values").tolist(),
        "median_relative_error": median_relative_error(
            asked, mean, multioutput="raw_values"
        ).tolist(),
        "band_holds": holds,
    }


def covered(y, mean, std):
    return interval_coverage(y, mean, std, multioutput="raw_values").tolist()


def wanted(options, peers):
    """Yield (flight, inputs, method) of every run that is asked for, those that matter most first."""
    for inputs in options.inputs:
        for flight in options.flights:
            for name, method in METHODS.items():
                asked = name in options.methods or ("ours" in options.methods and method.ours)
                if asked and (inputs == OWN or not method.whole) and (peers or not method.gpytorch):
                    yield flight, inputs, name


class Kept:
    """Results of runs in a folder, or in memory alone where there is none."""

    def __init__(self, folder, name="comparison"):
        self.folder, self.memory = folder and folder / name, {}
        for path in sorted(self.folder.glob("*.json")) if self.folder else ():
            self.memory[path.stem] = json.loads(path.read_text())

    def __contains__(self, name):
        return name in self.memory

    def keep(self, name, result):
        self.memory[name] = result
        if self.folder:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def runs_parser(description, flights, **more):
    """Return a parser of scripts that keep their runs: folder of the data, flights, ``--redo``."""
    parser = parser_of(description, data=True, redo=True, **more)
    parser.add_argument("--flights", nargs="+", choices=flights, default=list(flights))
    return parser


def main(words=None):
    parser = runs_parser(__doc__, FLIGHTS, smoke=True)
    parser.add_argument("--inputs", nargs="+", choices=INPUTS, default=list(INPUTS))
    parser.add_argument("--methods", nargs="+", choices=[*METHODS, "ours"], default=[*METHODS])
    options = parsed(parser, words)
    if options.smoke:
        options.flights, options.inputs = (
            ["toy"],
            [kind for kind in ("filtered", OWN) if kind in options.inputs],
        )
    kept, task, X, known = Kept(options.out), None, None, None
    for flight, inputs, method in wanted(options, not options.no_peers and find_spec("gpytorch")):
        name = f"{flight}-{inputs}-{method}"
        if name in kept and not options.redo:
            continue
        if known != (flight, inputs):
            task = toy() if options.smoke else task_of(flight, options.data)
            X = regressors(inputs, task)
            known = flight, inputs
        result = run(task, *X, method)
        kept.keep(name, {"flight": flight, "inputs": inputs, "method": method, **result})
        print(
            f"{name}: NRMSE {np.mean(result['NRMSE']):.3f}, {result['cpu_seconds']:.0f} s",
            file=sys.stderr,
            flush=True,
        )
    finish(options, "comparison", **tables(kept.memory))


if __name__ == "__main__":
    main()
