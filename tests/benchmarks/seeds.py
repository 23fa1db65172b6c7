"""How far the seed changes the default pipeline: errors and bands of the same flights from several seeds.

    python tests/benchmarks/seeds.py ../shared/data --out OUT [--flights F] [--seeds S] [--redo]

Flights and scores are those of comparison.py. The seed decides which samples hyperparameters are
learned from, and which blocks of the log tell the search when to stop. Each run is kept as
OUT/seeds/FLIGHT-SEED.json, and not run again unless ``--redo`` says so.
"""

import sys

import numpy as np
from _common import finish, parsed
from _comparison_methods import Identification
from comparison import FLIGHTS, Kept, runs_parser, scores, task_of, toy

STEP = "dependentgpregressor__random_state"


def table(runs):
    """Return a row for each flight: medians and ranges over the seeds."""
    rows = []
    for flight in dict.fromkeys(run["flight"] for run in runs):
        some = [run for run in runs if run["flight"] == flight]
        errors = np.array([run["NRMSE"] for run in some])
        row = {
            "flight": flight,
            "NRMSE, median": np.median(errors.mean(axis=1)),
            "range": _range(errors.mean(axis=1)),
        }
        row |= {
            name: _range(column) for name, column in zip(some[0]["outputs"], errors.T, strict=True)
        }
        for kind in ("truth", "measured"):
            held = [
                100 * np.mean(run["band_holds"][kind]) for run in some if kind in run["band_holds"]
            ]
            row[f"band of {kind} holds %"] = f"{min(held):.0f} to {max(held):.0f}" if held else None
        rows.append(row | {"seeds": len(some)})
    return rows


def _range(values):
    return f"{min(values):.3f} to {max(values):.3f}"


def main(words=None):
    parser = runs_parser(__doc__, FLIGHTS, smoke=True)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    options = parsed(parser, words)
    kept = Kept(options.out, "seeds")
    for flight in ["toy"] if options.smoke else options.flights:
        task = toy() if options.smoke else task_of(flight, options.data)
        for seed in options.seeds[:1] if options.smoke else options.seeds:
            name = f"{flight}-{seed}"
            if name in kept and not options.redo:
                continue
            model = Identification(parameters={STEP: seed}).fit_flight(task)
            kept.keep(
                name,
                {"flight": flight, **scores(task, model, np.asarray(model.transform(task.test)))},
            )
            print(
                f"{name}: NRMSE {np.mean(kept.memory[name]['NRMSE']):.3f}",
                file=sys.stderr,
                flush=True,
            )
    finish(options, "seeds", of_the_defaults=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
