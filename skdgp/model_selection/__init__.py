"""Choosing what is learned from, and what it is judged on.

Whole flights are held out with scikit-learn's own ``LeaveOneGroupOut`` or ``GroupKFold`` on the column ``flight``:
neighbouring samples of one flight are nearly the same, so a split inside a flight flatters the model. Where there is
one flight alone, ``BlockSplit`` holds out blocks of it, at a distance.

>>> import numpy as np, pandas as pd
>>> from sklearn.linear_model import LinearRegression
>>> from sklearn.model_selection import LeaveOneGroupOut, cross_validate
>>> from skdgp.metrics import SCORERS
>>> rng = np.random.default_rng(0)
>>> flight = pd.DataFrame({"flight": np.repeat(["a", "b", "c"], 40), "alpha": rng.normal(size=120)})
>>> Y = pd.DataFrame({"CZ": -5 * flight.alpha, "Cm": -0.5 * flight.alpha})
>>> scores = cross_validate(
...     LinearRegression(), flight[["alpha"]], Y, groups=flight.flight, cv=LeaveOneGroupOut(),
...     scoring=SCORERS["neg_normalized_rmse"],
... )
>>> scores["test_score"].shape
(3,)
"""

from skdgp.model_selection._blocks import BlockSplit
from skdgp.model_selection._learning_curve import flight_learning_curve
from skdgp.model_selection._thin import thin_targets

__all__ = ["BlockSplit", "flight_learning_curve", "thin_targets"]
