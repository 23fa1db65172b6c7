"""From a raw flight table to regressors, as scikit-learn transformers that know columns by name.

>>> from sklearn.pipeline import make_pipeline
>>> from skdgp.preprocessing import ElevonSplitter, FlightSmoother, RateNondimensionalizer, RegressorSelector
>>> regressors = make_pipeline(
...     FlightSmoother(), ElevonSplitter(), RateNondimensionalizer(span=2.8, chord=1.2), RegressorSelector()
... )
"""

from skdgp.preprocessing._elevons import ElevonSplitter
from skdgp.preprocessing._rates import RateNondimensionalizer
from skdgp.preprocessing._reconstruction import FlightPathReconstruction
from skdgp.preprocessing._selector import RegressorSelector
from skdgp.preprocessing._smoother import FlightSmoother

__all__ = [
    "ElevonSplitter",
    "FlightPathReconstruction",
    "FlightSmoother",
    "RateNondimensionalizer",
    "RegressorSelector",
]
