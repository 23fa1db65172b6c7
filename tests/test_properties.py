"""What holds of the regressor for every problem: units and uncertainty.

Problems by hypothesis.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian

pytestmark = pytest.mark.filterwarnings(
    "ignore:The regressors .* are constant",
    "ignore:Got n_inducing",
    "ignore:.*inducing inputs leave",
    "ignore:.* samples repeat another",
)
EXAMPLES = settings(max_examples=10)
INFERENCE = st.sampled_from(["exact", "sparse"])


def problem(seed):
    """Return X (n, d) and Y (n, P) on scales of the seed's choice, smooth functions with noise, some values missing."""
    rng = default_rng(seed)
    n = int(rng.integers(8, 30))
    d = int(rng.integers(1, 5))
    P = int(rng.integers(1, 4))
    X = rng.normal(size=(n, d)) * 10.0 ** rng.uniform(-4, 4, d)
    phases = X / X.std(axis=0) @ rng.normal(size=(d, P)) + rng.uniform(0, 6, P)
    Y = (np.sin(phases) + 0.1 * rng.normal(size=(n, P))) * 10.0 ** rng.uniform(-4, 4, P)
    if n > 12:
        Y[rng.random((n, P)) < 0.2] = np.nan
        usual = np.nanmean(Y, axis=0) + np.nanstd(Y, axis=0)
        Y[:4] = np.where(np.isnan(Y[:4]), usual, Y[:4])
    return X, Y


def options(seed, X):
    """Return some options of the regressor; hyperparameters are those that a fit starts from."""
    rng = default_rng(seed + 1)
    return {
        "optimizer": None,
        "random_state": 0,
        "kernel": ConvolvedGaussian(
            int(rng.integers(0, 3)), covariance_type=str(rng.choice(["diag", "tied"]))
        ),
        "trend": [None, "constant", "linear"][rng.integers(3)],
        "n_inducing": 40,
        "input_noise": [None, None, 0.1 * X.std(axis=0)][rng.integers(3)],
    }


def close(got, expected, spread, rtol=1e-6):
    """Assert that predictions agree, relative to the spread of the outputs."""
    assert_allclose(got / spread, expected / spread, rtol=rtol, atol=rtol)


def moments(model, X, **options):
    """Return mean and standard deviation, (2, n, P)."""
    return np.stack(model.predict(X, return_std=True, **options)).reshape(2, len(X), -1)


SEEDS = st.integers(0, 2**20)


@EXAMPLES
@given(SEEDS, INFERENCE)
def test_units_and_zero_points_decide_nothing(seed, inference):
    """Regressors and targets in other units, from other zeros: the same model, in these units.

    Its deviations are below those of the prior.
    """
    X, Y = problem(seed)
    how = options(seed, X) | {"inference": inference}
    rng = default_rng(seed + 3)
    unit = 2.0 ** rng.integers(-30, 30, X.shape[1])
    gain = 2.0 ** rng.integers(-30, 30, Y.shape[1])
    zero = 10.0 ** rng.uniform(0, 9) * rng.normal(size=unit.shape) * X.std(axis=0)
    spread = np.nanstd(Y, axis=0)
    level = 10 * rng.normal(size=gain.shape) * spread
    if how["trend"] is None:
        level = 0.0
    here = DependentGPRegressor(**how).fit(X, Y)
    if how["input_noise"] is not None:
        how["input_noise"] = how["input_noise"] * unit
    there = DependentGPRegressor(**how).fit((X + zero) * unit, (Y + level) * gain)
    at = X + 0.3 * rng.normal(size=X.shape) * X.std(axis=0)
    mean, std = moments(here, at)
    other, other_std = moments(there, (at + zero) * unit)
    close(other / gain - level, mean, spread, 1e-5)
    close(other_std / gain, std, spread, 1e-5)
    errors = here.function_errors()
    prior = here.kernel_.diag(at).reshape(-1, len(at)).T
    if errors is not None:
        prior = prior + errors.variance(at)
    assert (std > 0).all()
    assert (std <= np.sqrt(prior) * (1 + 1e-9)).all()
