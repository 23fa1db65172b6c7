"""A trend in the columns of a transformer: Bayesian linear regression, in every kind of inference."""

import pickle

import numpy as np
import pytest
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.feature_selection import SelectKBest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    FunctionTransformer,
    PolynomialFeatures,
    SplineTransformer,
    StandardScaler,
)

from skdgp import DependentGPRegressor
from skdgp.inference import Data, ExactPosterior
from skdgp.kernels import BasisTrend, ConvolvedGaussian, LinearTrend

TINY = {"amplitude": np.full((1, 2), 1e-8), "amplitude_bounds": "fixed"}
TRANSFORMERS = {
    "polynomials": PolynomialFeatures(2),
    "splines": SplineTransformer(4),
    "sparse columns": SplineTransformer(4, sparse_output=True),
    "pipeline": make_pipeline(StandardScaler(), PolynomialFeatures(3)),
    "table": PolynomialFeatures(2).set_output(transform="pandas"),
}


@pytest.fixture(scope="module")
def data():
    """Two quadratic functions of two regressors, which are not observed everywhere."""
    rng = np.random.default_rng(0)
    X = rng.uniform([2.0, -1.0], [4.0, 1.0], (60, 2))
    Y = truth(X) + rng.normal(0, 0.05, (60, 2))
    Y[40:, 1] = np.nan
    return X, Y


def truth(X):
    x, z = X.T
    return np.column_stack([1 + x**2 - x * z, 2 * z**2 - z])


def weights_of(model, phi, y, i, noise):
    """Return mean and covariance of output i's weights: equation 2.8 of Rasmussen & Williams, from normalised y."""
    trend = model.kernel_.k1
    scale = np.append(trend.intercept_scale[i], trend.slope_scale[i])
    cov = np.linalg.inv(phi.T @ phi / noise + np.diag(scale**-2.0))
    return cov @ phi.T @ y / noise, cov


@pytest.fixture(scope="module")
def model(data):
    """A trend, and processes that are as good as nothing."""
    kernel = ConvolvedGaussian(1, private_latents=False, **TINY)
    trend = PolynomialFeatures(2, include_bias=False)
    return DependentGPRegressor(kernel, trend=trend, structure="joint", random_state=0).fit(
        *data
    )  # of one noise


class TestIsBayesianLinearRegression:
    def test_mean_and_deviation(self, data, model):
        X, Y = data
        new = np.random.default_rng(1).normal([3.0, 0.0], 1.0, (7, 2))
        mean, std = model.predict(new, return_std=True)
        phi, there = (
            PolynomialFeatures(2, include_bias=False).fit(X).transform(x) for x in (X, new)
        )
        center = phi.mean(axis=0)
        phi, there = (np.column_stack([np.ones(len(p)), p - center]) for p in (phi, there))
        for i in range(2):
            seen = np.isfinite(Y[:, i])
            middle, scale = np.mean(Y[seen, i]), np.std(Y[seen, i])
            w, cov = weights_of(
                model,
                phi[seen],
                (Y[seen, i] - middle) / scale,
                i,
                model.noise_variance_[i] / scale**2,
            )
            np.testing.assert_allclose(mean[:, i], middle + scale * there @ w, rtol=1e-6)
            variance = np.einsum("nk,kl,nl->n", there, cov, there)
            np.testing.assert_allclose(std[:, i], scale * np.sqrt(variance), rtol=1e-5)


def test_a_linear_trend_is_the_trend_in_the_regressors_themselves(data):
    X, Y = data
    own = DependentGPRegressor(n_latent=1, random_state=0, max_iter=15).fit(X, Y)
    same = DependentGPRegressor(
        n_latent=1, random_state=0, max_iter=15, trend=FunctionTransformer()
    ).fit(X, Y)
    np.testing.assert_allclose(same.predict(X), own.predict(X), rtol=1e-5)
    assert isinstance(own.kernel_.k1, LinearTrend)


def test_a_constant_column_changes_nothing(data):
    X, Y = data
    options = {"optimizer": None, "random_state": 0}
    bias, none = (PolynomialFeatures(2, include_bias=with_bias) for with_bias in (True, False))
    first, second = (
        ExactPosterior(kernel, np.full(2, 0.1), Data.from_table(X, Y)).predict(X)
        for kernel in (
            BasisTrend(transformer, np.ones(2), np.ones((2, K))).initialize(X, Y, 0)
            for transformer, K in ((bias, 6), (none, 5))
        )
    )
    np.testing.assert_allclose(first, second)
    assert np.isfinite(DependentGPRegressor(trend=bias, **options).fit(X, Y).predict(X)).all()


