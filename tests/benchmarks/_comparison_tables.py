"""The comparison's runs as tables: for each flight a summary over inputs, and errors of each coefficient."""

import numpy as np
from _comparison_methods import METHODS, ORDER


def tables(runs):
    """Return tables by name from the runs, a dict of name to result."""
    found = {}
    for flight in dict.fromkeys(run["flight"] for run in runs.values() if "flight" in run):
        own = {
            (run["method"], run["inputs"]): run
            for run in runs.values()
            if run.get("flight") == flight
        }
        found[flight] = [
            summary(own, name) for name in ORDER if any(name == method for method, _ in own)
        ]
        shown = [
            own[name, shown_inputs(name)] for name in ORDER if (name, shown_inputs(name)) in own
        ]
        found[f"{flight}_NRMSE"] = [coefficients(run, "NRMSE", 1) for run in shown]
        found[f"{flight}_relative"] = [
            coefficients(run, "median_relative_error", 100, "%") for run in shown
        ]
    return found


def summary(runs, name):
    own = {
        kind: runs[name, kind]
        for kind in ("raw", "filtered", "reconstructed", "own")
        if (name, kind) in runs
    }
    shown = own.get(shown_inputs(name), {})
    holds = {
        kind: 100 * float(np.mean(values)) for kind, values in shown.get("band_holds", {}).items()
    }
    return {
        "method": METHODS[name].name,
        "samples": next(iter(own.values()))["samples"],
        **{
            f"NRMSE {kind}": mean(own.get(kind))
            for kind in ("raw", "filtered", "reconstructed", "own")
        },
        "band of truth holds %": holds.get("truth"),
        "band of measured holds %": holds.get("measured"),
        "CPU s": shown.get("cpu_seconds"),
    }


def shown_inputs(name):
    """Return the inputs whose bands, seconds and coefficients are shown."""
    return "own" if METHODS[name].whole else "filtered"


def mean(run):
    return run and float(np.mean(run["NRMSE"]))


def coefficients(run, score, factor, unit=""):
    each = {
        f"{name} {unit}".strip(): factor * value
        for name, value in zip(run["outputs"], run[score], strict=True)
    }
    return {"method": METHODS[run["method"]].name, "samples": run["samples"], **each}
