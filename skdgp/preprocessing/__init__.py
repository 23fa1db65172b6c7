"""Transformers of flight tables, from raw logs to regressors.

Each also has ``n_features_in_`` and ``feature_names_in_``, the columns seen in ``fit``.

>>> from sklearn.pipeline import make_pipeline
>>> from skdgp.preprocessing import ElevonSplitter, FlightSmoother, RateNondimensionalizer, RegressorSelector
>>> regressors = make_pipeline(
...     FlightSmoother(), ElevonSplitter(), RateNondimensionalizer(span=2.8, chord=1.2), RegressorSelector()
... )
"""

from skdgp._flight.faults import FlightDataWarning
from skdgp.preprocessing._cleaning import FlightCheck, FlightSmoother, inspect_flight
from skdgp.preprocessing._columns import ElevonSplitter, RateNondimensionalizer, RegressorSelector
from skdgp.preprocessing._flight_path import FlightPathReconstruction
from skdgp.preprocessing._lag import LagCorrector

__all__ = [
    "ElevonSplitter",
    "FlightCheck",
    "FlightDataWarning",
    "FlightPathReconstruction",
    "FlightSmoother",
    "LagCorrector",
    "RateNondimensionalizer",
    "RegressorSelector",
    "inspect_flight",
]
