"""Aircraft aerodynamics from flight logs with dependent Gaussian processes, as ordinary scikit-learn."""

from skdgp._regressor import DependentGPRegressor

__all__ = ["DependentGPRegressor"]
__version__ = "0.1.0"
