"""Dependent Gaussian processes as a scikit-learn regressor."""

from skdgp._regressor._checks import FewRowsWarning, check_targets
from skdgp._regressor._checks import FitCode as FitCode
from skdgp._regressor._checks import search_ended as search_ended
from skdgp._regressor._estimator import DependentGPRegressor
from skdgp._regressor._recipe import RegressorSettings

__all__ = ["DependentGPRegressor", "FewRowsWarning", "RegressorSettings", "check_targets"]
