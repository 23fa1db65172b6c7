"""How far predictions are off, and whether their uncertainty tells the truth.

Targets (n,) or (n, P); a NaN target was not observed and is left out, output by output. ``multioutput`` is
scikit-learn's: ``"raw_values"`` one number per output, ``"uniform_average"`` their mean, or an array of
weights. The scorers serve ``scoring=`` of ``cross_validate`` and ``GridSearchCV``.
"""

from skdgp.metrics._point import median_relative_error, normalized_rmse
from skdgp.metrics._probabilistic import (
    continuous_ranked_probability_score,
    coverage_curve,
    interval_coverage,
    negative_log_predictive_density,
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
