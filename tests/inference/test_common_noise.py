"""What errors of regressors have in common between outputs: in the objective of a search, and in what it learns."""

import numpy as np
import pytest
from numpy.random import default_rng

from skdgp import DependentGPRegressor

STD = 0.1, 0.01  # of the errors of two regressors


@pytest.fixture(scope="module")
def time_series():
    """Two noisy regressors, which two outputs that share nothing else both feel."""
    rng = default_rng(0)
    x = rng.uniform(-2, 2, (800, 2))
    Y = np.sin(x) + np.cos(x[:, ::-1])
    return x + rng.normal(0, STD, x.shape), Y + rng.normal(0, 0.02, Y.shape)


@pytest.mark.parametrize(("inference", "n"), [("exact", 150), ("sparse", 800)])
def test_the_noise_of_each_regressor_is_found(time_series, inference, n):
    X, Y = (part[:n] for part in time_series)
    model = DependentGPRegressor(
        n_latent=0, structure="joint", inference=inference, random_state=0, max_iter=30
    )
    model.fit(X, Y, time=0.1 * np.arange(n))
    found = np.sqrt(np.diag(model.input_covariance_))
    assert found[0] == pytest.approx(STD[0], rel=0.2)
    assert found[1] < 3 * STD[1]
