"""Names of scikit-learn that are private or new, and estimators inside its searches and pipelines.

This is the one file that imports these names, for versions 1.6.1 to 1.9. They are not part of
scikit-learn's public interface, so a new version may move them. Then this file changes, and no
other.
"""

from __future__ import annotations

import inspect
from typing import Any

# fit_context: decorator of fit that checks `_parameter_constraints`; since 1.3.
from sklearn.base import _fit_context as fit_context
from sklearn.frozen import FrozenEstimator
from sklearn.pipeline import Pipeline

# safe_indexing: rows of an array, a list or a table of any library; since 0.22.
from sklearn.utils import _safe_indexing as safe_indexing

# Constraints of parameters, for `_parameter_constraints` and functions; since 1.2.
from sklearn.utils._param_validation import HasMethods, Interval, StrOptions, validate_params

# check_feature_names_in: names for `get_feature_names_out`; since 1.0.
from sklearn.utils.validation import _check_feature_names_in as check_feature_names_in

__all__ = [
    "HasMethods",
    "Interval",
    "StrOptions",
    "accepts",
    "check_feature_names_in",
    "fit_context",
    "safe_indexing",
    "unwrap",
    "validate_params",
]


def unwrap(estimator: Any) -> Any:
    """Return the fitted estimator inside a search or a frozen one, whose own predict takes no keywords."""
    while True:
        if isinstance(estimator, FrozenEstimator):
            estimator = estimator.estimator
        elif (best := getattr(estimator, "best_estimator_", None)) is not None:
            estimator = best
        else:
            return estimator


def accepts(estimator: Any, keyword: str) -> bool:
    """Return whether ``predict`` of the last step takes the keyword."""
    estimator = unwrap(estimator)
    while isinstance(estimator, Pipeline):
        estimator = unwrap(estimator.steps[-1][1])
    parameters = inspect.signature(estimator.predict).parameters.values()
    return any(p.name == keyword or p.kind is p.VAR_KEYWORD for p in parameters)
