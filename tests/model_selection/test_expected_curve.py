"""The learning curve that is known before the log is learned."""

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.model_selection import expected_learning_curve
from skdgp.preprocessing import RegressorSelector

REGRESSORS = ["alpha", "elevator"]


@pytest.fixture(scope="module")
def log():
    """Return a log of two flights; the second half of each repeats the first."""
    rng = np.random.default_rng(0)
    half = np.cumsum(rng.normal(0, 0.02, (200, 2)), axis=0)
    table = pd.DataFrame(np.tile(half, (4, 1)), columns=REGRESSORS)
    return table.assign(time=np.tile(np.arange(400) * 0.1, 2), flight=np.repeat(["a", "b"], 400))


@pytest.fixture(scope="module")
def pipeline(log):
    rng = np.random.default_rng(1)
    Y = pd.DataFrame({"CZ": np.sin(3 * log["alpha"]), "Cm": log["elevator"] - log["alpha"]})
    Y = Y + rng.normal(0, 0.05, Y.shape)
    Y[log.index % 10 > 0] = np.nan
    regressor = DependentGPRegressor(n_latent=1, max_iter=30, random_state=0)
    return make_pipeline(RegressorSelector(REGRESSORS), StandardScaler(), regressor).fit(log, Y)


def test_all_of_the_log_is_what_a_model_of_it_says_of_itself(pipeline, log):
    """The model has learned every tenth row; the posterior variance does not depend on the targets."""
    learned = log.iloc[::10]
    model = pipeline[-1]
    std = pipeline.predict(learned, return_std=True)[1]
    mean = pipeline.predict(learned)
    curve = expected_learning_curve(pipeline, learned, seconds=[40.0], n_samples=80, n_points=80)
    errors = curve[["normalized_rmse_CZ", "normalized_rmse_Cm"]].to_numpy()[0]
    np.testing.assert_allclose(errors, np.sqrt((std**2).mean(axis=0)) / mean.std(axis=0), rtol=1e-6)
    noisy = expected_learning_curve(pipeline, learned, seconds=[40.0], n_samples=80, n_points=80, include_noise=True)
    total = np.sqrt((std**2).mean(axis=0) + model.noise_variance_) / mean.std(axis=0)
    np.testing.assert_allclose(noisy[["normalized_rmse_CZ", "normalized_rmse_Cm"]].to_numpy()[0], total, rtol=1e-6)
    assert curve["above"].tolist() == [0.0]


def test_what_repeats_teaches_little_and_what_is_new_much(pipeline, log):
    curve = expected_learning_curve(pipeline, log, seconds=[2, 10, 20, 40], n_samples=160)
    assert curve["n_samples"].tolist() == [8, 40, 80, 160]
    above = curve["above"].to_numpy()
    assert (np.diff(above) < 0).all()
    assert above[0] - above[2] > 3 * above[2]
    assert above[2] < np.sqrt(2) - 1 + 0.02  # twice the same rows: the errors of averages, at most


def test_a_regressor_takes_its_own_table(pipeline, log):
    transformed = pd.DataFrame(pipeline[:-1].transform(log), columns=REGRESSORS).assign(
        time=log["time"], flight=log["flight"]
    )
    bare = DependentGPRegressor(optimizer=None, n_latent=1, random_state=0)
    bare.fit(transformed[REGRESSORS][::20], log["alpha"][::20] + np.random.default_rng(2).normal(0, 0.01, 40))
    curve = expected_learning_curve(bare, transformed, seconds=5)
    assert len(curve) == 1
    assert np.isfinite(curve.to_numpy(float)).all()


def test_what_cannot_be_expected_is_said(pipeline, log):
    with pytest.raises(NotFittedError, match="call fit first"):
        expected_learning_curve(DependentGPRegressor(), log, seconds=5)
    with pytest.raises(ValueError, match="ask for fewer seconds"):
        expected_learning_curve(pipeline, log, seconds=50)
    with pytest.raises(ValueError, match="positive number of seconds"):
        expected_learning_curve(pipeline, log, seconds=-1)
    with pytest.raises(ValueError, match="without any of 4 rows"):
        expected_learning_curve(pipeline, log, seconds=0.2, n_samples=4)
    with pytest.raises(ValueError, match="time"):
        expected_learning_curve(pipeline, log.drop(columns="time"), seconds=5)
