"""Threads for work on tiles, and limits of BLAS threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import copy_context
from functools import lru_cache
from threading import Event, Lock

from threadpoolctl import ThreadpoolController

SMALL = 1200
"""Matrices smaller than this are faster on one thread (measured on an idle machine of two cores: 1.2 times faster at
1000, twice at 250); on a busy machine waiting threads make that ten times."""


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


class _Hold:
    """Keeps BLAS on one thread while anybody asks for it; the last to leave restores what the first found."""

    def __init__(self):
        self._lock, self._holders, self._limits = Lock(), 0, None

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if self._holders == 0:
                self._limits = _controller().limit(limits=1, user_api="blas")
            self._holders += 1
        try:
            yield
        finally:
            with self._lock:
                self._holders -= 1
                if self._holders == 0:
                    self._limits.restore_original_limits()


one_blas_thread = _Hold()


def n_threads() -> int:
    """Return how many threads BLAS may use now, which is how many the tiles use: one setting rules both."""
    return max((lib.num_threads for lib in _controller().select(user_api="blas").lib_controllers), default=1)


def threads_for(size: int):
    """Return a context in which work on matrices of the given size uses the threads that make it fastest."""
    return one_blas_thread() if size < SMALL else nullcontext()


def thread_map(function: Callable, tasks: Iterable, stop: Event | None = None) -> list:
    """Return ``[function(task) for task in tasks]``, the tasks on as many threads as BLAS may use.

    BLAS itself is held to one thread meanwhile, so that the tiles do not compete with it. With ``stop``, Ctrl-C
    sets it and the results are still waited for: the function is expected to look at it and come to an end.
    """
    tasks = list(tasks)
    workers = min(n_threads(), len(tasks))
    if workers <= 1:
        return [function(task) for task in tasks]
    with one_blas_thread(), ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(copy_context().run, function, task) for task in tasks]
        try:
            return [future.result() for future in futures]
        except KeyboardInterrupt:
            if stop is None:
                pool.shutdown(cancel_futures=True)
                raise
            stop.set()
            return [future.result() for future in futures]
