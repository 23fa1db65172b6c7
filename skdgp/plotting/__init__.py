"""Pictures in scikit-learn's manner: a Display holds the data, draws them, and keeps its artists.

Every display is made by ``from_predictions``, ``from_estimator`` or the like, draws into a given Axes or
Figure or a new one, and is safe for colour-blind readers. Long records are reduced to the extremes of each
time slice before they are drawn. Needs matplotlib: ``pip install "skdgp[plot]"``.
"""

from skdgp.plotting._calibration import CalibrationDisplay
from skdgp.plotting._coefficients import CoefficientDisplay
from skdgp.plotting._coupling import CouplingDisplay
from skdgp.plotting._derivatives import DerivativeDisplay
from skdgp.plotting._flight import FlightDisplay
from skdgp.plotting._flight_envelope import EnvelopeDisplay
from skdgp.plotting._learning_curve import FlightLearningCurveDisplay
from skdgp.plotting._states import StateDisplay
from skdgp.plotting._trajectory import TrajectoryDisplay

__all__ = [
    "CalibrationDisplay",
    "CoefficientDisplay",
    "CouplingDisplay",
    "DerivativeDisplay",
    "EnvelopeDisplay",
    "FlightDisplay",
    "FlightLearningCurveDisplay",
    "StateDisplay",
    "TrajectoryDisplay",
]
