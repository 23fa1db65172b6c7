"""Why the learned function and its derivatives miss the truth: one cause of error switched at a time.

    python tests/benchmarks/study.py [--out OUT] [--seeds 10] [--processes 10] [--jobs N] [--aircraft c172p]

Aircraft with known truth fly the same plan again and again, each seed in other gusts and with other
sensor noise, in calm, light and moderate air. Learned functions are scored at the exact regressors
of a flight in calm air along another path, derivatives at a trim. A case says which causes of error
the training data have:

    inputs    through the default pipeline from noisy sensors, or exact
    targets   coefficients measured by noisy sensors, or exact
    rates     relative to the earth, as gyros measure them, or to the air, as the aerodynamics feel them
    slopes    alpha_dot and beta_dot: not among the regressors, like the inputs, or exact

``--processes`` seeds are learned by the default and the model for other air, ``--others`` by other
dependent processes, all ``--seeds`` by least squares. Each fit is kept under OUT/study and not done
again. JSBSim needs its wheel.
"""

import itertools
import time
from functools import partial

import _study_flights as flights
import joblib
import numpy as np
from _common import finish, parser_of
from _study_flights import NAMES
from _study_methods import EVERY, Case, agitation, line, process
from sklearn.preprocessing import PolynomialFeatures

from skdgp._flight.channels import COEFFICIENTS

EXACT, LOADS = Case("exact", "exact", "air", "exact"), Case(inputs="exact", slopes="exact")
"""Exact data, and data of which the loads alone are noisy, classical regressors."""
LOGGED, CLASSICAL = Case(), Case(slopes="own")
ASKED = {LOGGED: "quasi-steady", CLASSICAL: "classical"}
QUADRATIC = {"trend": PolynomialFeatures(2)}
SYMMETRIC = {"symmetric": True}
DEFAULTS = [
    (air, case, {}) for case in (LOGGED, CLASSICAL) for air in ("light", "moderate", "calm")
]
AIRED = [(air, Case(rates="air"), SYMMETRIC) for air in ("light", "moderate")]
COMPARED = [  # by processes: air, case, and what replaces parameters of the default regressor
    *((air, LOGGED, QUADRATIC) for air in ("light", "moderate", "calm")),
    ("light", EXACT, {}),
    ("light", LOADS, {}),
]
DERIVATIVES = [  # label, case, method
    ("default", LOGGED, "default"),
    ("default, classical", CLASSICAL, "default"),
    ("least squares", LOGGED, "least squares"),
]
QUANTILES = (0.0, 0.5, 0.8, 1.0)
PRINTED = ("Cm_alpha", "Cm_q", "Cm_alpha_dot", "Cl_p")
SHOWN = (
    *(
        "Cm_alpha",
        "Cm_q",
        "Cm_alpha_dot",
        "Cm_elevator",
        "CZ_alpha",
        "CY_beta",
        "Cl_beta",
        "Cl_p",
        "Cl_r",
    ),
    *("Cl_aileron", "Cn_beta", "Cn_p", "Cn_r", "Cn_rudder"),
)


def kept(folder, name, function):
    """Return a result from the folder, else make it and keep it there."""
    path = None if folder is None else folder / f"{name}.joblib"
    if path is not None and path.exists():
        return joblib.load(path)
    result = function()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        joblib.dump(result, path.with_suffix(".part"))
        path.with_suffix(".part").rename(path)  # whole or not at all
    return result


def named(changes):
    return [f"{name}={value}" for name, value in changes.items()]


def method_of(changes):
    return ", ".join(["default", *named(changes)])


def process_task(subject, seen, air, seed, case, changes, folder, max_iter, until):
    """Return key and result of a fit; None if it is too late to begin one."""
    name = "-".join([subject.name, air, str(seed), *case, *named(changes)])
    if time.monotonic() > until and not (folder and (folder / f"{name}.joblib").exists()):
        return None
    start = time.process_time()
    found, _ = kept(
        folder, name, partial(process, subject, seen, case, seed, changes, max_iter=max_iter)
    )
    print(f"{name}: {time.process_time() - start:.0f} s", flush=True)
    return (air, case, method_of(changes)), found


def known_task(subject, seen, seed, folder):
    """Return the process at the hyperparameters that exact data of the same log teach; None if they are not known."""
    path = folder and folder / f"{'-'.join([subject.name, 'light', str(seed), *EXACT])}.joblib"
    if path is None or not path.exists():
        return None
    name = f"{subject.name}-light-{seed}-{'-'.join(LOADS)}-known"
    found, _ = kept(
        folder, name, partial(process, subject, seen, LOADS, seed, {}, joblib.load(path)[1])
    )
    return ("light", LOADS, "known hyperparameters"), found


# -- tables
# --------------------------------------------------------------------------------------------


