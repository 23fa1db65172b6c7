"""What the defaults reach on the shared benchmarks, next to published and simpler methods."""

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import normalized_rmse
from skdgp.model_selection import thin_targets

CONVOLVED_GP = 0.4552  # mean absolute error of Cd, Alvarez & Lawrence (2011)
pytestmark = [pytest.mark.shared, pytest.mark.slow]


@pytest.mark.filterwarnings("ignore:5 values lie far")
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


def test_another_flight_is_predicted_better_than_by_least_squares(shared_data):
    """On four minutes of a flight at two altitudes, from 100 noisy samples of two minutes at one."""
    folder = shared_data / "flights"
    aircraft = Aircraft.from_file(folder / "viggen_uav.json")
    train = read_flight(folder / "viggen_uav_train_latlon.parquet")[:4800]
    test = read_flight(folder / "viggen_uav_test_twoalt.parquet")[:9600]
    targets = thin_targets(aerodynamic_coefficients(train, aircraft), 100)
    model = make_identification_pipeline(aircraft).fit(train, targets)
    X, asked = (model[:-1].transform(flight) for flight in (train, test))
    truth = test[[f"{name}_true" for name in targets]]
    rows = targets.notna().all(axis=1)
    line = LinearRegression().fit(X[rows], targets[rows])
    found, linear = (normalized_rmse(truth, fit.predict(asked)) for fit in (model[-1], line))
    assert found < 0.95 * linear
