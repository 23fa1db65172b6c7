"""Text of an identification: lines of the command line's summary, and facts of the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.files import software_versions
from skdgp._flight.channels import COEFFICIENTS, LATERAL, LONGITUDINAL
from skdgp._flight.frames import wind_origin
from skdgp.dynamics import Aircraft
from skdgp.identification._evaluate import Evaluation, scores
from skdgp.identification._learn import thrust_sources
from skdgp.identification._pipeline import reconstruction_of
from skdgp.identification._record import FitRecord
from skdgp.identification._verdict import Verdict

GROUPS = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
MOST_WARNINGS = 3  # in the summary
MOST_AIRS = 4  # facts of the air
THRUSTS = {
    "columns": "from the thrust columns of the flights",
    "propeller": "from the propeller's bench table",
    "none": "none subtracted: an engine's is part of the coefficients",
}


def group_means(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    means = {group: table.loc[list(members)].mean() for group, members in GROUPS.items()}
    return pd.DataFrame(means).T


def sampling_of(table: pd.DataFrame) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    step = np.median(np.diff(time)) if len(time) > 1 else np.nan
    return {
        "samples": len(table),
        "duration": float(np.ptp(time)),
        "sample_rate": float(1 / step),
    }


def fit_text(fit: FitRecord) -> str:
    """Return duration, samples and likelihood of the fit, and whether it converged."""
    text = f"log likelihood {fit.log_marginal_likelihood:.1f}"
    training = fit.training
    if training is not None:
        state = "interrupted" if fit.interrupted else "fitted"
        samples = f"{training.samples} of {training.samples_available} samples"
        text = f"{state} in {training.seconds:.1f} s on {samples}, {text}"
    if not fit.converged:
        text += f"; not converged after {fit.iterations} iterations: raise max_iter"
    return text


def score_lines(tested: Sequence[Evaluation]) -> list[str]:
    """Return the scores of all test flights together, and of several the means of each."""
    title = f"{len(tested)} test flights together"
    if len(tested) == 1:
        title = f"flight {tested[0].name}"
    lines = [title, _score_text(scores(tested), [*COEFFICIENTS, *GROUPS]), ""]
    if len(tested) > 1:
        for flight in tested:
            lines += [f"flight {flight.name}", _score_text(flight.scores, ["all"]), ""]
    return lines


def _score_text(against: Mapping[str, pd.DataFrame], names: list[str]) -> str:
    """Return errors and coverage against measured; against truth, which holds gusts that no band knows, errors only."""
    measured = pd.concat([against["measured"], group_means(against["measured"])]).loc[names]
    shown = pd.DataFrame(index=names)
    shown["rel. error [%]"] = 100 * measured["median_relative_error"]
    shown["NRMSE"] = measured["normalized_rmse"]
    shown["in 95 % band [%]"] = 100 * measured["interval_coverage"]
    if "truth" in against:
        truth = pd.concat([against["truth"], group_means(against["truth"])])
        shown["rel. error of truth [%]"] = 100 * truth["median_relative_error"]
        shown["NRMSE of truth"] = truth["normalized_rmse"]
    form = {name: ("{:.3f}" if "NRMSE" in name else "{:.1f}").format for name in map(str, shown)}
    return shown.to_string(formatters=form)


def verdict_lines(verdict: Verdict) -> list[str]:
    """Return error and coverage, uses and the first warnings."""
    lines = [verdict.compared()]
    for use in verdict.uses:
        lines.append(f"{use.purpose + ':':<22}{use.judgement}, {use.reason}")
    for number, warning in enumerate(verdict.warnings[:MOST_WARNINGS], start=1):
        lines.append(f"warning {number}: {warning}")
    return lines


def assumption_lines(assumed: Iterable[str]) -> list[str]:
    """Return the assumptions as a list; nothing without assumptions."""
    lines = []
    for assumption in assumed:
        lines += wrap(assumption, 110, initial_indent="  - ", subsequent_indent="    ")
    return ["", "assumed, as nothing was told:", *lines] if lines else []


def facts_of_fit(
    aircraft: Aircraft,
    pipeline: Pipeline,
    fit: FitRecord,
    options: Mapping[str, Any],
    train: Mapping[str, pd.DataFrame],
    tested: Mapping[str, pd.DataFrame],
) -> dict[str, str]:
    """Return the facts of a fit as text; empty where a fact does not apply."""
    regressor = pipeline[-1]
    sources = thrust_sources(options["thrust"], [*train.values(), *tested.values()])
    lags = [f"{name} {lag['applied']:.3g} s" for name, lag in fit.lags.items() if lag["applied"]]
    return {
        "Aircraft": f"{aircraft.name}, {aircraft.mass:g} kg, wing area {aircraft.wing_area:.4g} m², "
        f"span {aircraft.span:.4g} m, chord {aircraft.chord:.4g} m",
        "Learned from": _durations(train),
        "Tested on": _durations(tested),
        "Regressors": ", ".join(fit.regressors),
        "Structure": f"{regressor.structure}, trend {regressor.trend or 'none'}, {fit.inference}",
        "Fit": fit_text(fit),
        "Thrust": " or ".join(THRUSTS[name] for name in sources),
        "Flight paths": "" if fit.reconstruction is None else fit.reconstruction.clause,
        "Lags": ", ".join(lags) or "none to correct",
        "Other loads": ", ".join(options["external_forces"]),
        "Versions": ", ".join(f"{name} {n}" for name, n in software_versions().items()),
    }


def _durations(flights: Mapping[str, pd.DataFrame]) -> str:
    """Return flights with their durations and rates."""
    parts = []
    for name, table in flights.items():
        sampling = sampling_of(table)
        parts.append(f"{name} ({sampling['duration']:.4g} s at {sampling['sample_rate']:.3g} Hz)")
    return ", ".join(parts)


def air_of(pipeline: Pipeline) -> str:
    """Return gusts and steady wind of the training flights, as reconstruction found them; empty where it did not."""
    step = reconstruction_of(pipeline)
    if step is None:
        return ""
    if step.air_motion_ is not None:
        return step.air_motion_.summary
    parts = [f"gusts that change by {step.gust_std_:.2g} m/s rms in 1 s"]
    winds = step.calibration_.pivot_table("estimate", "flight", "constant", sort=False)
    for name, row in winds.iterrows():
        north, east = row[["wind_north", "wind_east"]]
        origin = wind_origin(north, east)
        speed = np.hypot(north, east)
        parts.append(f"steady wind {speed:.2g} m/s from {origin:.0f} deg in flight {name!r}")
    return ", ".join(parts[:MOST_AIRS])
