"""Posteriors of terms, for kernels that define no terms themselves, too."""

import numpy as np
import pytest

from skdgp.inference import CentredTerm, Data, ExactPosterior, SparsePosterior, shares_of
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel, inducing_features

RNG = np.random.default_rng(0)
X, Y, NEW = RNG.normal(size=(25, 2)), RNG.normal(size=(25, 2)), RNG.normal(size=(6, 2))
NOISE = np.array([0.2, 0.4])
TREND = LinearTrend([1.0, 2.0], [[1.0, 0.5], [2.0, 0.3]], [0.0, 0.0])
DEPENDENT = ConvolvedGaussian(
    1, amplitude=[[1.0, -0.5], [0.6, 0.0], [0.0, 0.7]], length_scale=np.full((3, 2, 2), 1.3)
)


class Own(MultiOutputKernel):
    """A kernel with the required methods alone."""

    def __init__(self, inner):
        self.inner = inner

    n_outputs, n_features = 2, 2

    def block(self, i, j, Xi, Xj):
        return self.inner.block(i, j, Xi, Xj)

    def block_diag(self, i, Xi):
        return self.inner.block_diag(i, Xi)

    def block_gradient(self, i, j, Xi, Xj, W):
        return np.zeros(0)

    def free_parameters(self):
        return []


def posteriors(kernel):
    data = Data.from_table(X, Y)
    return [
        ExactPosterior(kernel, NOISE, data),
        SparsePosterior(kernel, inducing_features(kernel, X[:15]), NOISE, shares_of(data)),
    ]


@pytest.mark.parametrize(
    "kernel", [TREND + DEPENDENT, TREND + Own(DEPENDENT), Own(DEPENDENT) + TREND]
)
@pytest.mark.parametrize("kind", [0, 1], ids=["exact", "sparse"])
class TestTerms:
    def test_means_add_up(self, kernel, kind):
        posterior = posteriors(kernel)[kind]
        terms = [posterior.term(kernel.term(columns)) for columns in kernel.term_regressors()]
        np.testing.assert_allclose(
            sum(term.predict(NEW) for term in terms), posterior.predict(NEW), atol=1e-10
        )
        slopes = sum(term.gradient(NEW) for term in terms)
        np.testing.assert_allclose(slopes, posterior.gradient(NEW), atol=1e-8)

    def test_variance_is_the_diagonal_of_the_covariance(self, kernel, kind):
        posterior = posteriors(kernel)[kind]
        for columns in kernel.term_regressors():
            term = posterior.term(kernel.term(columns))
            variance = term.predict(NEW, return_variance=True)[1].T.ravel()
            np.testing.assert_allclose(variance, np.diag(term.covariance(NEW)), atol=1e-8)

    def test_centring_is_a_linear_map(self, kernel, kind):
        posterior = posteriors(kernel)[kind]
        points = np.concatenate([NEW, X])
        centring = np.hstack([np.eye(len(NEW)), np.full((len(NEW), len(X)), -1 / len(X))])
        for columns in kernel.term_regressors():
            term, centred = posterior.term(kernel.term(columns)), CentredTerm(posterior, columns, X)
            mean, variance = centred.predict(NEW, return_variance=True)
            np.testing.assert_allclose(mean, centring @ term.predict(points), atol=1e-10)
            blocks = term.covariance(points).reshape(2, len(points), 2, len(points))
            for i in range(2):
                expected = np.diag(centring @ blocks[i, :, i] @ centring.T)
                np.testing.assert_allclose(variance[:, i], expected, atol=1e-8)


def test_a_term_has_the_posterior_of_dense_matrices():
    kernel = TREND + DEPENDENT
    K, y = kernel(X) + np.diag(np.repeat(NOISE, len(X))), Y.T.ravel()
    term = posteriors(kernel)[0].term(kernel.term((0, 1)))
    cross = DEPENDENT(NEW, X)
    np.testing.assert_allclose(
        term.predict(NEW).T.ravel(), cross @ np.linalg.solve(K, y), atol=1e-10
    )
    expected = DEPENDENT(NEW) - cross @ np.linalg.solve(K, cross.T)
    np.testing.assert_allclose(term.covariance(NEW), expected, atol=1e-10)
