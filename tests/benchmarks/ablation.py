"""What each mechanism buys: the model without it, one at a time, on aircraft of known aerodynamics.

    python tests/benchmarks/ablation.py ../shared/data --out OUT [--cases DHC6 A4] [--airs light]

Each aircraft of JSBSim flies 200 s in an air, viggen_uav as recorded, and learns from it by the
default pipeline. Variants of the fit are fitted; sources of error and weights are taken out of the
fitted models without another fit. Prepared flights are kept in OUT/prepared. The function is asked
at regressors without noise along another path, in calm air and in gusts, and scored by the truth;
logged rows are scored by their measured coefficients, with the noise of the fit and of the gusts of
the flight. Derivatives are those of JSBSim's aircraft alone.

Errors are NRMSE, the mean over the coefficients. In the table of effects they are over the error of
the whole model, geometric means over aircraft and airs, with the standard error of the mean. Coverage is the change
of the percentage in the bands, NLPD the change of the negative log density [nats], over standard
deviations of the coefficients. Less error and less NLPD are better: a mechanism whose removal does
not raise any of them beyond its standard error buys nothing here.
"""

import copy
import time
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import Kept, commit, finish, parser_of
from _inputs import task_of
from joblib import Memory
from jsbsim_flight import (
    COEFFICIENTS,
    FLOWN,
    KNOTS,
    STEADY,
    evaluated_derivatives,
    exact_regressors,
    flight_of,
    learned_derivatives,
    sensed,
    true_values,
)

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import flight_regressors
from skdgp.inference import Posterior
from skdgp.metrics import (
    interval_coverage,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.model_selection import thin_targets

EVERY = 10  # rows of a flight per row that is scored
# Calibrated airspeed [kt] of aircraft that no other table has, and that feel the rates of the air
LEFT_OUT = {"Camel": 85.0, "F4N": 320.0, "OV10": 150.0, "787-8": 250.0}
LEFT_OUT |= {"Boeing314": 130.0, "MD11": 280.0}
KNOTS |= LEFT_OUT
RECORDED = "viggen_uav"
FIRST = ["Camel", "F4N", "OV10", RECORDED]
TRAINED = {"calm": (1, "calm", 0), "light": (1, "light", 1), "moderate": (1, "moderate", 2)}

WHOLE = "as it is"
# Rows a second that are learned from, None: all; parameters of the regressor
FITS = {
    WHOLE: (None, {}),
    "ten rows a second": (10.0, {}),
    "without noise of regressors": (None, {"input_noise": None}),
}


# -- flights


class Asked(NamedTuple):
    """Rows of a flight: scaled regressors and measured coefficients, exact regressors and the truth."""

    X: np.ndarray
    ratio: np.ndarray  #: Of the noise of the regressors to the one in training
    measured: np.ndarray
    exact: np.ndarray
    truth: np.ndarray


class Prepared(NamedTuple):
    """A training flight behind all steps but the last, and the flights that a model is asked about."""

    pipeline: object
    X: np.ndarray
    Y: pd.DataFrame
    clock: dict
    seconds: float
    asked: dict
    derivatives: dict | None  #: Aircraft, place, airspeed and known derivatives
    errors: object  #: Of the function, which the samples do not show


def flights_of(name, air, data):
    """Return the aircraft, the training flight, those that are asked about, and loads of the inverse dynamics."""
    if name == RECORDED:
        task = task_of("viggen", data)
        return task.aircraft, task.train, {"flown": task.test}, task.loads
    train, aircraft = flight_of(name, *TRAINED[air])
    return aircraft, train, {air: flight_of(name, *flown)[0] for air, flown in FLOWN.items()}, {}


def prepared(name, air, data, _commit):
    """Return the flights of an aircraft, prepared for the fit of its last step."""
    aircraft, train, flown, loads = flights_of(name, air, data)
    log = sensed(train)
    Y = aerodynamic_coefficients(log, aircraft, **loads)
    pipeline = make_identification_pipeline(
        aircraft, regressor=DependentGPRegressor(structure="trend")
    )
    pipeline.fit(log, Y)
    clock = {"time": log["time"].to_numpy(float)}
    if "flight" in log:
        clock["flight"] = np.asarray(log["flight"].astype(str))
    asked = {}
    for where, flight in flown.items():
        asked[where] = rows_of(pipeline, flight, aircraft, loads)
    derivatives = None if name == RECORDED else derivatives_of(name, aircraft, flown)
    X = np.asarray(pipeline[:-1].transform(log))
    learned = pipeline[-1].function_errors()  # by learned noise of each regressor first
    errors = learned._replace(weights=learned.weights[X.shape[1] :])
    return Prepared(pipeline, X, Y, clock, pipeline.seconds_, asked, derivatives, errors)


def rows_of(pipeline, flight, aircraft, loads):
    """Return the rows of a flight that are scored."""
    some = slice(None, None, EVERY)
    log = sensed(flight)
    X, ratio, _ = flight_regressors(pipeline, log)
    measured = aerodynamic_coefficients(pipeline[:1].transform(log), aircraft, **loads).to_numpy()
    names = [name + "_hat" * (name in "pqr") for name in STEADY]
    values = exact_regressors(flight, aircraft)[some, : len(STEADY)]
    exact = np.asarray(pipeline[-3:-1].transform(pd.DataFrame(values, columns=names)))
    truth = flight[[f"{C}_true" for C in COEFFICIENTS]].to_numpy()[some]
    return Asked(np.asarray(X)[some], ratio[some], measured[some], exact, truth)


def derivatives_of(name, aircraft, flown):
    """Return the known derivatives at the mean of the first flight."""
    flight = next(iter(flown.values()))
    at = exact_regressors(flight, aircraft).mean(axis=0)
    known = evaluated_derivatives(name, flight, aircraft, at)
    airspeed = flight["airspeed_true"].mean()
    return {"aircraft": aircraft, "at": at, "airspeed": airspeed, "known": known}


# -- models


def fitted(flights, rate, options):
    """Return the regressor of a variant."""
    Y = flights.Y
    if rate is not None:
        Y = thin_targets(Y, min(len(Y), int(np.ceil(rate * flights.seconds))))
    model = DependentGPRegressor(random_state=0, **options)
    return model.fit(flights.X, Y, **flights.clock, errors=flights.errors)


def with_mixture(model, mixture):
    """Return a model with other weights (K, P) of its components."""
    posterior = model.posterior_
    return with_posterior(model, Posterior(posterior.members, mixture, posterior.errors))


def with_posterior(model, posterior):
    """Return a copy of the model with this posterior."""
    model = copy.copy(model)
    model.posterior_ = posterior
    return model


def without_errors(model):
    """Yield the name of each source of error, and the model without it."""
    posterior = model.posterior_
    d = model.n_features_in_
    sources = {
        "attenuation": slice(0, d),
        "rates of the air": slice(d, 3 * d),
        "errors of the log": slice(3 * d, None),
        "errors of the function": slice(None),
    }
    for source, place in sources.items():
        weights = posterior.errors.weights.copy()
        weights[place] = 0.0
        others = posterior.with_errors(posterior.errors._replace(weights=weights))
        yield f"without {source}", with_posterior(model, others)


def with_weights(model):
    """Yield the model with equal weights, and with each component alone."""
    members = model.posterior_.members
    K, P = len(members), len(model.scale_)
    if K > 1:
        yield "equal weights", with_mixture(model, np.full((K, P), 1.0 / K))
    for name, k in zip(model.weights_, range(K), strict=False):
        if K > 1:
            alone = np.zeros((K, P))
            alone[k] = 1.0
            yield f"{name} alone", with_mixture(model, alone)


# -- scores


def scores_of(truth, mean, std):
    """Return error, NLPD over the deviations of the outputs [nats], and what the bands hold [%]."""
    rows = np.isfinite(truth).all(axis=1)
    unit = truth[rows].std(axis=0)
    moments = [values[rows] / unit for values in (truth, mean, std)]
    held = 100 * interval_coverage(*moments, multioutput="raw_values")
    return {
        "NRMSE": float(normalized_rmse(*moments[:2])),
        "NLPD": float(negative_log_predictive_density(*moments)),
        "95 %": float(held.mean()),
        "by output, 95 %": held.tolist(),
        "50 %": 100 * float(interval_coverage(*moments, level=0.5)),
    }


def scored(model, flights):
    """Return the scores of a model by place: function and logged rows of each flight, and derivatives."""
    scores = {}
    for where, rows in flights.asked.items():
        bands = model.predict(rows.exact, return_std=True, include_input_noise=False)
        scores[f"function, {where}"] = scores_of(rows.truth, *bands)
        noise = {"include_noise": True, "include_input_noise": rows.ratio}
        bands = model.predict(rows.X, return_std=True, **noise)
        scores[f"logged, {where}"] = scores_of(rows.measured, *bands)
    if flights.derivatives is not None:
        pipeline = copy.copy(flights.pipeline)
        pipeline.steps = [*pipeline.steps[:-1], ("dependentgpregressor", model)]
        scores["derivatives"] = of_derivatives(pipeline, **flights.derivatives)
    return scores


def of_derivatives(pipeline, aircraft, at, airspeed, known):
    """Return how far derivatives are off, and the percentage within two standard deviations."""
    table = learned_derivatives(pipeline[-3:], aircraft, at, airspeed, STEADY[:8])
    true = true_values(table, known)
    z = ((table["value"] - true) / table["std"])[np.abs(true) > 0]
    return {"95 %": 100 * float((np.abs(z) < 2).mean()), "largest z": float(np.abs(z).max())}


def measured(name, air, label, data, cache):
    """Return the scores of a fit, and of what is taken out of it."""
    flights = cache(name, air, data, commit())
    start = time.process_time()
    model = fitted(flights, *FITS[label])
    seconds = time.process_time() - start
    scores = {"": scored(model, flights)}
    if label == WHOLE:
        for part, other in [*without_errors(model), *with_weights(model)]:
            scores[part] = scored(other, flights)
    weights = {component: values.tolist() for component, values in model.weights_.items()}
    return {"scores": scores, "weights": weights, "CPU": seconds}


# -- tables

RATIOS = {
    "function, calm": "function, calm",
    "function, gusts": "function, light|function, moderate|function, flown",
    "logged": "logged",
}
# Columns of the table of effects: coverage
COVERAGE = {
    "95 %, calm": "function, calm; 95 %",
    "95 %, gusts": "function, gusts; 95 %",
    "50 %, calm": "function, calm; 50 %",
    "derivatives": "derivatives; 95 %",
}


def flat(runs):
    """Return a row for each aircraft, air and variant, with the means of its scores."""
    rows = []
    for run in runs:
        if "scores" not in run:
            continue
        for part, scores in run["scores"].items():
            row = {key: run[key] for key in ("case", "air")}
            row |= {"variant": part or run["variant"], "CPU": np.nan if part else run["CPU"]}
            for column, places in RATIOS.items():
                some = [
                    s for w, s in scores.items() if any(w.startswith(p) for p in places.split("|"))
                ]
                for kind in ("NRMSE", "NLPD", "95 %", "50 %"):
                    row[f"{column}; {kind}"] = np.mean([s[kind] for s in some]) if some else np.nan
            cells = [s["by output, 95 %"] for w, s in scores.items() if w.startswith("function")]
            row["worst cell"] = np.min(cells) if cells else np.nan
            known = scores.get("derivatives", {"95 %": np.nan, "largest z": np.nan})
            row |= {"derivatives; 95 %": known["95 %"], "largest z": known["largest z"]}
            rows.append(row)
    return pd.DataFrame(rows)


def of_models(table):
    """Return the scores of the whole model for each aircraft and air."""
    return table[table["variant"] == WHOLE].drop(columns="variant").to_dict("records")


def of_effects(table):
    """Return what changes without each mechanism, with the standard error of its mean."""
    key = ["case", "air"]
    whole = table[table["variant"] == WHOLE].set_index(key)
    rows = []
    for variant, part in table.groupby("variant", sort=False):
        if variant == WHOLE:
            continue
        part = part.set_index(key)
        base = whole.loc[part.index]
        row = {"variant": variant, "fits": len(part)}
        for column in RATIOS:
            ratio = np.log(part[f"{column}; NRMSE"] / base[f"{column}; NRMSE"]).dropna()
            row[column] = spread(np.exp(ratio.mean()), ratio)
        likelihood = "function, gusts; NLPD"
        change = (part[likelihood] - base[likelihood]).dropna()
        row["NLPD, gusts"] = spread(change.mean(), change)
        for shown, column in COVERAGE.items():
            row[shown] = f"{(part[column] - base[column]).mean():+.1f}"
        row["CPU"] = (part["CPU"] / base["CPU"]).mean()
        rows.append(row)
    return rows


def spread(mean, values):
    """Return a mean with the standard error of its values, as a cell."""
    return f"{mean:.3f} ± {values.std() / np.sqrt(max(len(values), 1)):.3f}"


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--cases", nargs="+", default=FIRST, choices=[*KNOTS, RECORDED])
    parser.add_argument("--airs", nargs="+", default=["light"], choices=[*TRAINED])
    options = parser.parse_args(words)
    kept = Kept(options, "ablation")
    cache = Memory(options.out / "prepared", verbose=0).cache(prepared)
    for name in options.cases:
        for air in options.airs if name in KNOTS else ["flown"]:
            for label in FITS:
                key = {"case": name, "air": air, "variant": label}
                kept.run(key, measured, name, air, label, options.data, cache)
    table = flat(kept.asked.values())
    finish(options, "ablation", models=of_models(table), effects=of_effects(table))


if __name__ == "__main__":
    main()
