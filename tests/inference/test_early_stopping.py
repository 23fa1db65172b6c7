"""Early stopping: hyperparameters are learned until the error of held-out blocks no longer falls."""

import warnings

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning

from skdgp import DependentGPRegressor
from skdgp.inference import Data, _search, fit_exact, log_likelihood, maximize
from skdgp.kernels import ConvolvedGaussian

N = 300
TIME = 0.1 * np.arange(N)


@pytest.fixture(scope="module")
def log():
    """Two noisy outputs of one of four regressors: the likelihood goes on to rise where errors have stopped to fall."""
    rng = np.random.default_rng(3)
    X = rng.uniform(-2, 2, (N, 4))
    Y = np.column_stack([np.sin(2 * X[:, 0]), X[:, 0] ** 2]) + rng.normal(0, 0.4, (N, 2))
    Y[rng.random(Y.shape) < 0.1] = np.nan
    return X, Y


def make(**options):
    """Return a model of all terms, with exact regressors; it stops early where rows have a time."""
    given = {
        "n_latent": 1,
        "structure": "joint",
        "input_noise": None,
        "max_iter": 60,
        "random_state": 0,
    }
    return DependentGPRegressor(**(given | options))


@pytest.fixture(scope="module", params=["exact", "sparse"])
def stopped(request, log):
    return make(inference=request.param, n_inducing=15, max_iter=500).fit(*log, time=TIME)


def test_stops_earlier_and_has_converged(log, stopped):
    assert stopped.converged_
    assert stopped.n_iter_ < clone(stopped).set_params(max_iter=60).fit(*log).n_iter_


def test_the_noise_is_learned_to_the_end(log, monkeypatch):
    """Of exact inference, which does not estimate it from all samples: bands must not depend on where a search ends."""
    X, Y = log
    monkeypatch.setattr(_search, "PATIENCE", 1)
    monkeypatch.setattr(_search, "LEAST_GAIN", 1.0)  # the search ends after two iterations
    options = {"optimizer": "fmin_l_bfgs_b", "max_iter": 60, "random_state": 0}
    fit = fit_exact(ConvolvedGaussian(1), X, Y, stop_early=True, **options)
    data = Data.from_table(X, Y)
    slope = log_likelihood(fit.posterior.kernel, fit.learned.noise, data, eval_gradient=True)[1][
        -2:
    ]
    assert np.abs(slope).max() < 1e-3 * data.n_values


def test_the_posterior_knows_the_held_out_rows(log, stopped):
    X, Y = log
    held = _search.held_out_rows(Y, np.random.RandomState(0))[1]
    fewer = clone(stopped).set_params(optimizer=None).fit(X, Y)
    without = clone(fewer).fit(np.delete(X, held, axis=0), np.delete(Y, held, axis=0))
    assert (
        fewer.predict(X[held], return_std=True)[1].mean()
        < without.predict(X[held], return_std=True)[1].mean()
    )


@pytest.mark.parametrize(
    "options",
    [
        {"kernel": ConvolvedGaussian(1, covariance_type="tied")},
        {"optimizer": lambda objective, theta, bounds: (theta, objective(theta)[0])},
        {"input_noise": "learned"},
        {"structure": "trend"},
        {"structure": "additive"},
        {"structure": "average"},
    ],
    ids=["kernel", "optimizer", "noisy regressors", "trend", "additive", "average"],
)
def test_goes_with(log, options):
    X, Y = log
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = make(max_iter=8, **options).fit(X[:240], Y[:240], time=TIME[:240])
    assert np.isfinite(model.predict(X[:5], return_std=True)).all()
    if "optimizer" in options:
        assert model.converged_


def test_few_rows_are_all_learned_from(log):
    X, Y = log
    options = {
        "kernel": ConvolvedGaussian(1),
        "max_iter": 10,
        "inference": "exact",
    }  # without a log's smallest widths
    first, other = (
        make(**options).fit(X[:60], Y[:60], time=time).predict(X) for time in (TIME[:60], None)
    )
    np.testing.assert_allclose(first, other, rtol=1e-9, atol=1e-9)


class TestBlocks:
    @pytest.mark.parametrize("n", [250, 1000, 5000])
    def test_are_five_with_a_fifth_of_the_log_and_apart_from_what_is_learned(self, n):
        learned, held = _search.held_out_rows(np.zeros((n, 1)), np.random.RandomState(1))
        blocks = np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)
        assert len(blocks) == 5
        assert len(held) == pytest.approx(0.2 * n, abs=5)
        gap = 0.1 * len(held) / 5
        assert np.abs(np.subtract.outer(held, learned)).min() >= max(1, np.floor(gap))
        assert len(learned) <= _search.SEARCH_VALUES[0]
        for k, block in enumerate(blocks):  # one in each fifth of the log
            assert k * n / 5 <= block[0] <= block[-1] < (k + 1) * n / 5

    def test_hold_values_of_each_output_or_nothing(self):
        Y = np.zeros((500, 2))
        Y[40:, 1] = np.nan
        rows, held = _search.held_out_rows(Y, np.random.RandomState(0))
        assert held is None
        assert len(rows) == 500


def test_the_search_stops_five_iterations_after_the_last_fall_by_a_hundredth():
    """On a long narrow valley, with errors that fall for eight iterations and then by less than 1 % in five."""
    errors = iter([*np.linspace(1.0, 0.6, 8), *(0.6 - 0.0005 * np.arange(100))])

    def valley(theta):
        x, y = theta
        slope = np.array([-400 * x * (y - x**2) - 2 * (1 - x), 200 * (y - x**2)])
        return -(100 * (y - x**2) ** 2 + (1 - x) ** 2), -slope

    options = {"max_iter": 100, "held_out_error": lambda theta: next(errors)}
    best = maximize(valley, np.array([-1.2, 1.0]), np.array([[-5.0, 5.0]] * 2), **options)
    assert best.n_iter == 13
    assert best.converged