class Results:
    """What was found, by air, case and method: stacked over seeds."""

    def __init__(self, subject, found):
        self.subject, self.truth = subject, subject.test.truth[::EVERY]
        self.found = {}
        for key, one in found:
            self.found.setdefault(key, []).append(one)

    def errors(self, key, seeds=None):
        """Return squared bias and variance of each coefficient, (2, 6), over the variance of the truth."""
        error = np.array([one.function for one in self.found[key][:seeds]]) - self.truth
        n, scale = len(error), self.truth.var(axis=0)
        variance = error.var(axis=0, ddof=1).mean(axis=0) if n > 1 else np.zeros(6)
        return np.array([(error.mean(axis=0) ** 2).mean(axis=0) - variance / n, variance]) / scale

    def nrmse(self, key, seeds=None):
        """Return the error of each coefficient, (6,), in root mean square over rows and seeds."""
        return np.sqrt(self.errors(key, seeds).sum(axis=0))


def function_table(results):
    """Return the error of the function by air and method, where sensors' noise is in all data."""
    rows = []
    for air in flights.AIR:
        default = (air, LOGGED, "default")
        keys = [
            key
            for key in results.found
            if key[0] == air and key[1] in ASKED
            if key[2].startswith("default") or key[1] == LOGGED
        ]
        for key in sorted(keys, key=lambda key: not key[2].startswith("default")):
            found = results.found[key]
            row = {"air": air, "method": key[2], "regressors": ASKED[key[1]]}
            error = results.nrmse(key)
            row["NRMSE"] = float(error.mean())
            row |= {f"NRMSE {name}": float(e) for name, e in zip(COEFFICIENTS, error, strict=True)}
            n = min(len(found), len(results.found.get(default, [])))  # the same seeds
            ratio = results.nrmse(key, n).mean() / results.nrmse(default, n).mean() if n else np.nan
            row |= {"over default": float(ratio) if n else None, "seeds": len(found)}
            rows.append(row)
    return rows


def air_table(results):
    """Return the error of a symmetric process that is given the rates of the air, over that of the default."""
    rows = []
    for air in flights.AIR:
        keys = (air, Case(rates="air"), method_of(SYMMETRIC)), (air, LOGGED, method_of({}))
        seeds = min(len(results.found.get(key, [])) for key in keys)
        if seeds:
            given, default = (float(results.nrmse(key, seeds).mean()) for key in keys)
            row = {"air": air, "NRMSE default": default, "NRMSE rates of the air given": given}
            rows.append(row | {"rates given over default": given / default, "seeds": seeds})
    return rows


def known_table(results):
    """Return the error of the function at the hyperparameters of exact data, beside that of the default."""
    keys = [("light", LOADS, method) for method in ("known hyperparameters", "default")]
    if not all(key in results.found for key in keys):
        return []
    seeds = min(len(results.found[key]) for key in keys)
    return [
        {f"NRMSE {key[2]}": float(results.nrmse(key, seeds).mean()) for key in keys}
        | {"seeds": seeds}
    ]


def place_of(derivative):
    """Return row and column of a derivative."""
    coefficient, _, regressor = derivative.partition("_")
    return COEFFICIENTS.index(coefficient), NAMES.index(regressor)


def derivative_table(results):
    """Return derivatives by method and air: mean over the seeds (scatter, stated deviation), beside the known ones."""
    rows = []
    for name in PRINTED:
        i, k = place_of(name)
        for label, case, method in DERIVATIVES:
            row = {"derivative": name, "known": float(results.subject.known[i, k]), "method": label}
            for air in flights.AIR:
                found = results.found.get((air, case, method), [])
                values = np.array(
                    [
                        (one.slopes[i, k], one.slopes_std[i, k])
                        for one in found
                        if not np.isnan(one.slopes[i, k])
                    ]
                )
                row[air] = _estimate(*values.T) if len(values) else None
            if any(row[air] for air in flights.AIR):
                rows.append(row)
    return rows


def _estimate(values, std):
    scatter = f"{values.std(ddof=1):.2g}" if len(values) > 1 else "-"
    return f"{values.mean():.3g} ({scatter}, {std.mean():.2g})"


def coverage_table(results):
    """Return how the errors of derivatives compare with stated deviations."""
    rows, subject = [], results.subject
    for air in flights.AIR:
        for label, case, method in DERIVATIVES:
            found = results.found.get((air, case, method))
            if found is None:
                continue
            matters = (np.abs(subject.known) > 0) & (found[0].slopes_std > 0)
            inside = np.array(
                [np.abs(one.slopes - subject.known) < 2 * one.slopes_std for one in found]
            )
            shown = [
                one[place_of(name)] for one in inside for name in SHOWN if matters[place_of(name)]
            ]
            error = np.array([one.slopes - subject.known for one in found])[:, matters]
            std = np.array([one.slopes_std for one in found])[:, matters]
            scatter, bias = (
                error.std(axis=0, ddof=min(1, len(error) - 1)),
                np.abs(error.mean(axis=0)),
            )
            stated = std.mean(axis=0)
            rows.append(
                {"air": air, "method": label}
                | {"within 2 std, %": float(100 * inside[:, matters].mean())}
                | {"of those shown, %": float(100 * np.mean(shown))}
                | {
                    "within 2 std of the posterior alone, %": _share_by_posterior(
                        found, subject.known, matters
                    )
                }
                | {
                    "scatter over stated std": float(np.median(scatter / stated))
                    if len(error) > 1
                    else None
                }
                | {"bias over stated std": float(np.median(bias / stated))}
                | {"rms error over stated std": float(np.sqrt(np.mean((error / std) ** 2)))}
                | {"derivatives": int(matters.sum()), "seeds": len(error)}
            )
    return rows


