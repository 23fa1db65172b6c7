"""A search has converged where further iterations lower no error of predictions, however the likelihood rises."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.exceptions import ConvergenceWarning

from skdgp import DependentGPRegressor
from skdgp.inference import Data, SearchSettings, fit_exact, held_out_error
from skdgp.kernels import ConvolvedGaussian

N = 60
ERROR_ALONE = SearchSettings(irrelevant_rise=0.0, relevant_rise=np.inf)


@pytest.fixture(scope="module")
def tables():
    """X (N, 2), a function without noise (N, 1), and the same beside two outputs of noise alone (N, 3)."""
    rng = default_rng(0)
    X = rng.uniform(-2, 2, (N, 2))
    y = np.sin(2 * X[:, :1]) + np.cos(2 * X[:, 1:])
    return X, y, np.column_stack([y, rng.normal(size=(N, 2))])


def start(Y, width, d=2):
    P = Y.shape[1]
    return ConvolvedGaussian(0, amplitude=np.eye(P), length_scale=np.full((P, P, d), width))


def searched(X, Y, max_iter, width, settings=ERROR_ALONE, **options):
    """Return the hyperparameters of a search from a start that no other stage changes."""
    options |= {"optimizer": "fmin_l_bfgs_b", "random_state": 0, "max_iter": max_iter}
    return fit_exact(start(Y, width, X.shape[1]), X, Y, settings=settings, **options).learned


def error_of(learned, X, Y, n_blocks=None):
    return held_out_error(learned.kernel, learned.noise, Data.from_table(X, Y), n_blocks)


def test_has_converged_where_the_likelihood_alone_rises(tables):
    """The fit of the function becomes perfect, which hardly counts beside the noise of the others."""
    X, _, Y = tables
    few = searched(X, Y, 12, 0.5)
    many = searched(X, Y, 24, 0.5)
    assert many.log_likelihood > few.log_likelihood + 0.05 * Y.size
    assert_allclose(error_of(many, X, Y), error_of(few, X, Y), rtol=0.05)
    assert few.converged


def test_goes_on_as_long_as_the_error_falls(tables):
    X, y, Y = tables
    few = searched(X, y, 10, 0.05)
    further = searched(X, y, 10, 0.05, further=4)
    assert not few.converged
    assert 10 < further.n_iter <= 50
    assert further.converged
    assert error_of(further, X, y) < 0.5 * error_of(few, X, y)
    assert searched(X, Y, 12, 0.5, further=4).n_iter == 12


def test_of_a_time_series_the_errors_of_held_out_blocks_count():
    """Of random walks, neighbours in time predict each value better and better; blocks are predicted as before."""
    rng = default_rng(2)
    X = np.cumsum(rng.normal(size=(N, 4)), axis=0)
    X = (X - X.mean(axis=0)) / X.std(axis=0)
    Y = np.cumsum(rng.normal(size=(N, 2)), axis=0)
    settings = SearchSettings(irrelevant_rise=0.0, relevant_rise=np.inf, n_blocks=4)
    few, many = (searched(X, Y, n, 3.0, settings, time_series=True) for n in (12, 40))
    assert_allclose(error_of(many, X, Y, 4), error_of(few, X, Y, 4), rtol=0.02)
    assert few.converged
    assert not searched(X, Y, 12, 3.0, settings).converged


def test_regressor_warns_of_too_few_iterations_alone(tables):
    """What warns is an error in all tests: twenty iterations say nothing, though the likelihood rises yet."""
    X, _, Y = tables
    model = DependentGPRegressor(start(Y, 0.5), structure="joint", trend=None, random_state=0)
    with pytest.warns(ConvergenceWarning, match="stopped at max_iter=6 before it converged"):
        model.set_params(max_iter=6).fit(X, Y)
    assert not model.converged_
    likelihoods = []
    for max_iter in (20, 40):
        model.set_params(max_iter=max_iter).fit(X, Y)
        assert model.converged_
        likelihoods.append(model.log_marginal_likelihood_value_)
    assert likelihoods[1] > likelihoods[0]
