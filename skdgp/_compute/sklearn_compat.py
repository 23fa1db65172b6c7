"""Names of scikit-learn that are private or new: the one file that imports them, for versions 1.6.1 to 1.9.

They are not part of scikit-learn's public interface, so a new version may move them. Then this file
changes, and no other.
"""

from __future__ import annotations

from typing import Any

# fit_context: decorator of fit that checks `_parameter_constraints`; since 1.3.
from sklearn.base import _fit_context as fit_context

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
    "check_feature_names_in",
    "fit_context",
    "output_container",
    "safe_indexing",
    "set_output_container",
    "validate_params",
]


def output_container(estimator: Any, default: str) -> str:
    """Return the container that ``set_output`` chose for ``transform``; since 1.2."""
    return getattr(estimator, "_sklearn_output_config", {}).get("transform", default)


def set_output_container(estimator: Any, container: str) -> None:
    """Store the container of ``transform`` where scikit-learn's ``set_output`` does; since 1.2."""
    estimator._sklearn_output_config = {"transform": container}
