"""Threads for work on tiles, and limits of BLAS threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import copy_context
from functools import lru_cache
from threading import Event, Lock
from typing import Any

from threadpoolctl import ThreadpoolController

SMALL = 2500
"""Smaller matrices stay on one thread: two gain nothing over whole fits on idle cores, and lose much on busy ones."""


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


class _OneThread:
    """Keep BLAS on one thread while any caller asks for it; the last to leave restores what the first found."""

    def __init__(self):
        self._lock, self._holders = Lock(), 0
        self._limits: Any = None

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


one_blas_thread = _OneThread()


def n_threads() -> int:
    """Return how many threads BLAS may use now; work on tiles uses as many."""
    return max((lib.num_threads for lib in _controller().select(user_api="blas").lib_controllers), default=1)


def threads_for(size: int) -> AbstractContextManager[None]:
    """Return a context that holds BLAS to one thread where matrices are smaller than ``SMALL``."""
    return one_blas_thread() if size < SMALL else nullcontext()


def thread_map(function: Callable, tasks: Iterable, stop: Event | None = None) -> list:
    """Return ``[function(task) for task in tasks]``, on as many threads as BLAS may use, each with BLAS on one thread.

    With ``stop``, Ctrl-C sets it and the results are still waited for: the function must check it and return.
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
