"""Saved models, and the flights that commands apply them to."""

from __future__ import annotations

import warnings

import pandas as pd
from sklearn.utils import Bunch

from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp._regressor import DependentGPRegressor
from skdgp.identification import load_model
from skdgp.identification._evaluation import Loads
from skdgp.identification._rows import check_same_columns, checked, complete_rows
from skdgp.identification._source import read_aircraft, read_named

STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}


def read_model(options) -> Bunch:
    """Read the model that the options name, with its own aircraft or the one that they name.

    Raises
    ------
    ValueError, OSError
        What the reader raises; or if it is not what identification makes.
    """
    model = load_model(options.model)
    steps = getattr(model.pipeline, "named_steps", {})
    if not set(steps) >= STEPS or not isinstance(model.pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got {options.model}, a model of {list(steps) or type(model.pipeline).__name__}, but expected what "
            "make_identification_pipeline makes: its regressors must be known, and how sure it is."
        )
    if getattr(options, "aircraft", None) is not None:
        model.aircraft = read_aircraft(options.aircraft)
    return model


def loads_of(model: Bunch, options) -> Loads:
    """Return the loads as the options say, or else as they were when the model was learned."""
    learned = model.get("options", {})
    thrust, forces = options.thrust, options.external_forces
    return Loads.of(
        learned.get("thrust", "auto") if thrust is None else thrust,
        learned.get("external_forces", []) if forces is None else forces,
    )


def engine_of(model) -> str | None:
    """Return what tells the thrust of a simulation, "auto" or None; warn of known loads that are not flown."""
    learned = model.get("options", {})
    if learned.get("external_forces"):
        warnings.warn(
            f"The simulation flies without the external forces {learned['external_forces']} of the flights that the "
            "model was learned from.",
            UserWarning,
            stacklevel=2,
        )
    return None if learned.get("thrust", "auto") in (None, "none") else "auto"


def read_flights(paths, model: Bunch, options) -> dict[str, pd.DataFrame]:
    """Read flights, and leave out, with a warning, the rows that the model cannot say anything of.

    Raises
    ------
    ValueError, OSError
        What the readers raise; or if a flight lacks a column of regressors that those learned from had.
    """
    flights = checked(read_named(paths, options))
    warnings.filterwarnings(
        "ignore", WARNING_START, FlightDataWarning
    )  # by each step that meets the same flights again
    regressors = model.pipeline["regressorselector"].regressors
    learned_from = pd.DataFrame(columns=model.pipeline[0].feature_names_in_)
    check_same_columns({"learned from": learned_from}, flights, regressors)
    return {name: complete_rows(table, regressors) for name, table in flights.items()}
