"""Threads: limits of BLAS, and work on tiles with as many threads as BLAS may use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import copy_context
from functools import lru_cache, wraps
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

# Smaller matrices stay on one thread: two gain nothing on idle cores, and lose much on busy ones
SMALL = 2500


@lru_cache(maxsize=1)
def _libraries() -> list[Any]:
    return ThreadpoolController().select(user_api="blas").lib_controllers


_lock = Lock()
# of each caller that asks for one thread: the libraries, and their numbers of threads before the first
_holders: list[list[tuple[Any, int]]] = []


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS on one thread while any caller asks for it; the last to leave restores the former numbers.

    It takes some microseconds, a tenth of ``threadpool_limits``: a simulation enters it at each
    stage of a step.
    """
    with _lock:
        if not _holders:
            before = [(library, library.num_threads) for library in _libraries()]
            for library, _ in before:
                library.set_num_threads(1)
        _holders.append(_holders[0] if _holders else before)
    try:
        yield
    finally:
        with _lock:
            before = _holders.pop()
            if not _holders:
                for library, number in before:
                    library.set_num_threads(number)


def n_threads() -> int:
    """Return how many threads BLAS may use now; work on tiles uses as many."""
    return max((library.num_threads for library in _libraries()), default=1)


def threads_for(size: int) -> AbstractContextManager[None]:
    """Return a context that holds BLAS to one thread where matrices are smaller than ``SMALL``."""
    return one_blas_thread() if size < SMALL else nullcontext()


def few_threads(method: Callable) -> Callable:
    """Decorate a method of (X, ...): one BLAS thread where ``self.size`` and the rows of X are below ``SMALL``."""

    @wraps(method)
    def limited(self, X, *arguments, **options):
        with threads_for(max(self.size, len(X))):
            return method(self, X, *arguments, **options)

    return limited


def thread_map(function: Callable, tasks: Iterable) -> list:
    """Return ``[function(task) for task in tasks]``, on as many threads as BLAS may use, with one BLAS thread each."""
    tasks = list(tasks)
    workers = min(n_threads(), len(tasks))
    if workers <= 1:
        return [function(task) for task in tasks]
    with one_blas_thread(), ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(copy_context().run, function, task) for task in tasks]
        try:
            return [future.result() for future in futures]
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