class TestInEveryInference:
    @pytest.mark.parametrize("transformer", TRANSFORMERS.values(), ids=TRANSFORMERS)
    def test_of_any_transformer(self, data, transformer):
        X, Y = data
        model = DependentGPRegressor(
            n_latent=1, trend=transformer, optimizer=None, random_state=0
        ).fit(X, Y)
        mean, std = model.predict(X, return_std=True)
        assert np.nanmean((mean - Y) ** 2) < 0.1
        assert np.isfinite(std).all()
        assert np.isfinite(model.predict_gradient(X[:3])).all()
        np.testing.assert_allclose(
            pickle.loads(pickle.dumps(model)).predict(X), model.predict(X), rtol=1e-9, atol=1e-10
        )

    def test_sparse(self, data):
        X, Y = data
        model = DependentGPRegressor(
            n_latent=1, trend=PolynomialFeatures(2), random_state=0, max_iter=10
        ).fit(X, Y)
        sparse = clone(model).set_params(inference="sparse", n_inducing=20).fit(X, Y)
        np.testing.assert_allclose(sparse.predict(X), truth(X), atol=0.3)

    def test_is_searched_and_left_as_it_was(self, data):
        transformer = PolynomialFeatures(1)
        model = DependentGPRegressor(trend=transformer, optimizer=None).set_params(trend__degree=3)
        assert model.fit(*data).kernel_.k1.slope_scale.shape == (2, 10)
        assert not hasattr(transformer, "n_output_features_")


class NotFinite(TransformerMixin, BaseEstimator):
    """Columns with holes."""

    def fit(self, X, y=None):
        return self

    def transform(self, X):
        return np.full((len(X), 2), np.nan)


class TestRefused:
    @pytest.mark.parametrize("trend", ["quadratic", 2, np.sin, StandardScaler.fit])
    def test_what_is_no_transformer(self, data, trend):
        with pytest.raises(ValueError, match="'trend' parameter of DependentGPRegressor must be"):
            DependentGPRegressor(trend=trend).fit(*data)

    @pytest.mark.parametrize("transformer", [PolynomialFeatures, 2, np.sin])
    def test_what_is_no_instance(self, data, transformer):
        with pytest.raises(TypeError, match="expected an instance of a scikit-learn transformer"):
            BasisTrend(transformer).initialize(*data, 0)

    def test_columns_that_are_not_finite(self, data):
        with pytest.raises(ValueError, match=r"columns of shape \(60, 2\) from NotFinite.*finite"):
            DependentGPRegressor(trend=NotFinite()).fit(*data)

    def test_transformers_that_need_targets(self, data):
        with pytest.raises((ValueError, TypeError), match="y"):
            DependentGPRegressor(trend=SelectKBest(k=1)).fit(*data)

    def test_values_before_a_fit(self, data):
        with pytest.raises(
            ValueError, match=r"transformer of BasisTrend.*not fitted yet: call initialize"
        ):
            BasisTrend(PolynomialFeatures(2), [1.0], [[1.0, 1.0]])(data[0])


class TestStructure:
    """A trend alone, or with a function of each regressor and the joint process."""

    @pytest.fixture
    def sample(self):
        rng = np.random.default_rng(0)
        X = rng.uniform(-2, 2, (60, 4))
        return X, np.sin(3 * X).sum(axis=1) + rng.normal(0, 0.05, 60)

    @pytest.mark.filterwarnings("ignore:40 inducing inputs leave")
    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_learns_a_sum_from_few_samples(self, sample, inference):
        X, y = sample
        new = np.random.default_rng(1).uniform(-1.8, 1.8, (200, 4))
        errors = {}
        for structure in ("joint", "additive"):
            options = {
                "structure": structure,
                "inference": inference,
                "n_latent": 0,
                "n_inducing": 40,
                "max_iter": 100,
            }
            model = DependentGPRegressor(**options, random_state=0).fit(X, y)
            errors[structure] = np.sqrt(
                np.mean((model.predict(new) - np.sin(3 * new).sum(axis=1)) ** 2)
            )
        assert errors["additive"] < 0.5 * errors["joint"]

    @pytest.mark.parametrize("trend", ["linear", "constant"])
    def test_goes_with_any_trend(self, sample, trend):
        X, y = sample
        model = DependentGPRegressor(
            structure="additive", trend=trend, n_latent=0, optimizer=None
        ).fit(X, y)
        parts = [
            part
            for part in model.kernel_.get_params().values()
            if isinstance(part, ConvolvedGaussian)
        ]
        assert sorted(part.regressors for part in parts if part.regressors) == [[0], [1], [2], [3]]

    @pytest.mark.parametrize(
        "options", [{"kernel": ConvolvedGaussian(1)}, {"trend": "constant"}, {"trend": None}]
    )
    def test_a_trend_alone_needs_a_trend(self, sample, options):
        with pytest.raises(ValueError, match="structure='trend'"):
            DependentGPRegressor(structure="trend", **options).fit(*sample)

    def test_refuses_a_kernel(self, sample):
        with pytest.raises(
            ValueError, match=r"structure='additive' with kernel=.*expected kernel=None"
        ):
            DependentGPRegressor(structure="additive", kernel=ConvolvedGaussian(1)).fit(*sample)
