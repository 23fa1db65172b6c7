"""Identification of a model from flights: the workflow, the pipeline, and the model file."""

from skdgp.identification._changed import Changes
from skdgp.identification._changed import Compared as Compared
from skdgp.identification._changed import changes_of as changes_of
from skdgp.identification._evaluate import THRESHOLDS
from skdgp.identification._evaluate import Evaluation as Evaluation
from skdgp.identification._evaluate import score_table as score_table
from skdgp.identification._evaluate import scores as scores
from skdgp.identification._flights import check_identified as check_identified
from skdgp.identification._flights import named_flights as named_flights
from skdgp.identification._flights import usable_flights_of_model as usable_flights_of_model
from skdgp.identification._identification import Identification
from skdgp.identification._identify import identify, validate
from skdgp.identification._mechanics import FlightMechanics as FlightMechanics
from skdgp.identification._model_file import ModelFileError, load_model, save_model
from skdgp.identification._pipeline import (
    FlightPipeline,
    make_identification_pipeline,
)
from skdgp.identification._pipeline import flight_regressors as flight_regressors
from skdgp.identification._verdict import Use as Use
from skdgp.identification._verdict import Verdict

__all__ = [
    "THRESHOLDS",
    "Changes",
    "FlightPipeline",
    "Identification",
    "ModelFileError",
    "Verdict",
    "identify",
    "load_model",
    "make_identification_pipeline",
    "save_model",
    "validate",
]
