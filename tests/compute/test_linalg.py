"""Factorisations against NumPy, and a Cholesky that says what it did."""

import numpy as np
import pytest

from skdgp._compute.linalg import (
    JITTER_LAST,
    JitterWarning,
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)


@pytest.fixture
def K():
    root = np.random.default_rng(0).normal(size=(7, 7))
    return root @ root.T + np.eye(7)


def fortran(K):
    return lambda: np.array(K, order="F")


class TestCholesky:
    def test_of_a_covariance(self, K):
        np.testing.assert_allclose(
            np.tril(jittered_cholesky(fortran(K))), np.linalg.cholesky(K), rtol=1e-12
        )

    def test_reads_the_lower_triangle_alone(self, K):
        garbled = np.tril(K) + np.triu(np.full_like(K, np.nan), 1)
        np.testing.assert_allclose(
            np.tril(jittered_cholesky(fortran(garbled))), np.linalg.cholesky(K), rtol=1e-12
        )

    def test_of_a_singular_matrix_raises_the_diagonal_and_says_so(self):
        x = np.random.default_rng(1).normal(size=(6, 3))
        singular = 1e4 * x @ x.T
        with pytest.warns(
            JitterWarning, match=r"6 values was not positive definite.*; (\S+) of its diagonal"
        ) as caught:
            L = np.tril(jittered_cholesky(fortran(singular)))
        jitter = float(str(caught[0].message).split("; ")[1].split()[0])
        assert 0 < jitter <= JITTER_LAST
        mean = np.diag(singular).mean()
        np.testing.assert_allclose(L @ L.T, singular + jitter * mean * np.eye(6), atol=1e-9 * mean)

    def test_warns_where_the_caller_is(self):
        with pytest.warns(JitterWarning) as caught:
            jittered_cholesky(fortran(np.ones((3, 3)) - 1e-9 * np.eye(3)))
        assert len(caught) == 1

    def test_of_an_indefinite_matrix_is_refused_with_the_remedy(self):
        with pytest.raises(
            np.linalg.LinAlgError,
            match=r"2 values is not positive definite even with 0\.0001.*Raise the noise",
        ):
            jittered_cholesky(fortran(np.array([[1.0, 2.0], [2.0, 1.0]])))

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_of_what_is_not_finite_is_refused_as_such(self, K, bad):
        K[2, 2] = bad
        with pytest.raises(np.linalg.LinAlgError, match="finite"):
            jittered_cholesky(fortran(K))

    def test_works_in_place(self, K):
        made = []

        def assemble():
            made.append(np.array(K, order="F"))
            return made[-1]

        L = jittered_cholesky(assemble)
        assert len(made) == 1
        assert np.shares_memory(L, made[0])


def test_solve_inverse_and_determinant(K):
    L = jittered_cholesky(fortran(K))
    b = np.arange(7.0)
    np.testing.assert_allclose(cholesky_solve(L, b), np.linalg.solve(K, b), rtol=1e-10)
    assert log_determinant(L) == pytest.approx(np.linalg.slogdet(K)[1])
    B = np.asfortranarray(np.random.default_rng(2).normal(size=(7, 3)))
    np.testing.assert_allclose(
        triangular_solve(L, B.copy(order="F")), np.linalg.solve(np.tril(L), B), rtol=1e-10
    )
    inverse = np.tril(cholesky_inverse(L))
    np.testing.assert_allclose(inverse, np.tril(np.linalg.inv(K)), rtol=1e-9, atol=1e-12)
    assert np.shares_memory(cholesky_inverse(jittered_cholesky(fortran(K))), L) is False
