"""Structures of kernels that a fit compares: shifted outputs, copies, and independent outputs."""

import numpy as np
import pytest
from made_outputs import SHIFTS, translated
from numpy.random import default_rng

from skdgp import DependentGPRegressor
from skdgp.inference import Data, SearchOptions, log_likelihood, search, structure_weights
from skdgp.kernels import ConvolvedGaussian, LinearTrend


def process_of(model):
    """Return the process of the kernel of a fit."""
    return next(term for term in model.kernel_.summands() if isinstance(term, ConvolvedGaussian))


def error_over_spread(predicted, truth):
    return np.mean(np.sqrt(np.mean((predicted - truth) ** 2, axis=0)) / truth.std(axis=0))


@pytest.fixture(scope="module")
def copies():
    """Return a fit to translated copies of one function, points, and the truth there."""
    X, Y, points, truth = translated(default_rng(3), 120)
    return DependentGPRegressor(random_state=0).fit(X, Y), points, truth


class TestShiftedOutputs:
    def test_are_learned_by_default(self, copies):
        model, _, _ = copies
        lags = np.linspace(-4, 4, 801)[:, None]
        for i, shift in enumerate(SHIFTS):
            covariance = process_of(model).block(i, 0, lags, np.zeros((1, 1)))[:, 0]
            assert lags[np.abs(covariance).argmax(), 0] == pytest.approx(shift, abs=0.05)

    def test_fill_the_gaps_of_each_other(self, copies):
        model, points, truth = copies
        mean, std = model.predict(points, return_std=True)
        assert error_over_spread(mean, truth) < 0.1
        assert np.mean(np.abs(mean - truth) < 1.96 * std) > 0.85


def test_outputs_that_are_not_translated_have_no_shift():
    rng = default_rng(1)
    X = rng.uniform(-2, 2, (100, 1))
    F = np.column_stack([np.sin(2 * X[:, 0]), -2.0 * np.sin(2 * X[:, 0])])
    model = DependentGPRegressor(random_state=0).fit(X, F + 0.1 * rng.normal(size=F.shape))
    assert not process_of(model).value("shift").any()


def test_a_kernel_is_at_least_as_likely_as_one_that_it_contains():
    """After as few iterations: widths can all be equal."""
    rng = default_rng(0)
    x = np.sort(rng.uniform(0, 10, 60))
    latent = np.column_stack([np.sin(2 * x), np.cos(3 * x)])
    Y = latent @ rng.normal(size=(2, 3)) + 0.05 * rng.normal(size=(60, 3))
    tied = ConvolvedGaussian(2, covariance_type="tied")
    options = SearchOptions(optimizer="fmin_l_bfgs_b", max_iter=60, random_state=0)
    simple, rich = search([tied, ConvolvedGaussian(2)], x[:, None], Y, options)
    assert rich.log_likelihood >= simple.log_likelihood


def test_hyperparameters_without_effect_are_not_determined():
    """A private amplitude of nearly zero, its widths, and the width of a constant regressor."""
    rng = default_rng(0)
    X = np.column_stack([rng.normal(size=(60, 2)), np.full(60, 3.0)])
    Y = np.column_stack([np.sin(2 * X[:, 0]), np.cos(X[:, 1])]) + 0.3 * rng.normal(size=(60, 2))
    kernel = ConvolvedGaussian(
        feeds=[[1, 1], [0, 1]], covariance_type="tied",
        amplitude=[[1.0, 0.7], [0.0, 1e-6]], length_scale=np.ones((2, 2, 3)),
    )  # fmt: skip
    found = log_likelihood(kernel, np.full(2, 0.1), Data.from_table(X, Y), eval_gradient=True)
    assert len(found.gradient) == 3 + 6 + 2
    assert found.n_determined == 2 + 2 + 2


def test_slopes_by_constant_regressors_have_no_price():
    X, Y = default_rng(0).normal(size=(2, 30, 2))
    options = SearchOptions(optimizer="fmin_l_bfgs_b", max_iter=1, random_state=0)
    prices = []
    for regressors in (X, np.column_stack([X, np.ones(30)])):
        (found,) = search([LinearTrend()], regressors, Y, options)
        prices.append(found.price)
    assert prices[0] > 0
    assert prices[1] == pytest.approx(prices[0])


def test_more_hyperparameters_than_half_of_the_values_pay_four_nats_each():
    """Beside p n / (n - p - 1) of p = n / 2 - 1 (Hurvich & Tsai 1989)."""
    X, Y = default_rng(0).normal(size=(2, 8, 3))
    options = SearchOptions(optimizer="fmin_l_bfgs_b", max_iter=1, random_state=0)
    (found,) = search([ConvolvedGaussian(1)], X, Y[:, :1], options)
    beyond = (found.price - (8 - 2)) / 4
    assert beyond == pytest.approx(round(beyond))
    assert beyond > 0
    assert found.excess == 2.0


def test_weights_are_those_of_akaike():
    scores = [-10.0, -11.0, -9.5, -30.0]
    expected = np.exp([-10.0, -11.0, -9.5])
    weights = structure_weights(scores)
    np.testing.assert_allclose(weights[:3], expected / expected.sum(), rtol=1e-6)
    assert weights[3] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_and_a_fast_part_of_one_output_have_latents_of_their_own(seed):
    """One process alone explains them less likely."""
    rng = default_rng(seed)
    X = rng.uniform(-3, 3, (150, 1))
    y = 2 * np.sin(0.7 * X[:, 0]) + 0.3 * np.sin(9 * X[:, 0]) + 0.1 * rng.normal(size=150)
    one, several = (
        DependentGPRegressor(ConvolvedGaussian(n_latent), random_state=0).fit(X, y)
        for n_latent in (0, 2)
    )
    more = several.log_marginal_likelihood_value_ - one.log_marginal_likelihood_value_
    assert more > 1.0
