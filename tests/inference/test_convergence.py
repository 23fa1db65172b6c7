"""A search has converged at a stationary point, or at bounds, and says so where it has not."""

import numpy as np
import pytest
from numpy.random import default_rng
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from skdgp import DependentGPRegressor

N = 60


@pytest.fixture(scope="module")
def table():
    rng = default_rng(0)
    X = rng.uniform(-2, 2, (N, 2))
    y = np.sin(2 * X[:, :1]) + np.cos(2 * X[:, 1:])
    return X, np.column_stack([y, rng.normal(size=(N, 2))])


@pytest.mark.parametrize(
    "kernel", [RBF(1.0), RBF([1.0, 1.0]), Matern(1.0, nu=1.5), Matern([1.0, 1.0], nu=2.5)]
)
def test_a_kernel_of_scikit_learn_ends_at_least_as_high_as_there(kernel, table):
    X, Y = table
    y = Y[:, 0] + 0.1 * default_rng(1).normal(size=N)
    y = (y - y.mean()) / y.std()
    theirs = GaussianProcessRegressor(ConstantKernel() * kernel + WhiteKernel(0.2)).fit(X, y)
    ours = DependentGPRegressor(
        kernel, trend=None, structure="joint", noise_variance_bounds=(1e-5, 1e5)
    )
    ours.fit(X, y)
    assert ours.converged_
    assert ours.log_marginal_likelihood_value_ > theirs.log_marginal_likelihood_value_ - 0.01


def in_another_form(X, Y):
    """Return rows, regressors and outputs in another order, signs and units, with rounding and constants beside."""
    rounded = X + 1e-12 * default_rng(7).normal(size=X.shape)
    turned = -rounded[::-1, ::-1] * [1e6, 1.0, 3e-4]
    return np.insert(turned, [0, 3], [-7.0, 0.6], axis=1), Y[::-1, ::-1]


def levels(X):
    """Return regressors of few levels, of which two add up to a third one: rows and neighbours are equally far."""
    X = np.round(X)
    X[:, 2] = X[:, 0] + X[:, 1]
    return X


@pytest.fixture(scope="module", params=[np.array, levels], ids=["continuous", "levels"])
def usual(request):
    """Return a table, and what is predicted from it of its rows."""
    rng = default_rng(3)
    X = request.param(rng.normal(size=(50, 3)))
    Y = np.column_stack([np.sin(X[:, 0]) + X[:, 1], X[:, 0] * X[:, 2]])
    Y += rng.normal(0, 0.1, Y.shape)
    return X, Y, *DependentGPRegressor(random_state=0).fit(X, Y).predict(X, return_std=True)


@pytest.mark.filterwarnings("ignore:The regressors .* constant")
def test_the_same_table_in_another_form_has_the_same_model(usual):
    """By another seed as well."""
    X, Y, mean, std = usual
    Xc, Yc = in_another_form(X, Y)
    found = DependentGPRegressor(random_state=1).fit(Xc, Yc).predict(Xc)
    expected, spread = (in_another_form(X, values)[1] for values in (mean, std))
    assert np.max(np.abs(found - expected) / spread) < 0.05


@pytest.mark.parametrize("move", [0.0, 1e-12])
def test_inducing_inputs_are_the_same_by_any_seed(move):
    rng = default_rng(0)
    x = np.sort(rng.uniform(0, 8, 200))[:, None]
    y = np.sin(2 * x[:, 0]) + rng.normal(0, 0.1, 200)
    sparse = DependentGPRegressor(
        inference="sparse", n_inducing=8, input_noise=None, random_state=0
    )
    mean, std = sparse.fit(x, y, time=x[:, 0]).predict(x, return_std=True)
    again = sparse.set_params(random_state=1).fit(x * (1.0 + move), y, time=x[:, 0]).predict(x)
    assert np.max(np.abs(again - mean) / std) < 0.05
