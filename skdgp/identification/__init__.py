"""Identification of a model from flights: the workflow, the pipeline, and the model file."""

from skdgp.identification._evaluation import Evaluation
from skdgp.identification._identification import Identification
from skdgp.identification._identify import identify, validate
from skdgp.identification._model_file import ModelFileError, load_model, save_model
from skdgp.identification._pipeline import (
    FlightPipeline,
    flight_noise,
    flight_regressors,
    make_identification_pipeline,
    predict_flight,
)

__all__ = [
    "Evaluation",
    "FlightPipeline",
    "Identification",
    "ModelFileError",
    "flight_noise",
    "flight_regressors",
    "identify",
    "load_model",
    "make_identification_pipeline",
    "predict_flight",
    "save_model",
    "validate",
]
