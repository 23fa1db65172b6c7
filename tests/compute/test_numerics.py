"""Factorisations against NumPy, differences against derivatives that are known, and tiles on threads."""

import signal
import threading
import time
from contextvars import ContextVar

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from threadpoolctl import threadpool_limits

from skdgp._compute.linalg import (
    JITTER_LAST,
    JitterWarning,
    jittered_cholesky,
)
from skdgp._compute.parallel import n_threads, thread_map

ROOT = default_rng(0).normal(size=(7, 7))
K = ROOT @ ROOT.T + np.eye(7)


def cholesky(matrix):
    """Return the Cholesky factor of a matrix of which the lower triangle is read alone."""
    return jittered_cholesky(lambda: np.array(matrix, order="F"))


class TestCholesky:
    @pytest.mark.parametrize("above", [0.0, np.nan])
    def test_reads_the_lower_triangle_alone(self, above):
        matrix = K + np.triu(np.full_like(K, above), 1)
        assert_allclose(np.tril(cholesky(matrix)), np.linalg.cholesky(K), rtol=1e-12)

    def test_of_a_singular_matrix_raises_the_diagonal_and_says_so(self):
        x = default_rng(1).normal(size=(6, 3))
        singular = 1e4 * x @ x.T
        words = r"6 values was not positive definite.*; (\S+) of its diagonal"
        with pytest.warns(JitterWarning, match=words) as caught:
            L = np.tril(cholesky(singular))
        assert len(caught) == 1
        jitter = float(str(caught[0].message).split("; ")[1].split()[0])
        assert 0 < jitter <= JITTER_LAST
        mean = np.diag(singular).mean()
        assert_allclose(L @ L.T, singular + jitter * mean * np.eye(6), atol=1e-9 * mean)

    @pytest.mark.parametrize(
        ("matrix", "words"),
        [
            ([[1.0, 2.0], [2.0, 1.0]], r"2 values is not .* even with 0\.0001.*Raise the noise"),
            (np.diag([1.0, np.nan]), "finite"),
        ],
    )
    def test_of_what_has_none_is_refused_with_the_remedy(self, matrix, words):
        with pytest.raises(np.linalg.LinAlgError, match=words):
            cholesky(matrix)


word = ContextVar("word", default="unset")


@pytest.fixture(params=[1, 2, 4])
def threads(request):
    """Return a number of threads, which BLAS has again after the test."""
    with threadpool_limits(request.param, user_api="blas"):
        if n_threads() != request.param:
            pytest.skip(f"this BLAS does not run on {request.param} threads")
        yield request.param
        assert n_threads() == request.param


class TestThreads:
    def test_errors_come_through(self, threads):
        def fail(task):
            if task == 3:
                raise ArithmeticError("three")

        with pytest.raises(ArithmeticError, match="three"):
            thread_map(fail, range(6))

    def test_ctrl_c_ends_the_map(self, threads):
        main = threading.main_thread().ident
        timer = threading.Timer(0.15, signal.pthread_kill, (main, signal.SIGINT))
        timer.start()
        started = []

        def task(number):
            started.append(number)
            time.sleep(0.1)

        with pytest.raises(KeyboardInterrupt):
            thread_map(task, range(40))
        timer.join()
        assert len(started) < 40
