"""The workflow from flights to an evaluated model."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch

from skdgp._compute.messages import notify, recorded_warnings, warn
from skdgp._flight.channels import ALL_SURFACES, ELEVONS, MIXED
from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, check_aircraft
from skdgp.identification import _flights, _identification
from skdgp.identification._flights import Flights
from skdgp.identification._identification import Identification
from skdgp.identification._pipeline import make_identification_pipeline
from skdgp.io import FULL_THROW, reversed_of
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import FlightPathReconstruction

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
    horizons: Sequence[float] = (2.0, 10.0),
    reading: Mapping[str, Any] | None = None,
    **loads: Any,
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
        table. Each has an ``airspeed``.
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
    regressor = _checked(regressor)
    with recorded_warnings() as messages:
        notify("reading")  # 1: flights to learn from and to test on
        prepared = prepare(
            flights, test, aircraft, regressors=regressors, reading=reading or {}, **loads
        )
        if prepared.has_full_throws:
            messages.ignore(UserWarning, "Got surfaces up to")
        # The steps repeat warnings of the same faults, and of constant regressors, which they number.
        messages.ignore(UserWarning, (WARNING_START, "The regressors ['x"))
        notify("coefficients")  # 2: inverse dynamics, paper eqs 3 to 8
        Y = aerodynamic_coefficients(prepared.table, prepared.aircraft, **prepared.loads)
        targets = thin_targets(Y, _n_rows(samples, regressor, len(Y)))

        notify("transforming")  # 3: regressors (paper eq 22 is the set "paper"), eq 20
        model = _pipeline_for(prepared, regressors, regressor, pipeline or {})
        began = time.monotonic()
        X = model.fit_regressors(prepared.table, targets)
        seconds = round(time.monotonic() - began, 3)
        fit = _record(prepared, model, X, Y, targets) | {"seconds": seconds}
        if lags := _identification.lags_message(fit["lags"]):
            warn(lags, stacklevel=2)

        # 4: the test flights, by paper eqs 17 and 18
        aircraft = prepared.aircraft
        if "propeller" in fit["thrust"]:
            named = _identification.named(model, X)
            aircraft = _flights.with_thrust_errors(aircraft, prepared.table, named)
        settings = _settings(prepared, model, fit, horizons)
        evaluations = [
            _identification.evaluate(name, table, model, aircraft, settings, fit)
            for name, table in prepared.test.items()
        ]
    return Identification(
        title=f"{aircraft.name}: aerodynamic coefficients",
        aircraft=aircraft,
        pipeline=model,
        settings=settings,
        fit=fit,
        train=prepared.train,
        evaluations=evaluations,
        messages=messages.texts,
        held_out=prepared.held_out,
        assumed=_flights.assumptions(
            aircraft, servos=prepared.servos, thrust_unknown=prepared.lacks_thrust
        ),
    )


@dataclass(frozen=True, kw_only=True)
class PreparedFlights:
    """Flights of an identification.

    Attributes
    ----------
    train, test : dict of str to DataFrame
        Usable rows of the flights to learn from, and to be tested on.
    held_out : str or None
        The part tested on because no test flight was named.
    aircraft : Aircraft
        With the deviations that the flights leave it.
    servos : object
        What gave the surfaces, with the signs that the flights show.
    loads : dict
        ``thrust`` and ``external_forces`` of the inverse dynamics.
    lacks_thrust : bool
        Whether the thrust is part of the coefficients, as nothing gives it.
    """

    train: Flights
    test: Flights
    held_out: str | None
    aircraft: Aircraft
    servos: Any
    loads: dict[str, Any]
    lacks_thrust: bool

    @property
    def has_full_throws(self) -> bool:
        """Whether surfaces are in parts of their full throw."""
        return reversed_of(self.servos) is not None

    @property
    def table(self) -> pd.DataFrame:
        """The training flights in one table."""
        return pd.concat(self.train.values(), ignore_index=True)


def prepare(
    flights: Any,
    test: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    regressors: str | Sequence[str],
    reading: Mapping[str, Any],
    thrust: str | None = "auto",
    external_forces: Sequence[str] = (),
) -> PreparedFlights:
    """Read and check flights; parameters and errors: see `identify`.

    Warns of faults, contradictions and assumptions.
    """
    aircraft = as_aircraft(aircraft)
    servos = _flights.servos_for(reading.get("servos"), flights, test)
    options = {**reading, "servos": servos, "needed": _flights.MEASURED}
    train = _flights.named_flights(flights, **options)
    _flights.check_controls(train, regressors)
    named = {} if test is None else _flights.named_flights(test, default="test flight", **options)
    train, named, held_out = _flights.train_and_test(train, named)
    columns = _flights.regressor_columns(train.values(), regressors)
    train, named = (_flights.usable_flights(part, regressors, columns) for part in (train, named))
    lacks_thrust = _flights.lacks_thrust(thrust, train.values(), aircraft)
    if lacks_thrust:
        warn(_flights.THRUST_IN_COEFFICIENTS, stacklevel=3)
        thrust = None
    if thrust is None:
        _flights.warn_of_engine(train, regressors)
    if reversed_of(servos) is not None:
        warn(_flights.FULL_THROWS, stacklevel=3)
    return PreparedFlights(
        train=train,
        test=named,
        held_out=held_out,
        aircraft=aircraft,
        servos=servos,
        loads={"thrust": thrust, "external_forces": list(external_forces)},
        lacks_thrust=lacks_thrust,
    )


def as_aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, read from a file where a path is given."""
    is_path = isinstance(aircraft, str | os.PathLike)
    return Aircraft.from_file(aircraft) if is_path else check_aircraft(aircraft)


