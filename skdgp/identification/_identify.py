"""The workflow from flights to an evaluated model."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, cast

from sklearn.utils import Bunch

from skdgp._compute.messages import notify, recorded_findings, report
from skdgp._flight.findings import Code, Finding
from skdgp._regressor import DependentGPRegressor, FitCode
from skdgp.dynamics import Aircraft
from skdgp.identification._changed import Changes, changes_in_flights
from skdgp.identification._evaluate import evaluate
from skdgp.identification._flights import named_flights, tables_of
from skdgp.identification._identification import Identification
from skdgp.identification._learn import LearnedModel, checked_regressor, learn
from skdgp.identification._model_file import options_of
from skdgp.identification._prepare import (
    as_aircraft,
    assumptions,
    prepare,
    usable_flights_of_model,
)
from skdgp.identification._record import TrainingRecord, fit_record


def identify(
    flights: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    test: Any = None,
    regressors: str | Sequence[str] = "quasi-steady",
    regressor: DependentGPRegressor | None = None,
    pipeline: Mapping[str, Any] | None = None,
    samples: int | str | None = None,
    horizons: Sequence[float] = (2.0, 10.0),
    reading: Mapping[str, Any] | None = None,
    **loads: Any,
) -> Identification:
    """Learn a model of the six coefficients from flights, and judge it on others.

    Measured coefficients follow from inverse dynamics. A pipeline (`make_identification_pipeline`)
    learns them from the training flights, and predicts the test flights; predictions are scored and
    replayed. Listeners of `skdgp.listening` are called at each stage, with ``(stage, 0, nan)``:
    "reading", "coefficients", "transforming", "evaluating NAME"; stages with a number of steps, such as
    "reconstructing paths", have ``done`` and ``total``. Ctrl-C during the fit keeps the
    best model so far.

    Parameters
    ----------
    flights : DataFrame, path, dict of name to table, or list of tables and paths
        Training flights at their full rate. A column ``flight`` separates several flights in one
        table. Each has an ``airspeed``.
    aircraft : Aircraft or path
        A path ends in .json or .toml.
    test : as flights, optional
        Test flights. By default the last training flight is held out, or its last quarter if it
        has more than half of all rows.
    regressors : str or sequence of str
        As of :func:`make_identification_pipeline`.
    regressor : DependentGPRegressor, optional
        By default ``DependentGPRegressor(random_state=0)``.
    pipeline : mapping of str to object, optional
        Other options of :func:`make_identification_pipeline`, such as ``{"lags": None}``.
    samples : int, "all" or None
        Rows to learn from, spread over the flights. None: all, at most 30,000, or 755 by exact
        inference.
    horizons : sequence of float
        Seconds from restart to restart: the shortest of the replay, the longest of the simulation.
    reading : mapping of str to object, optional
        Options of :func:`skdgp.io.read_flight`: ``rename`` for tables, the others for logs of
        autopilots; by default ``{"servos": "full throw"}``.
    **loads
        ``thrust`` ("auto") and ``external_forces`` (none), as of
        :func:`skdgp.dynamics.aerodynamic_coefficients`. ``thrust=None`` needs the throttle or the
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
    >>> example = load_example_flights(duration=20.0)
    >>> result = identify(
    ...     example.train,
    ...     example.aircraft,
    ...     test=example.test,
    ...     samples=40,
    ...     regressor=DependentGPRegressor(structure="trend", random_state=0),
    ...     horizons=[2.0],
    ... )
    >>> result.fit.training.samples, sorted(result.metrics["test"])
    (40, ['two_altitudes'])
    >>> mean, std = result.pipeline.predict(example.test[:400], return_std=True)
    >>> mean.shape
    (400, 6)
    """
    regressor = checked_regressor(regressor)
    with recorded_findings() as findings:
        notify("reading")
        prepared = prepare(
            flights, test, aircraft, regressors=regressors, reading=reading or {}, **loads
        )
        model = learn(
            prepared,
            regressors=regressors,
            regressor=regressor,
            steps=pipeline or {},
            samples=samples,
            horizons=horizons,
        )
        evaluations = [evaluate(name, flight, model) for name, flight in prepared.test.items()]
    return Identification(
        title=f"{model.aircraft.name}: aerodynamic coefficients",
        aircraft=model.aircraft,
        pipeline=model.pipeline,
        options=model.options,
        fit=model.fit,
        train={
            name: model.pipeline.corrected(table)
            for name, table in tables_of(prepared.train).items()
        },
        evaluations=evaluations,
        findings=_named_once(findings),
        assumptions=assumptions(model.aircraft, model.pipeline.errors_, findings),
    )


def validate(
    model: Bunch,
    flights: Any,
    *,
    aircraft: Aircraft | str | os.PathLike | None = None,
    horizons: Sequence[float] = (2.0, 10.0),
    reading: Mapping[str, Any] | None = None,
    **loads: Any,
) -> Identification:
    """Judge a model that exists on flights.

    Raises ValueError if the model is not of ``identify``, or a flight lacks a column of the model.

    Parameters
    ----------
    model : Bunch
        As of :func:`load_model`.
    flights : as of :func:`identify`
    aircraft : Aircraft or path, optional
        In place of the model's, such as with another mass.
    horizons, reading
        As of :func:`identify`; logs are read with the model's servos by default.
    **loads
        ``thrust`` and ``external_forces``, where they differ from the model's fit.

    Returns
    -------
    Identification
        Without training flights; with the changes of the aircraft, see `changes_of`.
    """
    options = options_of(model) | loads
    options["horizons"] = list(horizons)
    reading = dict(reading or {})
    reading["servos"] = reading.get("servos") or options.get("servos")
    with recorded_findings() as findings:
        notify("reading")
        aircraft = as_aircraft(model.aircraft if aircraft is None else aircraft)
        named = named_flights(flights, **reading)
        usable = usable_flights_of_model(model.pipeline, named, aircraft)
        for name in usable:
            if name in model.get("flights", []):
                report(Finding(Code.ALREADY_LEARNED, flight=name))
        training = TrainingRecord.from_dict(model.get("fit", {}))
        learned = LearnedModel(
            pipeline=model.pipeline,
            aircraft=aircraft,
            fit=fit_record(model.pipeline, training),
            options=options,
        )
        evaluations = [evaluate(name, flight, learned) for name, flight in usable.items()]
        changes = changes_in_flights(model.pipeline, evaluations, aircraft, options)
    return Identification(
        title=f"{learned.aircraft.name}: a model on other flights",
        aircraft=learned.aircraft,
        pipeline=learned.pipeline,
        options=options,
        fit=learned.fit,
        train={},
        evaluations=evaluations,
        changes=changes,
        findings=_named_once(findings),
    )


def _named_once(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings without the numbers of constant regressors, which the pipeline names."""
    return tuple(found for found in findings if found.code is not FitCode.CONSTANT_INPUTS)


def changed(model: Bunch, flights: Any) -> Changes:
    """Return whether the aircraft of a model has changed in flights that the model did not learn from.

    The changes of `validate`, by `changes_of`; parameters and errors as there.
    """
    return cast("Changes", validate(model, flights).changes)
