"""Training subsets and splits of flights.

Hold out whole flights with scikit-learn's ``LeaveOneGroupOut`` or ``GroupKFold`` on the column ``flight``. Neighbouring
samples of one flight are nearly equal, so a random split inside a flight gives scores that are too good. With a single
flight, ``BlockSplit`` holds out blocks of it, with a gap in time.

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

from skdgp.model_selection._rows import BlockSplit, thin_targets

__all__ = ["BlockSplit", "thin_targets"]
