"""What each part of the identification pipeline is worth: its defaults, and the same with one part turned off.

    python tests/benchmarks/ablation.py ../shared/data --out OUT [--flights F] [--parts P] [--redo]

Flights, samples and scores are those of comparison.py; ``PARTS`` says what "off" means. Each run is
kept as OUT/ablation/FLIGHT-PART.json, and not run again unless ``--redo`` says so.
"""

import sys
import time

import numpy as np
from _common import finish, parsed
from _comparison_methods import Identification
from comparison import FLIGHTS, Kept, runs_parser, scores, task_of

PLAIN = {"reconstruction": "passthrough"}
# of Identification: arguments of make_identification_pipeline, parameters of its steps, and what
# else
PARTS = {
    "defaults": {},
    "reconstruction": {"arguments": PLAIN},
    "reconstruction_and_smoothing": {"arguments": {**PLAIN, "cutoff": None}},
    "quasi-steady_regressors": {"arguments": {"regressors": "classical"}},
    "input_noise": {"parameters": {"dependentgpregressor__input_noise": None}},
    "trend": {"parameters": {"dependentgpregressor__trend": "constant"}},
    "processes__the_trend_alone": {"parameters": {"dependentgpregressor__structure": "trend"}},
    "all_samples_but_755": {"samples": 755},
}


def run(task, part):
    """Return the scores of the pipeline without that part."""
    start = time.process_time()
    model = Identification(**PARTS[part]).fit_flight(task)
    seconds = time.process_time() - start
    found = scores(task, model, model.transform(task.test))
    return {**found, "cpu_seconds": seconds, "date": time.strftime("%Y-%m-%d")}


def table(runs):
    """Return a row for each flight and part, its error beside that of the defaults."""
    errors = {(run["flight"], run["part"]): float(np.mean(run["NRMSE"])) for run in runs}
    order = {part: k for k, part in enumerate(PARTS)}
    return [
        {
            "flight": run["flight"],
            "without": "-"
            if run["part"] == "defaults"
            else run["part"].replace("__", ": ").replace("_", " "),
            "NRMSE": errors[run["flight"], run["part"]],
            "over that of the defaults": ratio(errors, run),
            **{f"band of {kind} holds %": held(run, kind) for kind in ("truth", "measured")},
            "CPU s": run["cpu_seconds"],
        }
        for run in sorted(
            (run for run in runs if run["part"] in order),
            key=lambda run: (run["flight"], order[run["part"]]),
        )
    ]


def ratio(errors, run):
    defaults = errors.get((run["flight"], "defaults"))
    return defaults and errors[run["flight"], run["part"]] / defaults


def held(run, kind):
    return 100 * float(np.mean(run["band_holds"][kind])) if kind in run["band_holds"] else None


def main(words=None):
    parser = runs_parser(__doc__, FLIGHTS)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    options = parsed(parser, words)
    kept = Kept(options.out, "ablation")
    for flight in options.flights:
        parts = [part for part in options.parts if options.redo or f"{flight}-{part}" not in kept]
        task = parts and task_of(flight, options.data)
        for part in parts:
            result = {"flight": flight, "part": part, **run(task, part)}
            kept.keep(f"{flight}-{part}", result)
            print(
                f"{flight}-{part}: NRMSE {np.mean(result['NRMSE']):.3f}",
                file=sys.stderr,
                flush=True,
            )
    finish(options, "ablation", one_part_off=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
