"""From flights to a model of the aircraft: the pipeline that learns it, and the file that keeps it."""

from skdgp.identification._model_file import ModelFileError, load_model, save_model
from skdgp.identification._pipeline import (
    calibrate_noise,
    flight_regressors,
    make_identification_pipeline,
    predict_flight,
)

__all__ = [
    "ModelFileError",
    "calibrate_noise",
    "flight_regressors",
    "load_model",
    "make_identification_pipeline",
    "predict_flight",
    "save_model",
]
