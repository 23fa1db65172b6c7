"""Predictions of any estimator with standard deviations, also inside pipelines and searches."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from sklearn.frozen import FrozenEstimator
from sklearn.pipeline import Pipeline


def predict_observed(estimator: Any, X: Any, y: Any, *, with_std: bool) -> tuple:
    """Return the rows where some target is observed, all if none is, and mean and std there."""
    observed = np.isfinite(np.asarray(y, dtype=float).reshape(len(y), -1)).any(axis=1)
    rows = np.flatnonzero(observed) if observed.any() else np.arange(len(observed))
    predicted = predict_with_noise(estimator, X) if with_std else (estimator.predict(X),)
    return rows, *(np.asarray(part)[rows] for part in predicted)


def predict_with_noise(estimator: Any, X: Any) -> tuple:
    """Return mean and std, with the noise of measurements and regressors where the estimator can add it."""
    check_predicts_std(estimator)
    noise = {
        name: True for name in ("include_noise", "include_input_noise") if accepts(estimator, name)
    }
    return tuple(
        np.asarray(part) for part in unwrap(estimator).predict(X, return_std=True, **noise)
    )


def check_predicts_std(estimator: Any) -> None:
    """Raise TypeError if the estimator predicts no standard deviations."""
    if not accepts(estimator, "return_std"):
        raise TypeError(
            f"Got {type(estimator).__name__}, whose predict takes no return_std, but this metric "
            f"needs "
            "predictive standard deviations: use DependentGPRegressor, also inside a Pipeline, or "
            "a metric of means."
        )


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
