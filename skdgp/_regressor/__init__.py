"""Dependent Gaussian processes as a scikit-learn regressor."""

from skdgp._regressor._checks import FewRowsWarning, check_targets
from skdgp._regressor._estimator import DependentGPRegressor

__all__ = ["DependentGPRegressor", "FewRowsWarning", "check_targets"]
