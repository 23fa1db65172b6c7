"""How far the processor and the number of threads change a model: one flight, several kernels of OpenBLAS.

    python tests/benchmarks/processors.py ../shared/data [--flight F] [--samples N ...] [--cores C ...] --out OUT

Each fit runs in a process of its own, since OpenBLAS reads OPENBLAS_CORETYPE when it is loaded. Flights and pipeline
are those of comparison.py, with seed 0 and all rows or N of them. Differences are those from the first fit of the same
rows, for every row of the test flight and all six coefficients.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from _common import finish, in_own_process, parsed, parser_of
from _comparison_methods import Identification
from comparison import FLIGHTS, task_of, toy

CORES = ("SkylakeX", "Haswell", "Sandybridge", "Prescott")
"""Kernels of OpenBLAS from the widest vectors to the narrowest."""


def fitted(options):
    """Keep what one model predicts in ``--keep``, and print how it was found."""
    task = toy() if options.smoke else task_of(options.flight, options.data)
    parameters = {f"dependentgpregressor__{name}": value for name, value in (("max_iter", 2),) if options.smoke}
    model = Identification(parameters=parameters, samples=options.samples[0]).fit_flight(task)
    mean, std = model.pipeline.predict(task.test, return_std=True)
    np.savez(options.keep, mean=mean, std=std)
    regressor = model.pipeline[-1]
    found = {"log likelihood": regressor.log_marginal_likelihood_value_, "evaluations": regressor.n_evaluations_}
    print(json.dumps(found))


def differences(one, other):
    """Return the differences of two fits: of means, over the deviations of the first, and of deviations."""
    mean = np.abs(other["mean"] - one["mean"]) / one["std"]
    return {
        "largest difference of means / std": mean.max(),
        "rms": np.sqrt(np.mean(mean**2)),
        "largest difference of std %": 100 * np.abs(other["std"] / one["std"] - 1).max(),
    }


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--flight", default="c172p", choices=FLIGHTS)
    parser.add_argument("--samples", nargs="+", type=int, default=[None], help="rows to learn from; by default all")
    parser.add_argument("--cores", nargs="+", default=CORES)
    parser.add_argument("--threads", nargs="+", type=int, default=(1, 2))
    parser.add_argument("--keep", type=Path, help="fit once, with what the environment says, and keep this file")
    options = parsed(parser, words)
    if options.keep:
        fitted(options)
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for samples in options.samples:
            runs = [(core, n) for core in options.cores[: 1 if options.smoke else None] for n in options.threads]
            for core, threads in runs:
                kept = Path(folder) / f"{samples}-{core}-{threads}.npz"
                given = ["--smoke"] if options.smoke else [options.data, "--flight", options.flight]
                given += ["--keep", kept, *(["--samples", samples] if samples else [])]
                numbers = {"OPENBLAS_CORETYPE": core, "OPENBLAS_NUM_THREADS": str(threads)}
                found = in_own_process(__file__, *given, environment=numbers)
                if found is None:
                    continue
                row = {"flight": options.flight, "samples": samples or "all", "kernels": core}
                first = Path(folder) / f"{samples}-{runs[0][0]}-{runs[0][1]}.npz"
                with np.load(first) as one, np.load(kept) as other:
                    rows.append({**row, "threads": threads, **differences(one, other), **found})
                print(f"{samples} {core} {threads}: {rows[-1]}", file=sys.stderr, flush=True)
    finish(options, "processors", equal_on_all=rows)


if __name__ == "__main__":
    main()
