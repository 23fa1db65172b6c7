"""Features that are the outputs' own parts, and what replacing samples by them changes: bounded, and measured."""

import pickle

import numpy as np
import pytest

from skdgp.inference import ExactPosterior, SparsePosterior, compact, shares_of
from skdgp.inference._compact import _ratio_bounds

RNG = np.random.default_rng(7)
NEW = RNG.normal(size=(60, 2)) * 2.0


def exact(problem):
    return ExactPosterior(problem.kernel, problem.noise, problem.data)


def parts(problem, n):
    """The features that n variables are best spent on."""
    return problem.kernel.feature_ranking(problem.X, np.sqrt(problem.noise), 0)(n)


def sparse(problem, features):
    return SparsePosterior(problem.kernel, features, problem.noise, shares_of(problem.data))


def compacted(posterior, n, tolerance=None, allow=lambda size: None, max_iter=0):
    return compact(posterior, n, tolerance, max_iter, 0, allow)


class TestParts:
    def test_at_every_sample_nothing_is_lost(self, problem):
        """What every latent does to every output at every sample is all that the data tell of."""
        exact_one, all_of_them = exact(problem), sparse(problem, parts(problem, 10**6))
        assert all_of_them.log_marginal_likelihood == pytest.approx(
            exact_one.log_marginal_likelihood, abs=1e-2
        )
        for got, expected in zip(
            all_of_them.predict(NEW, True), exact_one.predict(NEW, True), strict=True
        ):
            np.testing.assert_allclose(got, expected, atol=1e-3)

    def test_gradient_of_the_bound_by_everything(self, problem, assert_gradient):
        features, n = parts(problem, 20), problem.kernel.n_dims

        def bound(theta):
            kernel = problem.kernel.clone_with_theta(theta[:n])
            rebuilt = features.rebuild(kernel, theta[n + 3 :])
            return SparsePosterior(
                kernel, rebuilt, np.exp(theta[n : n + 3]), shares_of(problem.data)
            ).log_marginal_likelihood

        theta = np.concatenate([problem.kernel.theta, np.log(problem.noise), features.theta])
        assert_gradient(
            sparse(problem, features).bound_gradient(), bound, theta, rtol=1e-5, atol=1e-4
        )

    def test_as_many_as_asked_for(self, one_problem):
        trend = 3 * 3
        assert [parts(one_problem, n).size - trend for n in (1, 5, 17)] == [5, 5, 17]

    def test_go_where_they_are_needed(self, one_problem):
        """An output that may be wrong a thousandfold gets no more than its private latent must have: one."""
        features = one_problem.kernel.feature_ranking(one_problem.X, np.array([1.0, 1.0, 1e3]), 0)(
            20
        ).second
        assert sum(len(Z) for i, Z in zip(features.outputs, features.Z, strict=True) if i == 2) == 1

    @pytest.mark.filterwarnings("error")
    def test_latents_that_do_nothing_and_samples_that_repeat(self, one_problem):
        kernel = one_problem.kernel.clone_with_theta(one_problem.kernel.theta)
        kernel.k2.amplitude = kernel.k2.amplitude * np.array([1.0, 0.0, 1.0, 0.0, 1.0])[:, None]
        X = np.round(np.tile(one_problem.X, (3, 1)))
        for n in (1, 9, 1000):
            features = kernel.feature_ranking(X, np.sqrt(one_problem.noise), 0)(n)
            assert np.isfinite(sparse(one_problem, features).predict(NEW, True)).all()


class TestRows:
    """The quick way to a row's covariances, against the block of each pair."""

    @pytest.mark.parametrize("n", [1, 60])
    @pytest.mark.parametrize("kind", ["windows", "parts"])
    def test_are_the_covariances(self, problem, kind, n):
        features = problem.kernel.features(NEW[:4]) if kind == "windows" else parts(problem, 25)
        rows = features.rows()
        X = NEW[:n] + 5.0
        expected = np.hstack([features.Kfu(i, X) for i in range(3)])
        np.testing.assert_allclose(rows(X), expected, rtol=1e-10, atol=1e-14)

    def test_predictions_are_those_of_the_definition(self, problem):
        posterior = sparse(problem, parts(problem, 25))
        mean, variance = posterior.predict(NEW, True)
        for i in range(3):
            c = posterior.features.columns(i)
            A = posterior.features.Kfu(i, NEW)
            V = np.linalg.solve(np.tril(posterior.Lu)[np.ix_(c, c)], A.T)
            learned = np.einsum(
                "an,ab,bn->n", V, np.eye(len(c)) - posterior.B_inverse[np.ix_(c, c)], V
            )
            np.testing.assert_allclose(mean[:, i], A @ posterior.weights[c], rtol=1e-10, atol=1e-10)
            np.testing.assert_allclose(
                variance[:, i],
                posterior.kernel.block_diag(i, NEW) - learned,
                rtol=1e-10,
                atol=1e-10,
            )
        np.testing.assert_allclose(posterior.predict(NEW[3:4]), mean[3:4], rtol=1e-10)
        np.testing.assert_allclose(posterior.predict(NEW[3:4], True)[1], variance[3:4], rtol=1e-10)


