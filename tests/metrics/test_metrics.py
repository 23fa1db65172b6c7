"""Metrics against references typed from their definitions, and scorers inside scikit-learn's machinery."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import norm
from sklearn import config_context
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.compose import TransformedTargetRegressor
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from skdgp.metrics import (
    SCORERS,
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)

METRICS = [
    median_relative_error,
    normalized_rmse,
    negative_log_predictive_density,
    interval_coverage,
]
WITH_STD = METRICS[2:]


def sample(n=40, outputs=3):
    rng = default_rng(0)
    y = rng.normal(1, 2, (n, outputs))
    return y, y + rng.normal(0, 0.5, y.shape), rng.uniform(0.2, 1.0, y.shape)


def value(metric, y, mean, std, **options):
    """Return the value of a metric, with or without standard deviations."""
    return metric(y, mean, *[std] * (metric in WITH_STD), **options)


def reference(metric, y, mean, std):
    """Typed from the docstrings, of one output."""
    seen = ~np.isnan(y)
    y, mean, std = y[seen], mean[seen], std[seen]
    if metric is median_relative_error:
        return np.median(np.abs(y - mean) / np.abs(y))
    if metric is normalized_rmse:
        return np.sqrt(np.mean((y - mean) ** 2) / np.var(y))
    if metric is negative_log_predictive_density:
        return -norm.logpdf(y, mean, std).mean()
    return np.mean(np.abs(y - mean) < 1.959963984540054 * std)


@pytest.mark.parametrize("metric", METRICS)
class TestEveryMetric:
    @pytest.mark.parametrize("n", [39, 40])
    def test_reference_with_missing_targets(self, metric, n):
        y, mean, std = sample(n)
        y[default_rng(1).random(y.shape) < 0.3] = np.nan
        expected = [reference(metric, *column) for column in zip(y.T, mean.T, std.T, strict=True)]
        assert_allclose(value(metric, y, mean, std, multioutput="raw_values"), expected, rtol=1e-12)
        assert_allclose(value(metric, y, mean, std), np.mean(expected), rtol=1e-12)

    def test_shapes_and_types_do_not_matter(self, metric):
        y, mean, std = sample(outputs=1)
        flat = value(metric, y.ravel(), mean.ravel(), std.ravel())
        assert isinstance(flat, float)
        assert_allclose(value(metric, y, mean, std), flat, rtol=1e-12)
        assert_allclose(value(metric, *map(pd.DataFrame, (y, mean, std))), flat, rtol=1e-12)

    def test_output_never_observed(self, metric):
        y, mean, std = sample()
        y[:, 1] = np.nan
        with pytest.warns(UndefinedMetricWarning, match=r"Output \[1\] is never observed"):
            raw = value(metric, y, mean, std, multioutput="raw_values")
        assert np.isnan(raw).tolist() == [False, True, False]
        with pytest.warns(UndefinedMetricWarning):
            assert_allclose(value(metric, y, mean, std), np.mean(raw[[0, 2]]))

    def test_predictions_have_the_shape_and_are_finite(self, metric):
        y, mean, std = sample()
        with pytest.raises(ValueError, match="of shape"):
            value(metric, y, mean[:-1], std)
        mean[3, 0] = np.nan
        with pytest.raises(ValueError, match="1 values of y_pred that are not finite"):
            value(metric, y, mean, std)


class TestMeaning:
    def test_constant_target_has_no_scale(self):
        with pytest.warns(UndefinedMetricWarning, match=r"Output \[0\] is constant"):
            assert np.isnan(normalized_rmse([2.0, 2.0], [2.0, 2.1]))

    def test_a_zero_target_that_is_met_has_no_error(self):
        assert median_relative_error([0.0, 0.0, 1.0], [0.0, 0.0, 2.0]) == 0.0

    @pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
    def test_coverage_of_honest_bands_is_their_level(self, level):
        rng = default_rng(0)
        std = rng.uniform(0.1, 2, 20_000)
        y = rng.normal(0, std)
        assert_allclose(interval_coverage(y, 0 * y, std, level=level), level, rtol=0, atol=0.01)


class NoisyModel(RegressorMixin, BaseEstimator):
    """Predict 0 with a latent deviation of 1, and of 2 with measurement noise."""

    def fit(self, X, y):
        self.shape_ = np.shape(y)[1:]
        return self

    def predict(self, X, return_std=False, include_noise=False, include_input_noise=False):
        mean = np.zeros((len(X), *self.shape_))
        return (mean, mean + (2.0 if include_noise else 1.0)) if return_std else mean


class TestScorers:
    @pytest.mark.parametrize("routing", [False, True])
    def test_scores_do_not_depend_on_metadata_routing(self, routing):
        """A pipeline passes the scorers' wish for standard deviations on, whatever it would route."""
        X = default_rng(0).normal(size=(40, 1))
        y = np.full(40, 1.5)
        models = [NoisyModel(), make_pipeline(StandardScaler(), NoisyModel())]
        density = -0.5 * np.log(2 * np.pi * 2.0**2) - 0.5 * (1.5 / 2.0) ** 2  # std 2, mean 0
        wanted = {
            "log_predictive_density": density,
            "interval_coverage": 1.0,
            "neg_median_relative_error": -1.0,
        }
        with config_context(enable_metadata_routing=routing):
            for model in models:
                options = {"scoring": SCORERS, "cv": 2, "error_score": "raise"}
                scores = cross_validate(model, X, y + 1e-6 * X[:, 0], **options)
                for name, expected in wanted.items():
                    assert_allclose(scores[f"test_{name}"], expected, rtol=1e-4)

    def test_a_row_counts_if_any_of_its_targets_is_known(self):
        """Of two outputs the second lacks most rows, and a few rows lack both."""
        X = np.arange(50.0)[:, None]
        Y = np.column_stack([X[:, 0], X[:, 0] ** 2])
        model = LinearRegression().fit(X, Y)
        Y[::7], Y[::3, 1] = np.nan, np.nan
        expected = []
        for y, predicted in zip(Y.T, model.predict(X).T, strict=True):
            error = np.sqrt(np.nanmean((y - predicted) ** 2))
            expected.append(-error / np.nanstd(y))
        assert_allclose(SCORERS["neg_normalized_rmse"](model, X, Y), np.mean(expected))

    def test_what_holds_transformers_is_asked_for_every_row(self):
        X = np.arange(50.0)[:, None]
        y = np.where(np.arange(50) % 5 == 1, X[:, 0], np.nan)
        center = FunctionTransformer(lambda X: X - X.mean())  # feels which rows it is given
        inner = make_pipeline(center, LinearRegression())
        model = make_pipeline(FunctionTransformer(), TransformedTargetRegressor(inner)).fit(
            X, X[:, 0]
        )
        for estimator in (model, model[-1]):
            assert_allclose(SCORERS["neg_normalized_rmse"](estimator, X, y), 0, atol=1e-9)

    def test_std_is_demanded(self):
        model = LinearRegression().fit([[0.0], [1.0]], [0.0, 1.0])
        with pytest.raises(TypeError, match="LinearRegression, whose predict takes no return_std"):
            SCORERS["log_predictive_density"](model, [[0.0]], [0.0])
