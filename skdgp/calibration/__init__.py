"""Standard deviations and intervals that hold on flights that were not learned from.

A model states how uncertain it is; flights that it has not seen show how wrong it was. Scaling the first by the second
gives bands with a guarantee that needs no normal distribution and no right model: only that the next flight is of the
same kind as those of the calibration.
"""

from skdgp.calibration._regressor import CalibratedRegressor

__all__ = ["CalibratedRegressor"]