def divergence_of(new, original):
    """KL of two Gaussians given as mean and covariance."""
    (m1, C1), (m0, C0) = new, original
    step = np.linalg.solve(C0, m0 - m1)
    logs = np.linalg.slogdet(C0)[1] - np.linalg.slogdet(C1)[1]
    return 0.5 * (np.trace(np.linalg.solve(C0, C1)) + (m0 - m1) @ step - len(m1) + logs)


class TestBound:
    @pytest.mark.parametrize("n", [3, 12, 30])
    def test_no_mean_and_no_deviation_moves_further_anywhere(self, problem, n):
        original = exact(problem)
        new, found = compacted(original, n)
        (m0, v0), (m1, v1) = (posterior.predict(NEW, True) for posterior in (original, new))
        assert (np.abs(m1 - m0) <= found.mean_bound * np.sqrt(v0) * (1 + 1e-6)).all()
        low, high = found.std_bounds
        ratio = np.sqrt(v1 / v0)
        assert (low * (1 - 1e-6) <= ratio).all()
        assert (ratio <= high * (1 + 1e-6)).all()

    @pytest.mark.parametrize("n", [3, 30])
    def test_divergence_at_some_points_is_no_larger(self, problem, n):
        original = exact(problem)
        new, found = compacted(original, n)
        few = NEW[:3]
        joint = [(p.predict(few).T.ravel(), p.covariance(few)) for p in (new, original)]
        assert 0 < divergence_of(*joint) <= found.divergence

    def test_of_one_output_at_one_point_is_the_formula(self):
        for divergence in (1e-12, 1e-3, 0.5, 40.0, 1e4):
            low, high = _ratio_bounds(divergence)
            assert low < 1 < high
            assert high**2 - 1 - np.log(high**2) == pytest.approx(2 * divergence, rel=1e-3)
        assert _ratio_bounds(0.0) == (1.0, 1.0)
        assert np.isnan(_ratio_bounds(np.nan)).all()


class TestMeasured:
    def test_is_the_change_at_the_training_inputs_and_beyond(self, one_problem):
        original = exact(one_problem)
        new, found = compacted(original, 10)
        X = np.concatenate(one_problem.data.X)
        (m0, v0), (m1, v1) = (posterior.predict(X, True) for posterior in (original, new))
        assert (np.abs(m1 - m0) / np.sqrt(v0)).max(axis=0) == pytest.approx(found.mean_max, rel=1.0)
        assert (found.mean_max >= (np.abs(m1 - m0) / np.sqrt(v0)).max(axis=0) * (1 - 1e-9)).all()
        assert (found.std_max >= np.sqrt(v1 / v0).max(axis=0) * (1 - 1e-9)).all()
        assert (found.std_min <= np.sqrt(v1 / v0).min(axis=0) * (1 + 1e-9)).all()
        assert found.change == max(found.mean_rms.max(), found.std_rms.max())
        assert found.n_inducing == new.features.size == 19

    def test_tolerance_is_kept_with_as_few_as_it_takes(self, one_problem):
        numbers = []
        for tolerance in (0.5, 0.1, 0.02):
            new, found = compacted(exact(one_problem), 10**4, tolerance)
            assert found.change <= tolerance
            numbers.append(new.features.size)
        assert numbers[0] < numbers[1] < numbers[2]

    def test_better_places_bring_the_processes_nearer(self, problem):
        placed, moved = (compacted(exact(problem), 15, max_iter=k)[1] for k in (0, 15))
        assert moved.n_inducing == placed.n_inducing
        assert moved.divergence < 0.95 * placed.divergence

    def test_memory_is_asked_for_before_it_is_taken(self, one_problem):
        asked = []
        compacted(exact(one_problem), 12, None, asked.append)
        assert asked == [21]


class TestOfASparsePosterior:
    def test_has_no_bound_but_a_measure(self, one_problem):
        original = sparse(one_problem, one_problem.kernel.features(NEW[:12]))
        _, found = compacted(original, 12)
        assert np.isnan([found.divergence, found.mean_bound, *found.std_bounds]).all()
        assert np.isfinite(found.mean_rms).all()

    def test_of_a_compact_one_is_refused(self, one_problem):
        small, _ = compacted(exact(one_problem), 10)
        with pytest.raises(ValueError, match=r"no samples to be compacted again.*was made from"):
            compacted(small, 5)


def test_file_does_not_grow_with_the_samples(one_problem):
    more = one_problem.data
    for _ in range(6):
        more = more.joined(more)
    sizes = [
        len(
            pickle.dumps(
                SparsePosterior(
                    one_problem.kernel, parts(one_problem, 20), one_problem.noise, shares
                ).without_samples()
            )
        )
        for shares in (shares_of(one_problem.data), shares_of(more))
    ]
    assert abs(sizes[0] - sizes[1]) < 100
