"""Fits side by side and sums over shares (chunks) of samples, on joblib's active backend.

This process works alone unless ``n_jobs`` or ``joblib.parallel_config`` asks for others. Results keep the order of the
tasks, so sums keep their bits wherever their parts are computed. What workers cannot finish is computed here, with a
warning. Workers of Dask repeat by themselves what is lost with one of them.
"""

from __future__ import annotations

import signal
import tempfile
import threading
import warnings
from asyncio import CancelledError
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from joblib import Parallel, cpu_count, delayed, effective_n_jobs
from joblib.parallel import get_active_backend

from skdgp._compute.progress import listening
from skdgp._compute.threads import one_blas_thread, thread_map

MAX_FAILURES = 3  # failed calls in a row after which workers are asked no more

_summers: ContextVar[_Summers | None] = ContextVar("skdgp_summers", default=None)


def check_n_jobs(n_jobs: Any) -> None:
    """Raise ValueError if ``n_jobs`` is not None, a positive number, or counted back from all processors."""
    cpus = cpu_count()
    whole = isinstance(n_jobs, (int, np.integer)) and not isinstance(n_jobs, bool)
    if n_jobs is not None and not (whole and (n_jobs > 0 or -cpus <= n_jobs < 0)):
        raise ValueError(
            f"Got n_jobs={n_jobs!r}, but expected None (what joblib.parallel_config says, else one process), a number "
            f"of processes from 1 on, or counted from all processors: -1 is all {cpus} of this machine, -2 all but one."
        )


def share_map(function: Callable, state: tuple, shares: Sequence) -> list:
    """Return ``[function(*state, share) for share in shares]``, by threads, or by workers within ``sharing(shares)``.

    ``function`` is defined at module level; ``state`` changes from call to call, ``shares`` do not.
    """
    summers = _summers.get()
    if summers is not None and summers.shares is shares:
        return summers.map(function, state)
    return thread_map(lambda share: function(*state, share), shares)


@contextmanager
def sharing(shares: Sequence) -> Iterator[None]:
    """Let the workers of joblib's active backend compute ``share_map`` of these shares within the block.

    Workers of Dask are sent the shares once, the state with every call.
    """
    invited, client = _workers(None)
    token = _summers.set(_Summers(client, shares) if invited else None)
    try:
        yield
    finally:
        _summers.reset(token)