def _share_by_posterior(found, known, matters):
    if found[0].slopes_posterior is None:
        return None
    inside = [np.abs(one.slopes - known) < 2 * one.slopes_posterior for one in found]
    return float(100 * np.mean(np.array(inside)[:, matters]))


def amplitude_table(subject, seen):
    """Return Cl_p and Cl_aileron of least squares on the quiet and on the agitated rows of the logs as recorded.

    A second of flight is as agitated as the roll rate is large in it, in root mean square.
    """
    rows = []
    for air in flights.AIR:
        logs = [log for (where, _), log in seen.items() if where == air]
        for low, high in itertools.pairwise(QUANTILES):
            found, motion = [], []
            for log in logs:
                X, Y = LOGGED.table(log)
                p, size = log.log.exact[:, 2], agitation(log)
                inside = (size >= np.quantile(size, low)) & (size <= np.quantile(size, high))
                slopes = line(X[inside], Y[inside], subject, LOGGED).slopes
                found.append([slopes[place_of(name)] for name in ("Cl_p", "Cl_aileron")])
                motion.append([p[inside].std(), log.log.gust[inside, 0].std()])
            row = {"air": air, "rows, % by size of p": f"{100 * low:.0f} to {100 * high:.0f}"}
            row |= dict(
                zip(
                    ("std of p_hat", "std of p_hat of the air"),
                    map(float, np.mean(motion, axis=0).round(6)),
                    strict=True,
                )
            )
            rows.append(
                row
                | dict(zip(("Cl_p", "Cl_aileron"), map(float, np.mean(found, axis=0)), strict=True))
            )
    return rows


def study(subject, options, folder):
    """Return all results of an aircraft, and what was learned from."""
    run = joblib.Parallel(n_jobs=options.jobs)
    jobs = [(air, seed) for air in flights.AIR for seed in range(options.seeds)]
    names = [f"{subject.name}-{air}-{seed}-seen" for air, seed in jobs]
    looks = [
        partial(flights.seen, subject.logs[air][seed], subject.aircraft, seed) for air, seed in jobs
    ]
    looked = run(joblib.delayed(kept)(folder, *task) for task in zip(names, looks, strict=True))
    seen = dict(zip(jobs, looked, strict=True))
    lines = [((air, LOGGED, "least squares"), LOGGED.table(log)) for (air, _), log in seen.items()]
    found = [(key, line(*table, subject, LOGGED)) for key, table in lines]
    parts = [(DEFAULTS, options.processes), (AIRED, options.processes), (COMPARED, options.others)]
    wanted = [(*task, seed) for part, n in parts for seed in range(n) for task in part]
    unique = {(air, case, method_of(changes), seed): changes for air, case, changes, seed in wanted}
    until = time.monotonic() + 60 * options.minutes
    processes = run(
        joblib.delayed(process_task)(
            subject, seen[air, seed], air, seed, case, changes, folder, options.max_iter, until
        )
        for (air, case, _, seed), changes in unique.items()
    )
    known = [
        known_task(subject, seen["light", seed], seed, folder) for seed in range(options.others)
    ]
    return Results(
        subject, [*found, *(one for one in (*processes, *known) if one is not None)]
    ), seen


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", default="example", choices=["example", *flights.KNOTS])
    parser.add_argument(
        "--seeds", type=int, default=10, help="of gusts and sensor noise, for least squares"
    )
    parser.add_argument("--processes", type=int, default=3, help="of them, for the default")
    parser.add_argument(
        "--others", type=int, default=1, help="of them, for other dependent processes"
    )
    parser.add_argument("--duration", type=float, default=180.0, help="of each flight [s]")
    parser.add_argument(
        "--minutes",
        type=float,
        default=np.inf,
        help="after which no further fit of a process begins",
    )
    parser.add_argument(
        "--jobs", type=int, default=-1, help="processes; set OPENBLAS_NUM_THREADS=1"
    )
    options = parser.parse_args(words)
    options.max_iter = 60
    folder = options.out / "study" if options.out else None
    name = options.aircraft
    subject_of = (
        flights.example_subject if name == "example" else partial(flights.jsbsim_subject, name)
    )
    subject = kept(
        folder, f"{name}-{options.seeds}", partial(subject_of, options.seeds, options.duration)
    )
    results, seen = study(subject, options, folder)
    finish(
        options,
        "study" if name == "example" else f"study_{name}",
        function=function_table(results),
        air=air_table(results),
        known=known_table(results),
        derivatives=derivative_table(results),
        amplitudes=amplitude_table(subject, seen),
        coverage=coverage_table(results),
    )


if __name__ == "__main__":
    main()
