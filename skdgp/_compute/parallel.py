"""Fits side by side and sums over shares (chunks) of samples, on joblib's active backend; threads, and limits of BLAS.

This process works alone unless ``n_jobs`` or ``joblib.parallel_config`` asks for others. Results
keep the order of the tasks, so sums keep their bits wherever their parts are computed. What others
do not finish is computed here, with a warning.
"""

from __future__ import annotations

import signal
import tempfile
import threading
import warnings
from asyncio import CancelledError
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import copy_context
from functools import lru_cache, wraps
from pathlib import Path
from threading import Lock
from typing import Any
from uuid import uuid4

import numpy as np
from joblib import Parallel, cpu_count, delayed, effective_n_jobs
from joblib.parallel import get_active_backend
from threadpoolctl import ThreadpoolController

from skdgp._compute.progress import listening

SMALL = 2500
"""Smaller matrices stay on one thread: two gain nothing over whole fits on idle cores, and lose
much on busy ones.
"""


@lru_cache(maxsize=1)
def _libraries() -> list[Any]:
    return ThreadpoolController().select(user_api="blas").lib_controllers


class _OneThread:
    """Keep BLAS on one thread while any caller asks for it; the last to leave restores what the first found.

    It takes some microseconds, a tenth of ``threadpool_limits``: a simulation enters it at each
    stage of a step.
    """

    def __init__(self):
        self._lock, self._holders = Lock(), 0
        self._before: list[tuple[Any, int]] = []

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if self._holders == 0:
                self._before = [(library, library.num_threads) for library in _libraries()]
                _set((library, 1) for library, _ in self._before)
            self._holders += 1
        try:
            yield
        finally:
            with self._lock:
                self._holders -= 1
                if self._holders == 0:
                    _set(self._before)


def _set(numbers: Iterable[tuple[Any, int]]) -> None:
    for library, number in numbers:
        library.set_num_threads(number)


one_blas_thread = _OneThread()


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


def check_n_jobs(n_jobs: Any) -> None:
    """Raise ValueError if ``n_jobs`` is not None, a positive number, or counted back from all processors."""
    cpus = cpu_count()
    whole = isinstance(n_jobs, (int, np.integer)) and not isinstance(n_jobs, bool)
    if n_jobs is not None and not (whole and (n_jobs > 0 or -cpus <= n_jobs < 0)):
        raise ValueError(
            f"Got n_jobs={n_jobs!r}, but expected None (what joblib.parallel_config says, else "
            f"one process), a number "
            f"of processes from 1 on, or counted from all processors: -1 is all {cpus} of this "
            f"machine, -2 all but one."
        )


def share_map(function: Callable, state: tuple, shares: Sequence) -> list:
    """Return ``[function(*state, share) for share in shares]``, by processes that joblib offers, else by threads.

    ``function`` is defined at module level. Errors are those of ``function``.
    """
    if len(shares) > 1 and _invited(None, threads=False):
        n = min(effective_n_jobs(), len(shares))
        try:
            parts = Parallel()(
                delayed(_map_on_one_core)(function, state, shares[k::n]) for k in range(n)
            )
        except (Exception, CancelledError) as error:
            _warn_of_loss(error)
        else:
            _raise_first_error(parts)
            return [parts[k % n][k // n] for k in range(len(shares))]
    return thread_map(lambda share: function(*state, share), shares)


def _map_on_one_core(function, state, shares):
    """Return the results, or the error that the function raises."""
    try:
        with one_blas_thread():
            return [function(*state, share) for share in shares]
    except MemoryError:
        raise  # this process may have more
    except Exception as error:
        return error


def fit_map(fit: Callable, starts: Sequence[dict], n_jobs: int | None = None) -> list:
    """Return ``[fit(**start) for start in starts]``, side by side where joblib has workers.

    What ``fit`` returns has ``interrupted`` and ``marked``, as :class:`skdgp.inference.Fit`. After
    Ctrl-C the list holds the best so far of every fit that had begun; a second Ctrl-C raises
    KeyboardInterrupt.
    """
    results = (
        _fit_elsewhere(fit, starts, n_jobs)
        if len(starts) > 1 and _invited(n_jobs, threads=True)
        else {}
    )
    for k, start in enumerate(starts):
        if any(result.interrupted for result in results.values()):
            break
        if k not in results:
            results[k] = fit(**start)
    return [results[k] for k in sorted(results)]


def _fit_elsewhere(fit, starts, n_jobs):
    """Return by number the fits that workers finished or, after Ctrl-C, began."""
    results: dict = {}
    stop_file = Path(tempfile.gettempdir(), f"skdgp-stop-{uuid4().hex}")
    unordered = getattr(get_active_backend()[0], "supports_return_generator", False)
    parallel = Parallel(n_jobs=n_jobs, return_as="generator_unordered" if unordered else "list")
    with _stop_at_interrupt(stop_file) as stopped:
        try:
            for k, result in parallel(
                delayed(_fit)(fit, k, start, stop_file) for k, start in enumerate(starts)
            ):
                results |= {} if result is None else {k: result}
        except (Exception, CancelledError) as error:
            if not stopped.is_set():
                _warn_of_loss(error)
    _raise_first_error(results.values())
    if stopped.is_set() and not results:
        raise KeyboardInterrupt
    return (
        {k: result.marked(interrupted=True) for k, result in results.items()}
        if stopped.is_set()
        else results
    )


def _fit(fit, k, start, stop_file):
    """Return k and the fit, the error that it raises, or None where it is stopped before it has anything to keep."""

    def stop_if_asked(*_):
        if stop_file.exists():
            raise KeyboardInterrupt

    try:
        with listening(stop_if_asked):
            return k, fit(**start)
    except KeyboardInterrupt:
        return k, None
    except MemoryError:
        raise
    except Exception as error:
        return k, error


@contextmanager
def _stop_at_interrupt(stop_file: Path) -> Iterator[threading.Event]:
    """Let the first Ctrl-C set the event and write the file, at which fits on this machine stop."""
    stopped, former = threading.Event(), signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(former):
        yield stopped
        return

    def stop(*_):
        signal.signal(signal.SIGINT, former)
        stopped.set()
        stop_file.touch()

    signal.signal(signal.SIGINT, stop)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, former)
        stop_file.unlink(missing_ok=True)


def _invited(n_jobs, threads):
    """Return whether joblib offers workers; threads count only where ``threads`` is true.

    Inside a worker it is False: the outermost loop is the one that is distributed.
    """
    backend, _ = get_active_backend()
    if n_jobs == 1 or backend.nesting_level or _inside_task_of_dask(backend):
        return False
    if getattr(backend, "supports_sharedmem", False) and not threads:
        return False
    try:
        return effective_n_jobs(n_jobs) > 1
    except TimeoutError as error:  # Dask has no worker
        _warn_of_loss(error)
        return False


def _inside_task_of_dask(backend):
    """Return whether this is a task of Dask, whose backend does not count how deep it is nested."""
    if not hasattr(backend, "client"):
        return False
    from distributed.worker import thread_state

    return hasattr(thread_state, "execution_state")


def _raise_first_error(results):
    for result in results:
        if isinstance(result, Exception):
            raise result


def _warn_of_loss(error):
    warnings.warn(
        f"Work given to other processes or machines did not come back ({type(error).__name__}: "
        f"{(str(error).splitlines() or [''])[0]}). It is done in this process instead, with the "
        f"same results.",
        RuntimeWarning,
        stacklevel=3,
    )
