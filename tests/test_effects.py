"""Effects: independent terms that add up to the mean, with the posterior of each."""

from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor, effects
from skdgp.inference import SearchSettings, SparsePosterior
from skdgp.kernels import ConvolvedGaussian, LinearTrend, inducing_features

NAMES = ["alpha", "beta", "elevator"]
OUTPUTS = ["CZ", "Cm"]
SCALE = np.array([0.1, 0.2, 5.0])
MODELS = {
    "trend": {"structure": "trend"},
    "joint": {"structure": "joint", "n_latent": 1},
    "average": {"n_latent": 1},
    "sparse average": {"n_latent": 1, "inference": "sparse", "n_inducing": 25},
    "additive": {"structure": "additive", "n_latent": 0},
    "sparse": {"structure": "additive", "n_latent": 0, "inference": "sparse", "n_inducing": 25},
    "pairs": {
        "kernel": LinearTrend()
        + ConvolvedGaussian(0, regressors=[0, 1])
        + ConvolvedGaussian(0, regressors=[2]),
        "trend": None,
        "structure": "joint",
    },
    "no trend": {"structure": "additive", "n_latent": 0, "trend": "constant"},
    "noisy regressors": {"structure": "additive", "n_latent": 0, "input_noise": "learned"},
}


def alone(X):
    """Return the effect of each regressor on each output, (n, 3, 2)."""
    a, b, e = (np.asarray(X) / SCALE).T
    of_outputs = [np.sin(2 * a), 0 * b, 0.3 * e], [0.5 * a, b**2, -e]
    return np.moveaxis(np.array(of_outputs), -1, 0).swapaxes(1, 2)


SEARCH = SearchSettings(
    values=(300, 300), structure_values=150, trial_iterations=2, single_iterations=2
)


def quick(**options):
    """Return a regressor with one short search: what it learns matters little."""
    model = DependentGPRegressor(**{"max_iter": 6, "random_state": 0} | options)
    model.settings = replace(model.settings, search=SEARCH, time_series_search=SEARCH)
    return model


@pytest.fixture(scope="module")
def data():
    rng = default_rng(1)
    X = pd.DataFrame(SCALE * rng.uniform(-1, 1, (120, 3)), columns=NAMES)
    Y = pd.DataFrame(3.0 + alone(X).sum(axis=1) + rng.normal(0, 0.05, (120, 2)), columns=OUTPUTS)
    Y.loc[100:, "Cm"] = np.nan
    return X, Y


@pytest.fixture(scope="module")
def fitted(data):
    models = {}

    def get(name):
        if name not in models:
            models[name] = make_pipeline(StandardScaler(), quick(**MODELS[name])).fit(*data)
        return models[name]

    return get


@pytest.mark.parametrize("name", MODELS)
def test_sum_of_effects_is_the_mean_anywhere(name, fitted, data):
    model = fitted(name)
    new = data[0] * 1.7 + 0.1
    found = effects(model)
    mean, std = found.evaluate(new)
    assert_allclose(sum(mean.values()) + found.intercept, model.predict(new), rtol=1e-8, atol=1e-8)
    assert list(mean) == list(std) == list(found.importance.index)
    assert all((values >= 0).all() for values in std.values())
    for values in found.evaluate(data[0])[0].values():
        assert_allclose(values.mean(axis=0), 0.0, atol=1e-8)


@pytest.mark.parametrize("name", ["additive", "pairs", "joint"])
def test_terms_are_those_of_dense_matrices(name, fitted, data):
    """K_t** - K_t* C^-1 K_t*^T, with the effect as a linear map of the values of the term."""
    pipeline = fitted(name)
    new = data[0][:7] + 0.03
    found = effects(pipeline)
    mean, std = found.evaluate(new)
    model = pipeline[-1]
    X, Z = (pipeline[:-1].transform(x) for x in (data[0], new))
    kernel = model.posterior_.kernel
    noise = model.posterior_.noise
    Y = ((data[1] - model.center_) / model.scale_).to_numpy()
    inputs = [X[np.isfinite(y)] for y in Y.T]
    y = Y.T[np.isfinite(Y.T)]
    C = kernel(inputs) + np.diag(np.repeat(noise, [len(x) for x in inputs]))
    points = np.concatenate([Z, X])
    less_mean = np.full((len(Z), len(X)), -1 / len(X))
    centring = np.hstack([np.eye(len(Z)), less_mean])
    centring = np.kron(np.eye(2), centring)  # of both outputs
    scale = np.repeat(model.scale_, len(Z))
    for columns, title in zip(kernel.term_regressors()[1:], found.importance.index, strict=True):
        term = kernel.term(columns)
        cross = term([points] * 2, inputs)
        expected = centring @ cross @ np.linalg.solve(C, y) * scale
        assert_allclose(mean[title].T.ravel(), expected, atol=1e-7)
        covariance = term(points) - cross @ np.linalg.solve(C, cross.T)
        deviation = np.sqrt(np.diag(centring @ covariance @ centring.T)) * scale
        assert_allclose(std[title].T.ravel(), deviation, rtol=1e-4, atol=1e-6)


