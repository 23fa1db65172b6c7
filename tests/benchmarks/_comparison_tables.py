"""The comparison's runs as tables: for each flight a summary over inputs, and errors of each coefficient."""

import numpy as np
from _comparison_methods import METHODS, ORDER


def tables(runs):
    """Return tables by name from the runs, a dict of name to result."""
    found = {"methods": methods()}
    for flight in dict.fromkeys(run["flight"] for run in runs.values() if "flight" in run):
        own = {(run["method"], run["inputs"]): run for run in runs.values() if run.get("flight") == flight}
        found[flight] = [summary(own, name) for name in ORDER if any(name == method for method, _ in own)]
        shown = [own[name, shown_inputs(name)] for name in ORDER if (name, shown_inputs(name)) in own]
        found[f"{flight}_NRMSE"] = [coefficients(run, "NRMSE", 1) for run in shown]
        found[f"{flight}_relative"] = [coefficients(run, "median_relative_error", 100, "%") for run in shown]
    ahead = [row for flight in found if flight != "methods" for row in standing(flight, runs)]
    if ahead:
        found["standing"] = ahead
    return found


def methods():
    """Return what each method was given; those that differ in samples alone stand once."""
    each = {METHODS[name].name: METHODS[name].settings for name in ORDER}
    return [{"method": name, "settings": settings} for name, settings in each.items()]


def summary(runs, name):
    own = {kind: runs[name, kind] for kind in ("raw", "filtered", "reconstructed", "own") if (name, kind) in runs}
    shown = own.get(shown_inputs(name), {})
    holds = {kind: 100 * float(np.mean(values)) for kind, values in shown.get("band_holds", {}).items()}
    return {
        "method": METHODS[name].name,
        "samples": next(iter(own.values()))["samples"],
        **{f"NRMSE {kind}": mean(own.get(kind)) for kind in ("raw", "filtered", "reconstructed", "own")},
        "band of truth holds %": holds.get("truth"),
        "band of measured holds %": holds.get("measured"),
        "CPU s": shown.get("cpu_seconds"),
    }


def shown_inputs(name):
    """Return the inputs whose bands, seconds and coefficients are shown."""
    return "own" if METHODS[name].whole else "filtered"


def mean(run):
    return run and float(np.mean(run["NRMSE"]))


def standing(flight, runs):
    """Return a row: the pipeline's error, the best other method's, on whatever inputs, and who is ahead."""
    on = [run for run in runs.values() if run.get("flight") == flight]
    ours = next((mean(run) for run in on if METHODS[run["method"]].whole), None)
    others = sorted((run for run in on if not METHODS[run["method"]].ours), key=mean)
    if ours is None or not others:
        return []
    ahead = dict.fromkeys(called(run) for run in others if mean(run) < ours)
    return [
        {
            "flight": flight,
            "NRMSE skdgp pipeline": ours,
            "NRMSE best other": mean(others[0]),
            "best other": called(others[0]),
            "all that are ahead of the pipeline": "; ".join(ahead) or "none",
        }
    ]


def called(run):
    return f"{METHODS[run['method']].name}, {run['inputs']}, {run['samples']} samples"


def coefficients(run, score, factor, unit=""):
    each = {f"{name} {unit}".strip(): factor * value for name, value in zip(run["outputs"], run[score], strict=True)}
    return {"method": METHODS[run["method"]].name, "samples": run["samples"], **each}