def _checked(regressor: DependentGPRegressor | None) -> DependentGPRegressor:
    """Return the regressor, by default one of seed 0; raise TypeError if it is of another kind."""
    regressor = DependentGPRegressor(random_state=0) if regressor is None else regressor
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__} as the regressor, but expected a "
            f"DependentGPRegressor: fit other regressors with make_identification_pipeline."
        )
    return regressor


def _n_rows(samples: int | str | None, regressor: DependentGPRegressor, n: int) -> int:
    """Return how many of n rows to learn from."""
    if samples is None and regressor.inference == "exact":
        return EXACT_SAMPLES
    return n if samples in (None, "all") else samples  # type: ignore[return-value]


def _pipeline_for(
    prepared: PreparedFlights, regressors: Any, regressor: Any, options: Mapping[str, Any]
) -> Pipeline:
    """Return the pipeline that learns the coefficients of the flights."""
    columns = {*prepared.table}
    mixes = not {*ELEVONS} & columns and not {*MIXED} <= columns
    steps = {"mixer": "passthrough" if mixes else None} | dict(options)
    model = make_identification_pipeline(
        prepared.aircraft, regressors=regressors, regressor=regressor, **steps
    )
    if isinstance(model["flightpathreconstruction"], FlightPathReconstruction):
        model.set_params(flightpathreconstruction__thrust=prepared.loads["thrust"])
        if prepared.loads["external_forces"]:  # which the motion of the air does not know
            model.set_params(flightpathreconstruction__aircraft=None)
    if prepared.lacks_thrust and isinstance(regressors, str):  # a set, which has the throttle
        model.set_params(regressorselector__extra=["airspeed"])
    model.control_units_ = dict.fromkeys(
        ALL_SURFACES if prepared.has_full_throws else (), FULL_THROW
    )
    return model


def _record(prepared: PreparedFlights, model: Pipeline, X: Any, Y: Any, targets: Any) -> dict:
    """Return samples, likelihood, noise and least squares of a fit."""
    return {
        "samples": int(targets.notna().any(axis=1).sum()),
        "samples_available": int(Y.notna().any(axis=1).sum()),
        "values": int(targets.notna().sum().sum()),
        "thrust": _identification.thrust_sources(prepared.loads["thrust"], prepared.train.values()),
        **_identification.fit_facts(model),
        "least_squares": _identification.fit_least_squares(model, X, targets),
        "flights": {name: len(part) for name, part in prepared.train.items()},
    }


def _settings(prepared: PreparedFlights, model: Pipeline, fit: dict, horizons: Any) -> dict:
    """Return the options of an identification, given or chosen."""
    servos = {"servos": prepared.servos} if prepared.has_full_throws else {}
    regressor = model[-1]
    reconstructs = isinstance(model["flightpathreconstruction"], FlightPathReconstruction)
    return {
        "samples": fit["samples"],
        **prepared.loads,
        "inference": regressor.inference,
        "structure": regressor.structure,
        "regressors": model["regressorselector"].regressors,
        "reconstruction": "auto" if reconstructs else "none",
        "input_noise": "none" if regressor.input_noise is None else "learned",
        "trend": "none" if regressor.trend is None else regressor.trend,
        "seed": regressor.random_state,
        "horizons": list(horizons),
        "inducing": regressor.n_inducing,
        "latents": regressor.n_latent,
        "max_iter": regressor.max_iter,
        "lags": model["lagcorrector"].lags,
        **servos,
    }


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
        Without training flights.
    """
    settings = {"thrust": "auto", "external_forces": []} | model.get("options", {}) | loads
    settings["horizons"] = list(horizons)
    reading = dict(reading or {})
    servos = reading.get("servos") or settings.get("servos")
    with recorded_warnings() as messages:
        notify("reading")
        named = _flights.named_flights(flights, **reading | {"servos": servos})
        flights = _identification.usable_flights_of_model(model.pipeline, named)
        messages.ignore(FlightDataWarning, WARNING_START)  # the steps meet them again
        for name in flights.keys() & set(model.get("flights", [])):
            warn(
                f"The model learned from a flight {name!r}: if it is this one, its errors say "
                f"nothing about others.",
                stacklevel=2,
            )
        aircraft = as_aircraft(model.aircraft if aircraft is None else aircraft)
        fit = _identification.fit_facts(model.pipeline) | model.get("fit", {})
        evaluations = [
            _identification.evaluate(name, table, model.pipeline, aircraft, settings, fit)
            for name, table in flights.items()
        ]
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
