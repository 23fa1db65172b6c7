"""The workflow from flights to an evaluated model."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from sklearn.utils import Bunch

from skdgp._compute.messages import recorded_warnings, warn
from skdgp._compute.progress import notify
from skdgp._flight.channels import ELEVONS, MIXED
from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, check_aircraft
from skdgp.identification import _assumed, _evaluation, _flights
from skdgp.identification._identification import Identification
from skdgp.identification._pipeline import make_identification_pipeline
from skdgp.io import reversed_of
from skdgp.model_selection import thin_targets

EXACT_SAMPLES = 755  # rows that exact inference learns from in a minute


def identify(
    flights: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    test: Any = None,
    regressors: str | Sequence[str] = "quasi-steady",
    regressor: DependentGPRegressor | None = None,
    pipeline: Mapping[str, Any] | None = None,
    samples: int | str | None = None,
    thrust: str | None = "auto",
    external_forces: Sequence[str] = (),
    horizons: Sequence[float] = (2.0, 10.0),
    reading: Mapping[str, Any] | None = None,
) -> Identification:
    """Learn a model of the six coefficients from flights, and judge it on others.

    Measured coefficients follow from inverse dynamics. A pipeline (`make_identification_pipeline`)
    learns them from the training flights, and predicts the test flights; predictions are scored and
    replayed. Listeners of `skdgp.listening` are called at each stage, with ``(stage, 0, nan)``:
    "reading", "coefficients", "transforming", "evaluating NAME". Ctrl-C during the fit keeps the
    best model so far.

    Parameters
    ----------
    flights : DataFrame, path, dict of name to table, or list of tables and paths
        Training flights at their full rate. A column ``flight`` separates several flights in one
        table. Those without an airspeed get that of their turns
        (:func:`skdgp.preprocessing.airspeed_from_turns`).
    aircraft : Aircraft or path
        A path ends in .json or .toml.
    test : as flights, optional
        Test flights. By default the last training flight is held out, or the last quarter of a
        single one.
    regressors : str or sequence of str
        As of :func:`make_identification_pipeline`.
    regressor : DependentGPRegressor, optional
        By default ``DependentGPRegressor(random_state=0)``.
    pipeline : mapping of str to object, optional
        Other options of :func:`make_identification_pipeline`, such as ``{"lags": None}``.
    samples : int, "all" or None
        Rows to learn from, spread over the flights. None: all, or 755 by exact inference.
    thrust, external_forces
        As of :func:`skdgp.dynamics.aerodynamic_coefficients`. ``thrust=None`` needs the throttle or
        the speed of the propeller among the regressors, best with the airspeed, unless the aircraft
        glides; so does "auto" by itself where the flights have a throttle and nothing gives the
        thrust.
    horizons : sequence of float
        Seconds from restart to restart of the replay.
    reading : mapping of str to object, optional
        Options of :func:`skdgp.io.read_flight`: ``rename`` for tables, the others for logs of
        autopilots; by default ``{"servos": "full throw"}``.

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
    >>> example = load_example_flights()
    >>> result = identify(
    ...     example.train[example.train["time"] < 20],
    ...     example.aircraft,
    ...     test=example.test[example.test["time"] < 10],
    ...     samples=40,
    ...     regressor=DependentGPRegressor(structure="joint", n_latent=1, max_iter=10, random_state=0),
    ...     horizons=[2.0],
    ... )
    >>> result.fit["samples"], sorted(result.metrics["test"])
    (40, ['two_altitudes'])
    >>> mean, std = result.pipeline.predict(example.test[:400], return_std=True)
    >>> mean.shape
    (400, 6)
    """
    if regressor is None:
        regressor = DependentGPRegressor(random_state=0)
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__} as the regressor, but expected a "
            f"DependentGPRegressor: fit other "
            "regressors with make_identification_pipeline."
        )
    steps, reading = dict(pipeline or {}), dict(reading or {})
    with recorded_warnings() as messages:
        notify(
            "reading"
        )  # 1: flights to learn from and to test on, and what of the aircraft they leave uncertain
        aircraft = _aircraft(aircraft)
        servos = _assumed.servos_for(reading.get("servos"), flights, test)
        aircraft = _assumed.with_throw_errors(aircraft, servos)
        reading |= {"servos": servos, "needed": _flights.MEASURED}
        train = _flights.named_flights(flights, **reading)
        _flights.check_controls(train, regressors)
        aircraft = _assumed.with_airspeed_errors(aircraft, train.values())
        test = (
            {} if test is None else _flights.named_flights(test, default="test flight", **reading)
        )
        train, test, held_out = _flights.train_and_test(train, test)
        servos, train, test = _assumed.with_signs_of_flights(servos, train, test)
        columns = _flights.regressor_columns(train.values(), regressors)
        train, test = (_flights.usable_flights(part, regressors, columns) for part in (train, test))
        _flights.warn_of_short_flights(train, regressors)
        thrust_unknown = _assumed.lacks_thrust(thrust, train.values(), aircraft)
        if thrust_unknown:
            _warn(_assumed.THRUST_IN_COEFFICIENTS)
        loads: dict[str, Any] = {
            "thrust": None if thrust_unknown else thrust,
            "external_forces": list(external_forces),
        }
        if loads["thrust"] is None:
            _flights.warn_of_engine(train, regressors)
        if reversed_of(servos) is not None:
            _warn(_assumed.FULL_THROWS)
            messages.ignore(UserWarning, "Got surfaces up to")
        # The steps of the pipeline meet the same faults again.
        messages.ignore(FlightDataWarning, WARNING_START)

        notify("coefficients")  # 2: inverse dynamics, paper eqs 3 to 8
        table = pd.concat(train.values(), ignore_index=True)
        Y = aerodynamic_coefficients(table, aircraft, **loads)
        _flights.check_known(Y, table)
        n_samples: Any = (
            EXACT_SAMPLES if samples is None and regressor.inference == "exact" else samples
        )
        targets = thin_targets(Y, len(Y) if n_samples in (None, "all") else n_samples)

        notify("transforming")  # 3: regressors, paper eq 22, and the fit to them, eq 20
        has_controls = {*ELEVONS} & {*table} or {*MIXED} <= {*table}
        steps = {"mixer": None if has_controls else "passthrough"} | steps
        model = make_identification_pipeline(
            aircraft, regressors=regressors, regressor=regressor, **steps
        )
        if thrust_unknown and isinstance(
            regressors, str
        ):  # a named set, which has the throttle already
            model.set_params(regressorselector__extra=["airspeed"])
        model.control_units_ = _assumed.control_units(servos)
        began = time.monotonic()
        X = model.fit_regressors(table, targets)
        seconds = time.monotonic() - began
        if lags := _evaluation.lags_message(model):
            _warn(lags)
        aircraft = _assumed.with_vane_errors(aircraft, model)
        sources = _evaluation.thrust_sources(loads["thrust"], train.values())
        if "propeller" in sources:
            aircraft = _assumed.with_thrust_errors(
                aircraft, table, _evaluation.named(model, X), loads["thrust"]
            )

        fit = {  # 4: the record of the fit, and the test flights, by paper eqs 17 and 18
            "samples": int(targets.notna().any(axis=1).sum()),
            "samples_available": int(Y.notna().any(axis=1).sum()),
            "values": int(targets.notna().sum().sum()),
            "thrust": sources,
            **_evaluation.fit_facts(model),
            **_evaluation.fit_least_squares(model, X, targets),
            "seconds": round(seconds, 3),
            "flights": {name: len(part) for name, part in train.items()},
        }
        reconstruction = steps.get("reconstruction", "auto")
        settings = {
            "samples": fit["samples"],
            **loads,
            **_evaluation.settings_of(model, reconstruction, horizons),
        }
        settings |= {} if reversed_of(servos) is None else {"servos": servos}
        evaluations = _evaluation.evaluate_flights(test, model, aircraft, settings, fit)
    return Identification(
        title=f"{aircraft.name}: aerodynamic coefficients",
        aircraft=aircraft,
        pipeline=model,
        settings=settings,
        fit=fit,
        train=train,
        evaluations=evaluations,
        messages=messages.texts,
        held_out=held_out,
        assumed=_assumed.assumptions(aircraft, servos=servos, thrust_unknown=thrust_unknown),
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
        ``thrust`` and ``external_forces``, where they differ from those of the model's fit.

    Returns
    -------
    Identification
        Without training flights.
    """
    settings = {"thrust": "auto", "external_forces": []} | model.get("options", {}) | loads
    settings["horizons"] = list(horizons)
    reading = dict(reading or {})
    servos = reading.get("servos") or settings.get("servos")
    with recorded_warnings() as messages:
        notify("reading")
        named = _flights.named_flights(flights, **reading | {"servos": servos})
        flights = _evaluation.usable_flights_of_model(model.pipeline, named)
        messages.ignore(FlightDataWarning, WARNING_START)  # the steps meet them again
        for name in flights.keys() & set(model.get("flights", [])):
            _warn(
                f"The model learned from a flight {name!r}: if it is this one, its errors say "
                f"nothing about others."
            )
        aircraft = _aircraft(model.aircraft if aircraft is None else aircraft)
        fit = _evaluation.fit_facts(model.pipeline) | model.get("fit", {})
        evaluations = _evaluation.evaluate_flights(flights, model.pipeline, aircraft, settings, fit)
    return Identification(
        title=f"{aircraft.name}: a model on other flights",
        aircraft=aircraft,
        pipeline=model.pipeline,
        settings=settings,
        fit=fit,
        train={},
        evaluations=evaluations,
        messages=messages.texts,
    )


def _aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, read from a file where a path is given."""
    return (
        Aircraft.from_file(aircraft)
        if isinstance(aircraft, str | os.PathLike)
        else check_aircraft(aircraft)
    )


def _warn(message):
    warn(message, stacklevel=3)