class _Summers:
    """Workers that compute functions of the same shares again and again."""

    def __init__(self, client: Any, shares: Sequence):
        self.client, self.shares = client, shares
        self.sent: list = []  # futures of Dask, the shares of one worker each
        self.failures, self.warned = 0, False

    def map(self, function: Callable, state: tuple) -> list:
        n_workers = effective_n_jobs() if self.client is None else _n_cores(self.client)
        n, error = min(n_workers, len(self.shares)), "no worker is left"
        if n and self.failures < MAX_FAILURES:
            try:
                parts = self._compute(function, state, n)
            except (Exception, CancelledError) as caught:
                error, self.sent = _first_line(caught), []
                self.failures += 1
            else:
                self.failures = 0
                _raise_first_error(parts)
                return [parts[k % n][k // n] for k in range(len(self.shares))]
        if not self.warned:
            self.warned = True
            _warn_of_loss(error)
        return thread_map(lambda share: function(*state, share), self.shares)

    def _compute(self, function, state, n):
        if self.client is None:
            return Parallel()(delayed(_map_on_one_core)(function, state, self.shares[k::n]) for k in range(n))
        if len(self.sent) != n:
            self.sent = [_send(self.client, self.shares[k::n]) for k in range(n)]
        state = _send(self.client, state)
        tasks = [self.client.submit(_map_on_one_core, function, state, part, pure=False) for part in self.sent]
        return self.client.gather(tasks)


def _map_on_one_core(function, state, shares):
    """Return the results, or the error that the function raises."""
    try:
        with one_blas_thread():
            return [function(*state, share) for share in shares]
    except MemoryError:
        raise  # another machine may have more
    except Exception as error:
        return error


def fit_map(fit: Callable, starts: Sequence[dict], n_jobs: int | None = None) -> list:
    """Return ``[fit(**start) for start in starts]``, side by side where joblib has workers.

    What ``fit`` returns has ``interrupted`` and ``marked``, as :class:`skdgp.inference.Fit`. After Ctrl-C the list
    holds the best so far of every fit that had begun; a second Ctrl-C raises KeyboardInterrupt.
    """
    invited, client = _workers(n_jobs, threads=True) if len(starts) > 1 else (False, None)
    results = _fit_elsewhere(fit, starts, n_jobs, client) if invited else {}
    for k, start in enumerate(starts):
        if any(result.interrupted for result in results.values()):
            break
        if k not in results:
            results[k] = fit(**start)
    return [results[k] for k in sorted(results)]


def _fit_elsewhere(fit, starts, n_jobs, client):
    """Return by number the fits that workers finished or, after Ctrl-C, began."""
    results, error, stop_name = {}, "interrupted there", f"skdgp-stop-{uuid4().hex}"
    with _stop_at_interrupt(stop_name, client) as stopped:
        try:
            for k, result in _results(fit, starts, n_jobs, client, stop_name):
                results[k] = result
        except (Exception, CancelledError) as caught:
            error = _first_line(caught)
    _raise_first_error(results.values())
    results = {k: result for k, result in results.items() if result is not None}
    if stopped.is_set():
        if not results:
            raise KeyboardInterrupt
        return {k: result.marked(interrupted=True) for k, result in results.items()}
    if len(results) < len(starts):
        _warn_of_loss(error)
    return results


def _results(fit, starts, n_jobs, client, stop_name):
    """Yield number and result of each fit as it ends."""
    if client is None:
        unordered = getattr(get_active_backend()[0], "supports_return_generator", False)
        parallel = Parallel(n_jobs=n_jobs, return_as="generator_unordered" if unordered else "list")
        yield from parallel(delayed(_fit)(fit, k, start, stop_name, False) for k, start in enumerate(starts))
        return
    from distributed import as_completed

    fit = _send(client, fit)
    tasks = [client.submit(_fit, fit, k, start, stop_name, True, pure=False) for k, start in enumerate(starts)]
    yield from (task.result() for task in as_completed(tasks, loop=client.loop))


def _fit(fit, k, start, stop_name, one_core):
    """Return k and the fit, the error that it raises, or None where it is stopped before it has anything to keep."""
    stop_file = _stop_file(stop_name)

    def stop_if_asked(*_):
        if stop_file.exists():
            raise KeyboardInterrupt

    try:
        with one_blas_thread() if one_core else nullcontext(), listening(stop_if_asked):
            return k, fit(**start)
    except KeyboardInterrupt:
        return k, None
    except MemoryError:
        raise
    except Exception as error:
        return k, error


@contextmanager
def _stop_at_interrupt(stop_name: str, client: Any) -> Iterator[threading.Event]:
    """Let the first Ctrl-C set the event and write a file on each machine, at which the fits there stop.

    In a terminal Ctrl-C reaches the workers too, and would end those of Dask: they ignore it meanwhile.
    """
    stopped, former = threading.Event(), signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(former):
        yield stopped
        return

    def stop(*_):
        signal.signal(signal.SIGINT, former)
        stopped.set()
        _ask_to_stop(stop_name, True)
        # In another thread: the interrupted one may hold a lock that the client needs.
        threading.Thread(target=_run_everywhere, args=(client, _ask_to_stop, stop_name, True), daemon=True).start()

    signal.signal(signal.SIGINT, stop)
    try:
        _run_everywhere(client, _ignore_interrupt, True)
        yield stopped
    finally:
        signal.signal(signal.SIGINT, former)
        _run_everywhere(client, _ignore_interrupt, False)
        _run_everywhere(client, _ask_to_stop, stop_name, False)
        _ask_to_stop(stop_name, False)


def _stop_file(name):
    return Path(tempfile.gettempdir(), name)


def _ask_to_stop(name, ask):
    _stop_file(name).touch() if ask else _stop_file(name).unlink(missing_ok=True)


def _ignore_interrupt(ignore):
    with suppress(ValueError):  # a worker outside the main thread of its process never gets the signal
        signal.signal(signal.SIGINT, signal.SIG_IGN if ignore else signal.default_int_handler)


def _workers(n_jobs, threads=False):
    """Return whether other workers are invited, and the client of Dask that has them, if one does."""
    backend, _ = get_active_backend()
    client = getattr(backend, "client", None)
    if n_jobs == 1 or backend.nesting_level or _inside_task_of_dask(client):
        return False, None  # the outermost loop is the one that is distributed
    if getattr(backend, "supports_sharedmem", False) and not threads:
        return False, None
    try:
        return effective_n_jobs(n_jobs) > 1, client
    except TimeoutError as error:
        _warn_of_loss(_first_line(error))
        return False, None


def _inside_task_of_dask(client):
    if client is None:
        return False
    from distributed import get_worker

    try:
        get_worker()
    except ValueError:
        return False
    return True


def _n_cores(client):
    return sum(client.ncores().values()) if client.status == "running" else 0


def _run_everywhere(client, function, *args):
    """Run a function at once in every worker process of Dask that can be reached."""
    if client is not None and _n_cores(client):
        client.run(function, *args, on_error="ignore")


def _send(client, value):
    """Return a future of the value: the result of a task, which Dask repeats when its worker is lost."""
    import dask

    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"}):
        return client.submit(_identity, value, pure=False)


def _identity(value):
    return value


def _raise_first_error(results):
    for result in results:
        if isinstance(result, Exception):
            raise result


def _first_line(error):
    return f"{type(error).__name__}: {error}".splitlines()[0]


def _warn_of_loss(error):
    warnings.warn(
        f"Work given to other processes or machines did not come back ({error}). It is done in this process instead, "
        "with the same results.",
        RuntimeWarning,
        stacklevel=2,
    )
