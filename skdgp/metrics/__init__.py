"""Metrics of predictions and of their standard deviations.

Targets are (n,) or (n, P). A NaN target was not observed and is left out, output by output. ``multioutput`` is
scikit-learn's: ``"raw_values"`` for one number per output, ``"uniform_average"`` for their mean, or an array of
weights. The metric of an output that is never observed is NaN, with a warning. The metrics raise ValueError if shapes
differ, a prediction is not finite, a standard deviation is not positive (negative, for ``coverage_curve``), or a level
is not inside (0, 1). The scorers serve ``scoring=`` of ``cross_validate`` and ``GridSearchCV``.
"""

from skdgp.metrics._metrics import (
    continuous_ranked_probability_score,
    coverage_curve,
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.metrics._scorers import SCORERS, make_predictive_scorer, score_flights, score_outputs

__all__ = [
    "SCORERS",
    "continuous_ranked_probability_score",
    "coverage_curve",
    "interval_coverage",
    "make_predictive_scorer",
    "median_relative_error",
    "negative_log_predictive_density",
    "normalized_rmse",
    "score_flights",
    "score_outputs",
]
