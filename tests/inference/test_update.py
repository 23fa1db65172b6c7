"""Further values: the same posterior as from all values at once."""

import pickle

import numpy as np
import pytest

from skdgp.inference import Data, ExactPosterior, SparsePosterior, _exact, shares_of
from skdgp.inference._exact import Factor

NEW = np.random.default_rng(5).normal(size=(6, 2))
Z = np.random.default_rng(6).normal(size=(7, 2))


def exact(problem, data):
    return ExactPosterior(problem.kernel, problem.noise, data)


def sparse(problem, data):
    return SparsePosterior(
        problem.kernel, problem.kernel.features(Z), problem.noise, shares_of(data)
    )


def compact(problem, data):
    return sparse(problem, data).without_samples()


def batches(problem, sizes, seed=1):
    """Further samples, some outputs observed at none of a batch."""
    rng = np.random.default_rng(seed)
    for n in sizes:
        Y = rng.normal(size=(n, 3))
        Y[rng.random(Y.shape) < 0.4] = np.nan
        yield Data.from_table(rng.normal(size=(n, 2)), Y)


def assert_same(posterior, reference, rtol=1e-8):
    assert posterior.log_marginal_likelihood == pytest.approx(
        reference.log_marginal_likelihood, rel=rtol
    )
    for got, expected in zip(
        (
            *posterior.predict(NEW, True),
            posterior.predict(NEW),
            posterior.covariance(NEW),
            *posterior.gradient(NEW, True),
        ),
        (
            *reference.predict(NEW, True),
            reference.predict(NEW),
            reference.covariance(NEW),
            *reference.gradient(NEW, True),
        ),
        strict=True,
    ):
        np.testing.assert_allclose(got, expected, rtol=rtol, atol=1e-9)


@pytest.mark.parametrize("make", [exact, sparse, compact])
class TestUpdated:
    @pytest.mark.parametrize("sizes", [[9], [1, 1, 1, 1, 1, 1], [2, 30, 1, 0, 5]])
    def test_is_the_posterior_of_everything(self, problem, make, sizes):
        posterior, data = make(problem, problem.data), problem.data
        for more in batches(problem, sizes):
            posterior, data = posterior.updated(more), data.joined(more)
        assert_same(posterior, make(problem, data))

    def test_leaves_the_former_one_alone(self, one_problem, make):
        posterior = make(one_problem, one_problem.data)
        before = posterior.predict(NEW, True)
        posterior.updated(next(batches(one_problem, [4])))
        np.testing.assert_allclose(posterior.predict(NEW, True), before, rtol=1e-9, atol=1e-10)

    def test_goes_on_after_a_pickle(self, one_problem, make):
        posterior, data = make(one_problem, one_problem.data), one_problem.data
        for more in batches(one_problem, [3, 2, 4]):
            posterior, data = pickle.loads(pickle.dumps(posterior.updated(more))), data.joined(more)
        assert_same(posterior, make(one_problem, data))

    def test_an_output_that_was_never_observed(self, one_problem, make):
        first = Data([x if i else x[:0] for i, x in enumerate(one_problem.data.X)], [])
        first = first._replace(y=[y if i else y[:0] for i, y in enumerate(one_problem.data.y)])
        more = next(batches(one_problem, [8]))
        assert_same(make(one_problem, first).updated(more), make(one_problem, first.joined(more)))

    def test_likelihood_at_other_hyperparameters_knows_all(self, one_problem, make):
        if make is compact:
            pytest.skip("a compact posterior holds no samples")
        more = next(batches(one_problem, [5]))
        other = one_problem.kernel.clone_with_theta(one_problem.kernel.theta + 0.1)
        got, expected = (
            posterior.likelihood_at(other, 2 * one_problem.noise)
            for posterior in (
                make(one_problem, one_problem.data).updated(more),
                make(one_problem, one_problem.data.joined(more)),
            )
        )
        assert got == pytest.approx(expected, rel=1e-10)


def test_a_long_chain_stays_exact(one_problem):
    """A hundred samples, one at a time: rounding does not pile up."""
    posterior, data = exact(one_problem, one_problem.data), one_problem.data
    for more in batches(one_problem, [1] * 100):
        posterior, data = posterior.updated(more), data.joined(more)
    assert_same(posterior, exact(one_problem, data), rtol=1e-9)


class TestFactor:
    @pytest.mark.parametrize("steps", [[1], [3, 1, 1], [1, 40], [2] * 12])
    @pytest.mark.parametrize("tail", [1, 8, 10**6])
    def test_is_that_of_the_whole(self, steps, tail, monkeypatch):
        monkeypatch.setattr(_exact, "TAIL", tail)
        rng = np.random.default_rng(0)
        size = 20 + sum(steps)
        A = rng.normal(size=(size, size))
        K = A @ A.T + np.eye(size)
        factor, n = Factor(np.asfortranarray(np.linalg.cholesky(K[:20, :20]))), 20
        for m in steps:
            half = factor.solve_lower(np.array(K[:n, n : n + m], order="F"))
            factor, corner = factor.extended(half, np.array(K[n : n + m, n : n + m], order="F"))
            n += m
            np.testing.assert_allclose(np.tril(corner), np.tril(factor.matrix())[n - m :, n - m :])
        L, b = np.linalg.cholesky(K), rng.normal(size=(size, 3))
        assert factor.size == size
        np.testing.assert_allclose(np.tril(factor.matrix()), L, rtol=1e-8, atol=1e-10)
        solved = factor.solve_lower(np.array(b, order="F"))
        np.testing.assert_allclose(solved, np.linalg.solve(L, b), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(
            factor.solve_upper(b[:, 0]), np.linalg.solve(L.T, b[:, 0]), rtol=1e-7, atol=1e-9
        )
        assert factor.log_determinant() == pytest.approx(np.linalg.slogdet(K)[1])


def test_a_compact_posterior_says_what_it_cannot_do(one_problem):
    with pytest.raises(ValueError, match=r"holds no samples.*fitted hyperparameters alone"):
        compact(one_problem, one_problem.data).likelihood_at(one_problem.kernel, one_problem.noise)
