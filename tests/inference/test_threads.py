"""Predictions of few values at few points keep BLAS on one thread: two wait for each other on a busy machine."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from skdgp import DependentGPRegressor
from skdgp._compute.parallel import n_threads
from skdgp.inference import function_errors, slope_errors

NEW = np.array([[0.3, -0.2]])
CALLS = {
    "mean": lambda posterior: posterior.predict(NEW),
    "variance": lambda posterior: posterior.predict(NEW, True),
    "covariance": lambda posterior: posterior.covariance(NEW),
    "gradient": lambda posterior: posterior.gradient(NEW, True),
    "paths": lambda posterior: posterior.paths(3, 0),
    "values of paths": lambda posterior: posterior.paths(3, 0)(NEW),
    "slopes of paths": lambda posterior: posterior.paths(3, 0).gradient(NEW),
    "slope errors": lambda posterior: slope_errors(posterior, NEW),
    "function errors": function_errors,
}


@pytest.fixture(scope="module", params=["exact", "sparse"])
def posterior(request):
    X = np.random.default_rng(0).normal(size=(80, 2))
    model = DependentGPRegressor(inference=request.param, n_inducing=9, n_latent=1, optimizer=None)
    return model.fit(X, np.column_stack([np.sin(X[:, 0]), X[:, 1]])).posterior_


@pytest.mark.parametrize("call", CALLS)
def test_one_thread(posterior, call, monkeypatch):
    found = []

    def seen(function):
        def recorded(*arguments, **options):
            found.append(n_threads())
            return function(*arguments, **options)

        return recorded

    for module, name in (
        (np, "einsum"),
        (np, "exp"),
        (np, "cos"),
        (np, "sqrt"),
        (np.linalg, "pinv"),
    ):
        monkeypatch.setattr(module, name, seen(getattr(module, name)))
    with threadpool_limits(2, user_api="blas"):
        if n_threads() != 2:
            pytest.skip("this BLAS does not run on two threads")
        CALLS[call](posterior)
        assert n_threads() == 2
    assert set(found) == {1}
