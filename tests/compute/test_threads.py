"""Tiles on threads: order, errors, Ctrl-C, and BLAS given back."""

import signal
import threading
import time
from contextvars import ContextVar

import pytest
from threadpoolctl import threadpool_limits

from skdgp._compute.parallel import SMALL, few_threads, n_threads, one_blas_thread, thread_map

word = ContextVar("word", default="unset")


@pytest.fixture(params=[1, 2, 4])
def threads(request):
    with threadpool_limits(request.param, user_api="blas"):
        if n_threads() != request.param:
            pytest.skip(f"this BLAS does not run on {request.param} threads")
        yield request.param


def test_one_thread_until_the_last_holder_leaves(threads):
    with one_blas_thread():
        with one_blas_thread():
            assert n_threads() == 1
        assert n_threads() == 1
    assert n_threads() == threads


@pytest.mark.parametrize(("size", "rows"), [(SMALL - 1, SMALL - 1), (SMALL, 1), (1, SMALL)])
def test_small_matrices_have_one_thread(threads, size, rows):
    class Model:
        @few_threads
        def predict(self, X, more):
            return n_threads(), more

    model = Model()
    model.size = size
    assert model.predict([0.0] * rows, more=2) == (1 if max(size, rows) < SMALL else threads, 2)
    assert n_threads() == threads


def test_results_stand_in_the_order_of_the_tasks(threads):
    def slow_first(task):
        time.sleep(0.002 * (8 - task))
        return task**2

    assert thread_map(slow_first, iter(range(8))) == [task**2 for task in range(8)]
    assert thread_map(slow_first, []) == []


def test_as_many_threads_as_blas_may_use(threads):
    together = threading.Barrier(threads, timeout=10)
    seen = thread_map(lambda _: (together.wait(), threading.get_ident())[1], range(threads))
    assert len(set(seen)) == threads


def test_blas_is_held_to_one_thread_meanwhile_and_given_back(threads):
    assert set(thread_map(lambda _: n_threads(), range(4))) == {1}
    assert n_threads() == threads


def test_nested_maps_do_not_multiply_threads(threads):
    def inner(_):
        return len(set(thread_map(lambda _: threading.get_ident(), range(4))))

    assert thread_map(inner, range(4)) == [1, 1, 1, 1]


def test_errors_come_through_and_blas_is_given_back(threads):
    def fail(task):
        if task == 3:
            raise ArithmeticError("three")
        return task

    with pytest.raises(ArithmeticError, match="three"):
        thread_map(fail, range(6))
    assert n_threads() == threads


def test_context_goes_along(threads):
    token = word.set("set")
    try:
        assert thread_map(lambda _: word.get(), range(3)) == ["set"] * 3
    finally:
        word.reset(token)


def test_ctrl_c_ends_the_map(threads):
    timer = threading.Timer(
        0.15, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)
    )
    timer.start()
    started = []
    with pytest.raises(KeyboardInterrupt):
        thread_map(lambda task: (started.append(task), time.sleep(0.1)), range(40))
    timer.join()
    assert len(started) < 40
    assert n_threads() == threads
