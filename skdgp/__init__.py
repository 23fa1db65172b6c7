"""Aircraft aerodynamics from flight logs with dependent Gaussian processes, as ordinary scikit-learn."""

from skdgp._checkpoint import checkpointing
from skdgp._progress import listening
from skdgp._regressor import DependentGPRegressor
from skdgp.identification import make_identification_pipeline

__all__ = ["DependentGPRegressor", "checkpointing", "listening", "make_identification_pipeline"]
__version__ = "0.1.0"
