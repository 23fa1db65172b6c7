"""Time and memory of a sparse fit as samples grow: half a flight, a flight, two flights.

    python tests/benchmarks/samples.py ../shared/data [--out FOLDER]

Whole fits with default settings, each in a process of its own; "bound" is one evaluation of the bound and its gradient
over all samples, the part that grows. Over linear: time over that of half a flight, divided by the number of samples
over that of half a flight. Without the folder of flights, random functions.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from _common import extra_memory, finish, in_own_process, parser_of

from skdgp import DependentGPRegressor
from skdgp.inference import Data, SparsePosterior, shares_of

FLIGHTS = ("train_latlon", "train_lateral")
SMOKE = {"n_inducing": 5, "max_iter": 2}


def table(folder, n):
    """Return regressors and coefficients of the first n samples of the training flights, one after the other."""
    if folder is None:
        rng = np.random.default_rng(0)
        X = rng.normal(size=(n, 3))
        return X, np.sin(X @ rng.normal(size=(3, 6)) / 2) + 0.1 * rng.normal(size=(n, 6))
    from heldout import flights

    tasks = [flights(folder, train=name) for name in FLIGHTS]
    return tuple(np.concatenate([getattr(task, part) for task in tasks])[:n] for part in ("X", "Y"))


def fit(X, Y, **parameters):
    """Return seconds and memory of a fit, and seconds of one evaluation of the bound."""
    model, taken = DependentGPRegressor(inference="sparse", random_state=0, **parameters), []

    def fitted():
        start = time.perf_counter()
        model.fit(X, Y)
        taken.append(time.perf_counter() - start)

    memory = extra_memory(fitted)
    posterior = model.posterior_
    shares = shares_of(Data.from_table(X, (Y - np.nanmean(Y, axis=0)) / np.nanstd(Y, axis=0)))
    times = []
    for _ in range(3):
        start = time.perf_counter()
        SparsePosterior(posterior.kernel, posterior.features, posterior.noise, shares).bound_gradient()
        times.append(time.perf_counter() - start)
    return {"samples": len(X), "fit [s]": taken[0], "bound [s]": min(times), "memory [GB]": memory / 1e9}


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--one", type=int, help="only this many samples, as JSON")
    options = parser.parse_args(words)
    if options.one:
        X, Y = table(options.data, options.one)
        print(json.dumps(fit(X, Y[:, :2], **SMOKE) if options.smoke else fit(X, Y)))
        return
    sizes = (40,) if options.smoke else (7200, 14400, 28800)
    words = [*filter(None, [options.data]), *(["--smoke"] if options.smoke else [])]
    rows = [in_own_process(Path(__file__), *words, "--one", n) for n in sizes]
    first = rows[0]
    for row in rows:
        for part in ("fit", "bound"):
            growth = row[f"{part} [s]"] / first[f"{part} [s]"]
            row[f"{part} over linear"] = growth / (row["samples"] / first["samples"])
    finish(options, "samples", growth_with_samples=rows)


if __name__ == "__main__":
    sys.exit(main())
