"""Calibration of standard deviations and intervals by held-out flights.

A model predicts standard deviations; held-out flights show its errors. Scaling the first by the second gives intervals
with a guaranteed coverage. The guarantee needs no normal distribution and no correct model, only that the next flight
is of the same kind as the flights of the calibration.
"""

from skdgp.calibration._regressor import CalibratedRegressor
from skdgp.calibration._trajectories import CalibratedBands

__all__ = ["CalibratedBands", "CalibratedRegressor"]
