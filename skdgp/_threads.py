"""Threads for work on tiles, given back afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import lru_cache
from threading import Event

from threadpoolctl import ThreadpoolController


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def n_threads() -> int:
    """Return how many threads BLAS may use now, which is how many the tiles use: one setting rules both."""
    return max((lib.num_threads for lib in _controller().select(user_api="blas").lib_controllers), default=1)


def thread_map(function: Callable, tasks: Iterable, stop: Event | None = None) -> list:
    """Return ``[function(task) for task in tasks]``, the tasks on as many threads as BLAS may use.

    BLAS itself is held to one thread meanwhile, so that the tiles do not compete with it. With ``stop``, Ctrl-C
    sets it and the results are still waited for: the function is expected to look at it and come to an end.
    """
    tasks = list(tasks)
    workers = min(n_threads(), len(tasks))
    if workers <= 1:
        return [function(task) for task in tasks]
    with _controller().limit(limits=1, user_api="blas"), ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(copy_context().run, function, task) for task in tasks]
        try:
            return [future.result() for future in futures]
        except KeyboardInterrupt:
            if stop is None:
                pool.shutdown(cancel_futures=True)
                raise
            stop.set()
            return [future.result() for future in futures]
