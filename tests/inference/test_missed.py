"""Effects that a search missed: how far they raise the likelihood, and what a model finds by them."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal
from sklearn.gaussian_process.kernels import RBF

from skdgp import DependentGPRegressor
from skdgp.inference import Data, missed_effects
from skdgp.kernels import ConvolvedGaussian

NOISE = np.array([0.3, 0.2])


def independent(n_regressors):
    """A process of the first regressor alone for each of two outputs."""
    lengths = np.full((2, 2, n_regressors), 1e3)
    lengths[..., 0] = 1.5
    return ConvolvedGaussian(0, amplitude=np.eye(2), length_scale=lengths)


def drawn(seed, size=0.0):
    """Samples of these processes, with a sine of the second regressor in the second output."""
    rng = default_rng(seed)
    X = rng.normal(size=(120, 2))
    K = RBF(1.5)(X[:, :1]) + 1e-9 * np.eye(len(X))
    functions = np.linalg.cholesky(K) @ rng.normal(size=(len(X), 2))
    functions[:, 1] += size * np.sin(2.0 * X[:, 1])
    return X, functions + np.sqrt(NOISE) * rng.normal(size=functions.shape)


def test_rise_is_that_of_the_likelihood_with_the_process():
    """By SciPy's normal distribution with covariances of scikit-learn; no other variance rises farther."""
    X, Y = drawn(0, size=1.0)
    (effect,) = missed_effects(independent(2), NOISE, [Data.from_table(X, Y)], X)
    assert (effect.output, effect.regressor) == (1, 1)
    without = RBF(1.5)(X[:, :1]) + NOISE[1] * np.eye(len(X))
    C = RBF(effect.width)(X[:, 1:])

    def rise(variance):
        density = multivariate_normal(cov=without + variance * C).logpdf(Y[:, 1])
        return density - multivariate_normal(cov=without).logpdf(Y[:, 1])

    assert_allclose(effect.rise, rise(effect.variance), rtol=0.001)
    best = minimize_scalar(lambda log_v: -rise(np.exp(log_v)), bounds=(-5, 5), method="bounded")
    assert -best.fun - 0.5 < effect.rise <= -best.fun + 0.01


def test_batches_add_up():
    """Two batches of the same samples have twice the rise of one, at the same variance."""
    X, Y = drawn(0, size=1.0)
    data = Data.from_table(X, Y)
    (once,) = missed_effects(independent(2), NOISE, [data], X)
    (twice,) = missed_effects(independent(2), NOISE, [data, data], X)
    assert_allclose(twice.rise, 2 * once.rise, rtol=1e-12)
    assert_allclose(twice.variance, once.variance, rtol=1e-12)


def test_nothing_is_missed_in_samples_of_the_kernel():
    found = 0
    for seed in range(20):
        X, Y = drawn(seed)
        found += len(missed_effects(independent(2), NOISE, [Data.from_table(X, Y)], X))
    assert found <= 1  # of 40 outputs


def test_batches_hold_each_sample_once_with_all_its_outputs():
    X, Y = drawn(0)
    Y[::3, 0] = np.nan
    batches = Data.from_table(X, Y).every(1).batches(3)
    for output in (0, 1):
        samples = np.concatenate([batch.sample[output] for batch in batches])
        values = np.concatenate([batch.y[output] for batch in batches])
        observed = np.flatnonzero(np.isfinite(Y[:, output]))
        assert_allclose(np.sort(samples), observed)
        assert_allclose(values, Y[samples, output])
    for batch in batches:
        assert np.isin(batch.sample[0], batch.sample[1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("random_state", [0, 2])
def test_bands_of_many_rows_hold_from_any_start(random_state):
    """A search from these two starts ends without the third regressor of the first output."""
    rng = default_rng([1, 3, 2000])
    W = rng.normal(size=(3, 2)) / np.sqrt(3)
    X = rng.normal(size=(2000, 3))

    def function(x):
        waves = np.sin(1.5 * x[:, :1]) * [1.0, -0.5]
        return x @ W + waves + np.cos(1.2 * x[:, 2:]) * [0.25, 0.5]

    Y = function(X) + rng.normal(0, 0.5, (2000, 2))
    model = DependentGPRegressor(random_state=random_state).fit(X, Y)
    Z = rng.normal(size=(500, 3))
    mean, std = model.predict(Z, return_std=True)
    over_std = (mean - function(Z)) / std
    assert np.sqrt(np.mean(over_std**2)) < 1.5
    assert np.mean(np.abs(over_std) < 1.96) > 0.85