def test_sparse_terms_approach_the_exact_ones(data):
    exact = quick(structure="additive", n_latent=0, max_iter=15).fit(data[0] / SCALE, data[1])
    sparse = copy(exact)
    posterior = exact.posterior_
    features = inducing_features(posterior.kernel, data[0].to_numpy() / SCALE)
    sparse.posterior_ = SparsePosterior(posterior.kernel, features, posterior.noise, posterior.data)
    found = effects(sparse)
    for name, curve in effects(exact).curves.items():
        assert_allclose(found.curves[name].std, curve.std, rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("name", ["additive", "sparse"])
def test_known_functions_lie_within_the_bands(name, fitted, data):
    found = effects(fitted(name))
    assert list(found.curves) == NAMES
    average = alone(data[0]).mean(axis=0)
    for k, regressor in enumerate(NAMES):
        curve = found.curves[regressor]
        assert curve.at[0] == pytest.approx(data[0][regressor].quantile(0.01), rel=0.02)
        points = np.zeros((len(curve.at), 3))
        points[:, k] = curve.at
        truth = alone(points)[:, k] - average[k]
        # A band per point holds 95 %; neighbouring points err together.
        assert (np.abs(curve.mean - truth) < 4 * curve.std + 0.01).all()
        assert np.sqrt(np.mean((curve.mean - truth) ** 2)) < 0.05


def test_bands_of_a_time_series_are_those_of_its_functions(data):
    """A term along one regressor has the errors of its slopes."""
    X, Y = data
    lasting = np.convolve(default_rng(3).normal(size=129), np.ones(10), "valid")[:, None]
    Y = Y.fillna(0.0) + 0.1 * lasting * [1.0, -2.0]
    model = quick(structure="trend").fit(X, Y, time=0.1 * np.arange(120.0))
    points = X.iloc[::20]
    _, std = effects(model).evaluate(points)
    values = model.sample_paths(4000, random_state=0)
    samples = values(X.to_numpy()).mean(axis=1)
    for k, name in enumerate(NAMES):
        at = np.tile(X.mean().to_numpy(), (6, 1))
        at[:, k] = points[name]
        spread = (values(at) - samples[:, None]).std(axis=0)
        moved = np.abs(points[name] - X[name].mean()) > 0.3 * X[name].std()
        assert_allclose(std[name][moved], spread[moved], rtol=0.06)


def test_importance_is_the_spread_of_each_effect(fitted, data):
    found = effects(fitted("additive"))
    assert list(found.importance.index) == [*NAMES, "joint"]
    assert list(found.importance.columns) == OUTPUTS
    expected = alone(data[0]).std(axis=0)
    assert_allclose(found.importance.loc[NAMES], expected, atol=0.05)
    assert (found.importance.loc["joint"] < 0.1).all()
    assert_allclose(found.intercept, fitted("additive").predict(data[0]).mean(axis=0), atol=1e-8)


def test_axes_are_in_the_units_before_the_scaler(fitted, data):
    scaled = effects(fitted("additive"))
    model = fitted("additive")
    inner = effects(model[-1])
    assert list(inner.curves) == ["x0", "x1", "x2"]
    assert list(scaled.samples.columns) == NAMES
    back = np.sort(model[0].inverse_transform(inner.samples.to_numpy())[:, 0])
    assert_allclose(np.sort(scaled.samples["alpha"]), back)
    assert_allclose(np.sort(data[0]["alpha"]), back)


def test_names_of_pairs_and_of_a_single_regressor(fitted):
    assert list(effects(fitted("pairs")).importance.index) == [*NAMES, "alpha, beta"]
    x = np.linspace(0, 1, 30)[:, None]
    only = effects(DependentGPRegressor(n_latent=0, optimizer=None).fit(x, np.sin(x[:, 0])))
    assert list(only.importance.index) == list(only.curves) == ["x0"]


@pytest.mark.parametrize(
    "model", [DependentGPRegressor(), make_pipeline(StandardScaler(), DependentGPRegressor())]
)
def test_an_unfitted_model_is_refused(model):
    with pytest.raises(NotFittedError):
        effects(model)


@pytest.mark.parametrize("model", [LinearRegression(), make_pipeline(LinearRegression()), None])
def test_another_estimator_is_refused(model, data):
    if model is not None:
        model.fit(data[0], data[1]["CZ"])
    with pytest.raises(TypeError, match="expected a fitted DependentGPRegressor, or a pipeline"):
        effects(model)
