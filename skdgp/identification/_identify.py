"""The workflow from flights to an evaluated model.

Equations of "the paper" are those of Hemakumara & Sukkarieh (2011).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from skdgp._compute.messages import notify, recorded_findings, report
from skdgp._compute.typing import Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    COEFFICIENTS,
    HIGH_LIFT,
    RATES,
    REGRESSOR_SETS,
    SPECIFIC_FORCE,
)
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import FlightTable
from skdgp._regressor import DependentGPRegressor, FitCode, search_ended
from skdgp.dynamics import (
    QUANTITIES,
    Aircraft,
    ScaleFactor,
    check_aircraft,
)
from skdgp.identification._changed import changes_in_flights
from skdgp.identification._evaluate import THRESHOLDS, evaluate
from skdgp.identification._flights import (
    are_in_full_throws,
    named_flights,
    regressor_columns,
    thrust_of,
    train_and_test,
    usable_flights,
    usable_flights_of_model,
    with_position_of,
)
from skdgp.identification._identification import Identification
from skdgp.identification._pipeline import (
    FlightPipeline,
    make_identification_pipeline,
    reconstruction_of,
    regressor_names,
    step_of,
)
from skdgp.io import FULL_THROW
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector, RegressorSelector

# columns that the coefficients follow from
MEASURED = ("airspeed", "density", *SPECIFIC_FORCE, *RATES)
# Standard deviation [s] of a lag of surfaces that is known; lags of servos are 0.02 to 0.09 s
LARGEST_STD = 0.05
#: Units of the controls of a log without their scale
FULL_THROW_UNITS = dict.fromkeys((*ALL_SURFACES, *HIGH_LIFT), FULL_THROW)


def identify(
    flights: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    test: Any = None,
    regressors: str | Sequence[str] = "quasi-steady",
    regressor: DependentGPRegressor | None = None,
    pipeline: Mapping[str, Any] | None = None,
    samples: int | None = None,
    horizon: float = 10.0,
    reading: Mapping[str, Any] | None = None,
    thrust: str | None = "auto",
) -> Identification:
    """Learn a model of the six coefficients from flights, and judge it on others.

    Measured coefficients follow from inverse dynamics. A pipeline (`make_identification_pipeline`)
    learns them from the training flights, and predicts the test flights; predictions are scored, and
    the model is simulated. Listeners of `skdgp.listening` are called at each stage, with ``(stage, 0, nan)``:
    "reading", "transforming", "evaluating NAME"; stages with a number of steps, such as
    "reconstructing paths", have ``done`` and ``total``.

    Parameters
    ----------
    flights : DataFrame, path, dict of name to table, or list of tables and paths
        Training flights at their full rate. A column ``flight`` separates several flights in one
        table. Each has an ``airspeed``.
    aircraft : Aircraft or path
        A path ends in .json or .toml.
    test : as flights, optional
        Test flights. By default the last of several training flights, or the last quarter of a
        single one, is held out.
    regressors : str or sequence of str
        As of :func:`make_identification_pipeline`.
    regressor : DependentGPRegressor, optional
        By default ``DependentGPRegressor(random_state=0)``.
    pipeline : mapping of str to object, optional
        Other options of :func:`make_identification_pipeline`, such as ``{"lags": None}``.
    samples : int, optional
        Rows to learn from, spread over the flights. By default all, at most 30,000, or 755 by exact
        inference.
    horizon : float
        Seconds after which simulations of test flights start again from measured states.
    reading : mapping of str to object, optional
        Options of :func:`skdgp.io.read_flight`: ``rename`` for tables, the others for logs of
        autopilots; by default ``{"servos": "full throw"}`` where surfaces are regressors.
    thrust : {"auto", None}, default="auto"
        As of :func:`skdgp.dynamics.aerodynamic_coefficients`. ``thrust=None`` needs the throttle or the
        speed of the propeller among the regressors, best with the airspeed, unless the aircraft
        glides; so does "auto" by itself where the flights have a throttle and nothing gives the
        thrust.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        If a flight lacks columns or usable rows, a name occurs twice, or the thrust is not known.
    TypeError
        If ``regressor`` is not a DependentGPRegressor.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.datasets import load_example_flights
    >>> from skdgp.identification import identify
    >>> example = load_example_flights(duration=12.0)
    >>> result = identify(
    ...     example.train,
    ...     example.aircraft,
    ...     test=example.test,
    ...     samples=40,
    ...     regressor=DependentGPRegressor(structure="trend", random_state=0),
    ...     horizon=2.0,
    ... )
    >>> result.fit.samples, sorted(result.metrics["test"])
    (40, ['two_altitudes'])
    >>> mean, std = result.pipeline.predict(example.test[:400], return_std=True)
    >>> mean.shape
    (400, 6)
    """
    regressor = checked_regressor(regressor)
    names = REGRESSOR_SETS[regressors] if isinstance(regressors, str) else regressors
    with recorded_findings() as findings:
        notify("reading")
        reading = dict(reading or {})
        if reading.get("servos") is None and not {*ALL_SURFACES}.isdisjoint(names):
            reading["servos"] = FULL_THROW
        train, tests = train_and_test(flights, test, MEASURED, **reading)
        if isinstance(aircraft, str | os.PathLike):
            aircraft = Aircraft.from_file(aircraft)
        aircraft = with_position_of(check_aircraft(aircraft), train)
        units = FULL_THROW_UNITS if are_in_full_throws(train) else None
        columns = regressor_columns([flight.table for flight in train.values()], names)
        train = usable_flights(train, aircraft, names, columns, in_radians=units is None)
        tests = usable_flights(tests, aircraft, names, columns, in_radians=units is None)
        learned_from = FlightTable.together(train.values())
        thrust = thrust_of(learned_from.table, aircraft, names, thrust)
        if units is not None:
            report(Finding(Code.FULL_THROWS))
        model = make_identification_pipeline(
            aircraft,
            regressors=regressors,
            regressor=regressor,
            samples=samples,
            control_units=units,
            thrust=thrust,
            **(pipeline or {}),
        )
        # inverse dynamics, paper eqs 3 to 8; regressors (eq 22 is the set "paper"); the fit, eq 20
        notify("transforming")
        model.fit(learned_from)
        fit = fit_record(model)
        if fit.lags_corrected:
            lags = fit.lags_corrected
            is_late = "servos" in lags or lags.get("surfaces", 0.0) < 0
            report(Finding(Code.LAGS_CORRECTED, lags=lags, commands=is_late))
        for finding in _unknown_lag(model, fit):
            report(finding)
        chosen = _options(model) | {"thrust": thrust, "horizon": horizon}
        if units is not None:
            chosen["servos"] = reading.get("servos") or FULL_THROW
        evaluations = [evaluate(name, flight, model, aircraft) for name, flight in tests.items()]
    # the pipeline names constant regressors, which the last step numbers
    named = [found for found in findings if found.code is not FitCode.CONSTANT_INPUTS]
    return Identification(
        title=f"{aircraft.name}: aerodynamic coefficients",
        aircraft=aircraft,
        pipeline=model,
        options=chosen,
        fit=fit,
        train={name: flight.table for name, flight in train.items()},
        evaluations=evaluations,
        findings=(*assumed_sizes(aircraft, model.errors_), *_absent_surfaces(model), *named),
    )


def _absent_surfaces(model: FlightPipeline) -> list[Finding]:
    """Return the assumption that surfaces without a column are absent; a missing elevator is warned of."""
    selector = step_of(model, RegressorSelector)
    missing = [] if selector is None else selector.absent_
    absent = [name for name in missing if name in ("aileron", "rudder")]
    return [Finding(Code.SURFACES_ABSENT, names=absent)] if absent else []


def _unknown_lag(model: FlightPipeline, fit: Bunch) -> list[Finding]:
    """Return the finding of surfaces whose lag the flights do not show, none where a filter estimates it.

    Of flights too short for a judgement it says nothing new.
    """
    reconstruction = reconstruction_of(model)
    by_filter = reconstruction is not None and reconstruction.air_motion_ is not None
    is_estimated = fit.lags is not None and "surfaces" in fit.lags.index
    if by_filter or not is_estimated or fit.flown < THRESHOLDS.flown:
        return []
    std, applied = fit.lags.loc["surfaces", ["std", "applied"]]
    if applied or std <= LARGEST_STD:
        return []
    return [Finding(Code.LAG_UNKNOWN, std=std if np.isfinite(std) else None)]


def assumed_sizes(aircraft: Aircraft, errors: Mapping[str, ScaleFactor]) -> list[Finding]:
    """Return the findings of sizes that are uncertain, by errors of all causes together, and of their sources.

    ``errors`` are those of the aircraft's model.
    """
    findings = []
    sizes = {}
    for name, value in aircraft.sizes.items():
        std = aircraft.relative_std(name)
        if std:
            label = f"{name.replace('_', ' ')} [{QUANTITIES.get(name, 'kg m^2')}]"
            sizes[label] = value, std * value
    if sizes:
        findings.append(Finding(Code.SIZES_ESTIMATED, sizes=sizes))
    sources: dict[str, list[str]] = {}
    for name, factor in {**(aircraft.deviations or {}), **errors}.items():
        if factor.source not in ("", "given"):
            sources.setdefault(factor.source, []).append(name)
    if sources:
        texts = [f"{source} ({', '.join(names)})" for source, names in sources.items()]
        findings.append(Finding(Code.SIZES_SOURCES, sources=texts))
    return findings


def checked_regressor(regressor: DependentGPRegressor | None) -> DependentGPRegressor:
    """Return the regressor, by default one of seed 0; raise TypeError if it is of another kind."""
    if regressor is None:
        return DependentGPRegressor(random_state=0)
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__} as the regressor, but expected a "
            "DependentGPRegressor: fit other regressors with make_identification_pipeline."
        )
    return regressor


def _options(pipeline: FlightPipeline) -> dict[str, Any]:
    """Return the options of the steps of a pipeline, given or chosen."""
    reconstructs = isinstance(pipeline["flightpathreconstruction"], FlightPathReconstruction)
    return {
        **pipeline[-1].get_params(deep=False),
        "samples": pipeline.n_learned_,
        "regressors": pipeline["regressorselector"].regressors,
        "reconstruction": "auto" if reconstructs else "none",
        "lags": pipeline["lagcorrector"].lags,
    }


def validate(
    model: Bunch,
    flights: Any,
    *,
    horizon: float = 10.0,
    reading: Mapping[str, Any] | None = None,
) -> Identification:
    """Judge a model that exists on flights.

    Raises ValueError if the model is not of ``identify``, or a flight lacks a column of the model.

    Parameters
    ----------
    model : Bunch
        As of :func:`load_model`; another ``aircraft`` in it, such as with another mass, counts.
    flights : as of :func:`identify`
    horizon, reading
        As of :func:`identify`; logs are read with the model's servos by default.

    Returns
    -------
    Identification
        Without training flights; with the changes of the aircraft.
    """
    options = {**model.get("options", {}), "thrust": model.pipeline.thrust, "horizon": horizon}
    reading = dict(reading or {})
    reading["servos"] = reading.get("servos") or options.get("servos")
    aircraft = check_aircraft(model.aircraft)
    with recorded_findings() as findings:
        notify("reading")
        named = named_flights(flights, **reading)
        usable = usable_flights_of_model(model.pipeline, named, aircraft)
        fit = fit_record(model.pipeline)
        ended = search_ended(model.pipeline[-1])
        if ended is not None:
            report(ended)
        for name in usable:
            if name in model.get("flights", []):
                report(Finding(Code.ALREADY_LEARNED, flight=name))
        evaluations = [
            evaluate(name, flight, model.pipeline, aircraft) for name, flight in usable.items()
        ]
        changes = changes_in_flights(model.pipeline, evaluations, aircraft)
    return Identification(
        title=f"{aircraft.name}: a model on other flights",
        aircraft=aircraft,
        pipeline=model.pipeline,
        options=options,
        fit=fit,
        train={},
        evaluations=evaluations,
        changes=changes,
        findings=tuple(findings),
    )


def fit_record(pipeline: FlightPipeline) -> Bunch:
    """Return what a fitted pipeline shows of its fit.

    =============================== =======================================================================
    ``summary``                     duration, samples and likelihood, and whether the search converged
    ``inference``                   "exact" or "sparse"
    ``weights``                     weight of each component of an average, by coefficient
    ``regressors``                  names of the regressors of the last step
    ``log_marginal_likelihood``     at the end of the search
    ``iterations``                  of the search
    ``converged``                   whether the search converged
    ``noise_std``                   standard deviations of the noise of coefficients
    ``doubts``                      findings that exclude the judgement "yes" of any use of the model: gusts
                                    that are not known, and paths that did not converge
    ``reconstruction``              whether flight paths are reconstructed, and why; None without this step
    ``lags``                        table of `skdgp.preprocessing.LagCorrector`; None without this step
    ``lags_corrected``              lags [s] by group that the flights show, and that are removed
    ``samples``                     rows learned from
    ``seconds``, ``flown``          duration of the fit, and of the training flights without gaps [s]
    ``conditions``                  medians of the columns of the training flights
    =============================== =======================================================================
    """
    regressor = pipeline[-1]
    step = step_of(pipeline, FlightPathReconstruction)
    corrector = step_of(pipeline, LagCorrector)
    corrected = {}
    if corrector is not None:
        applied = corrector.lags_.dropna(subset="std")["applied"]
        corrected = applied[applied != 0].to_dict()
    samples = f"{pipeline.n_learned_} of {pipeline.n_observed_} samples"
    likelihood = regressor.log_marginal_likelihood_value_
    summary = f"fitted in {pipeline.fit_time_:.1f} s on {samples}, log likelihood {likelihood:.1f}"
    if not regressor.converged_:
        summary += f"; not converged after {regressor.n_iter_} iterations: raise max_iter"
    return Bunch(
        summary=summary,
        inference=regressor.inference_,
        weights={name: _by_coefficient(values) for name, values in regressor.weights_.items()},
        regressors=regressor_names(pipeline),
        log_marginal_likelihood=likelihood,
        iterations=regressor.n_iter_,
        converged=regressor.converged_,
        noise_std=_by_coefficient(regressor.noise_variance_**0.5),
        doubts=[] if step is None else step.doubts_,
        reconstruction=None if step is None else step.finding_,
        lags=None if corrector is None else corrector.lags_,
        lags_corrected=corrected,
        samples=pipeline.n_learned_,
        seconds=pipeline.fit_time_,
        flown=pipeline.seconds_,
        conditions=pipeline.conditions_,
    )


def _by_coefficient(values: Vector) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, values, strict=True))
