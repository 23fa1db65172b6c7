"""What the defaults reach on the shared benchmarks, next to published and simpler methods."""

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor

CONVOLVED_GP = 0.4552  # mean absolute error of Cd, Alvarez & Lawrence (2011)
pytestmark = [pytest.mark.shared, pytest.mark.slow]


@pytest.mark.filterwarnings("ignore:. values lie far")
def test_jura_is_predicted_better_than_by_the_published_convolved_process(shared_data):
    """Cadmium where nickel and zinc are known. Seeds change the error by 0.001, a tenth of the distance."""
    parts = [
        pd.read_csv(shared_data / "jura" / f"jura_{k}.csv") for k in ("prediction", "validation")
    ]
    both = pd.concat(parts)
    truth = parts[1]["Cd"].to_numpy()
    Y = both[["Cd", "Ni", "Zn"]].to_numpy(float)
    Y[-len(truth) :, 0] = np.nan
    X = both[["Xloc", "Yloc"]].to_numpy()
    found = DependentGPRegressor(random_state=0).fit(X, Y).predict(X[-len(truth) :])[:, 0]
    assert np.abs(found - truth).mean() < CONVOLVED_GP
