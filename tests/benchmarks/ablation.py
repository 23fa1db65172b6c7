"""What each mechanism buys: the model without it, one at a time, on aircraft of known aerodynamics.

    python tests/benchmarks/ablation.py --out OUT [--cases DHC6 A4]

Each aircraft of JSBSim flies 200 s in light gusts and learns from it by the default pipeline.
Variants of the fit are fitted; sources of error and weights are taken out of the fitted models
without another fit. Prepared flights are kept in OUT/prepared. The function is asked
at regressors without noise along another path, in calm air and in gusts, and scored by the truth;
logged rows are scored by their measured coefficients, with the noise of the fit and of the gusts of
the flight.

Errors are NRMSE, the mean over the coefficients. In the table they are over the error of
the whole model, geometric means over aircraft, with the standard error of the mean. Coverage is the change
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
from flight_columns import COEFFICIENTS
from joblib import Memory
from jsbsim_flight import (
    FLOWN,
    KNOTS,
    STEADY,
    TRAINING,
    evaluated_derivatives,
    exact_regressors,
    flight_of,
    learned_derivatives,
    sensed,
    true_values,
)

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp._flight.clock import Clock
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import flight_regressors
from skdgp.identification._instruments import by_instruments
from skdgp.inference import Posterior
from skdgp.metrics import (
    interval_coverage,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.model_selection import thin_targets

EVERY = 10  # rows of a flight per row that is scored
FIRST = ["Camel", "F4N", "OV10", "MD11"]
WHOLE = "as it is"
WITHOUT_INSTRUMENTS = "without instruments"
# Rows a second that are learned from, None: all; parameters of the regressor
FITS = {
    WHOLE: (None, {}),
    "ten rows a second": (10.0, {}),
    "without noise of regressors": (None, {"input_noise": None}),
    WITHOUT_INSTRUMENTS: (None, {}),
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
    asked: dict
    derivatives: dict  #: Aircraft, place, airspeed and known derivatives
    errors: object  #: Of the function, which the samples do not show


def prepared(name, _commit):
    """Return the flights of an aircraft, prepared for the fit of its last step."""
    train, aircraft = flight_of(name, *TRAINING)
    flown = {air: flight_of(name, *flight)[0] for air, flight in FLOWN.items()}
    log = sensed(train)
    Y = aerodynamic_coefficients(log, aircraft)
    pipeline = make_identification_pipeline(
        aircraft, regressor=DependentGPRegressor(structure="trend")
    )
    pipeline.fit(log, Y)
    clock = {"time": log["time"].to_numpy(float), "flight": log["flight"].to_numpy(str)}
    asked = {air: rows_of(pipeline, flight, aircraft) for air, flight in flown.items()}
    X = np.asarray(pipeline[:-1].transform(log))
    derivatives = derivatives_of(name, aircraft, flown["calm"])
    return Prepared(pipeline, X, Y, clock, asked, derivatives, pipeline.log_errors_)


def rows_of(pipeline, flight, aircraft):
    """Return the rows of a flight that are scored."""
    some = slice(None, None, EVERY)
    log = sensed(flight)
    X, ratio, *_ = flight_regressors(pipeline, log)
    measured = aerodynamic_coefficients(pipeline[:1].transform(log), aircraft).to_numpy()
    names = [name + "_hat" * (name in "pqr") for name in STEADY]
    values = exact_regressors(flight, aircraft)[some, : len(STEADY)]
    exact = np.asarray(pipeline[-3:-1].transform(pd.DataFrame(values, columns=names)))
    truth = flight[[f"{C}_true" for C in COEFFICIENTS]].to_numpy()[some]
    return Asked(np.asarray(X)[some], ratio[some], measured[some], exact, truth)


def derivatives_of(name, aircraft, flight):
    """Return the known derivatives at the mean of a flight."""
    at, known = evaluated_derivatives(name, flight, aircraft)
    airspeed = flight["airspeed_true"].mean()
    return {"aircraft": aircraft, "at": at, "airspeed": airspeed, "known": known}


# -- models


def fitted(flights, label):
    """Return the regressor of a variant."""
    rate, options = FITS[label]
    Y = flights.Y
    if rate is not None:
        Y = thin_targets(Y, int(np.ceil(rate * np.ptp(flights.clock["time"]))))
    X = pd.DataFrame(flights.X, columns=flights.pipeline["regressorselector"].regressors_)

    def slopes(predict):
        return by_instruments(X, Y, predict(flights.X), Clock.of(*flights.clock.values()))

    model = DependentGPRegressor(random_state=0, **options)
    slopes = None if label == WITHOUT_INSTRUMENTS else slopes
    return model.fit(flights.X, Y, **flights.clock, slopes=slopes, errors=flights.errors)


def with_posterior(model, posterior):
    """Return a copy of the model with this posterior."""
    model = copy.copy(model)
    model.posterior_ = posterior
    return model


def without_errors(model):
    """Yield the name of each source of error, and the model without it."""
    posterior = model.posterior_
    d = model.n_features_in_
    n_slopes = model.slopes_.errors.shape[-1]
    sources = {
        "attenuation": slice(0, d),
        "errors of slopes": slice(d, d + n_slopes),
        "errors of the log": slice(d + n_slopes, None),
        "errors of the function": slice(None),
    }
    for source, place in sources.items():
        weights = posterior.errors.weights.copy()
        weights[place] = 0.0
        others = posterior.with_errors(posterior.errors._replace(weights=weights))
        yield f"without {source}", with_posterior(model, others)


def with_weights(model):
    """Yield the model with equal weights (K, P) of its components, and with each component alone."""
    posterior = model.posterior_
    K = len(posterior.members)
    mixtures = {"equal weights": np.full(K, 1.0 / K)}
    mixtures |= {f"{name} alone": row for name, row in zip(model.weights_, np.eye(K), strict=True)}
    for name, weights in mixtures.items():
        mixture = np.outer(weights, np.ones(len(model.scale_)))
        yield name, with_posterior(model, Posterior(posterior.members, mixture, posterior.errors))


# -- scores


def scores_of(truth, mean, std):
    """Return error, NLPD over the deviations of the outputs [nats], and what the bands hold [%]."""
    rows = np.isfinite(truth).all(axis=1)
    unit = truth[rows].std(axis=0)
    moments = [values[rows] / unit for values in (truth, mean, std)]
    return {
        "error": normalized_rmse(*moments[:2]),
        "NLPD": negative_log_predictive_density(*moments),
        "95 %": 100 * interval_coverage(*moments),
        "50 %": 100 * interval_coverage(*moments, level=0.5),
    }


def scored(model, flights):
    """Return the scores of a model: the function in calm air and in gusts, logged rows, and derivatives."""
    function = {}
    logged = []
    for air, rows in flights.asked.items():
        bands = model.predict(rows.exact, return_std=True, include_input_noise=False)
        function[air] = scores_of(rows.truth, *bands)
        noise = {"include_noise": True, "include_input_noise": rows.ratio}
        bands = model.predict(rows.X, return_std=True, **noise)
        logged.append(scores_of(rows.measured, *bands)["error"])
    calm = function.pop("calm")
    gusts = pd.DataFrame(function).mean(axis=1)
    pipeline = copy.copy(flights.pipeline)
    pipeline.steps = [*pipeline.steps[:-1], ("dependentgpregressor", model)]
    return {
        "function, calm": calm["error"],
        "function, gusts": gusts["error"],
        "logged": np.mean(logged),
        "NLPD, gusts": gusts["NLPD"],
        "95 %, calm": calm["95 %"],
        "95 %, gusts": gusts["95 %"],
        "50 %, calm": calm["50 %"],
        "derivatives": of_derivatives(pipeline, **flights.derivatives),
    }


def of_derivatives(pipeline, aircraft, at, airspeed, known):
    """Return the percentage of derivatives within two standard deviations."""
    table = learned_derivatives(pipeline[-3:], aircraft, at, airspeed, STEADY[:8])
    true = true_values(table, known)
    is_inside = np.abs(table["value"] - true) < 2 * table["std"]
    return 100 * is_inside[np.abs(true) > 0].mean()


def measured(name, label, cache):
    """Return the scores of a fit, and of what is taken out of it."""
    flights = cache(name, commit())
    start = time.process_time()
    model = fitted(flights, label)
    seconds = time.process_time() - start
    scores = {label: scored(model, flights) | {"CPU": seconds}}
    if label == WHOLE:
        for part, other in [*without_errors(model), *with_weights(model)]:
            scores[part] = scored(other, flights)
    return {"scores": scores}


def of_effects(runs):
    """Return what changes without each mechanism, with the standard error of its mean."""
    rows = [
        {"case": run["case"], "variant": variant} | scores
        for run in runs
        for variant, scores in run.get("scores", {}).items()
    ]
    table = pd.DataFrame(rows).set_index(["variant", "case"])
    whole = table.loc[WHOLE]
    effects = []
    for variant, part in table.drop(WHOLE, level="variant").groupby("variant", sort=False):
        part = part.droplevel("variant")
        effect = {"variant": variant, "fits": len(part)}
        for column in ("function, calm", "function, gusts", "logged"):
            ratio = np.log(part[column] / whole[column]).dropna()
            effect[column] = spread(np.exp(ratio.mean()), ratio)
        change = (part - whole).dropna(how="all")
        effect["NLPD, gusts"] = spread(change["NLPD, gusts"].mean(), change["NLPD, gusts"])
        for column in ("95 %, calm", "95 %, gusts", "50 %, calm", "derivatives"):
            effect[column] = f"{change[column].mean():+.1f}"
        effect["CPU"] = (part["CPU"] / whole["CPU"]).mean()
        effects.append(effect)
    return effects


def spread(mean, values):
    """Return a mean with the standard error of its values, as a cell."""
    return f"{mean:.3f} ± {values.std() / np.sqrt(max(len(values), 1)):.3f}"


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--cases", nargs="+", default=FIRST, choices=KNOTS)
    options = parser.parse_args(words)
    kept = Kept(options, "ablation")
    cache = Memory(options.out / "prepared", verbose=0).cache(prepared)
    for name in options.cases:
        for label in FITS:
            kept.run({"case": name, "variant": label}, measured, name, label, cache)
    finish(options, "ablation", effects=of_effects(kept.asked.values()))


if __name__ == "__main__":
    main()
