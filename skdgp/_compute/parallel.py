"""Parallel work through joblib's active backend; work lost with a worker is done again.

Who works is decided where a piece of work begins: nobody else unless ``joblib.parallel_config`` or ``n_jobs`` asks for
it. Results stand in the order of the tasks, so sums keep their bits wherever their parts were summed.
"""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
import warnings
from asyncio import CancelledError, run_coroutine_threadsafe
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from numbers import Integral
from uuid import uuid4

from joblib import Parallel, cpu_count, delayed, effective_n_jobs
from joblib.parallel import get_active_backend

from skdgp._compute.progress import listening
from skdgp._compute.threads import one_blas_thread, thread_map

TRIES = 2  # of every task elsewhere, before it is done here
FAILURES = 3  # evaluations in a row that failed elsewhere, before all are done here
PATIENCE = 1.0  # seconds between looks at who is still there
PAUSE = 0.2  # seconds for a scheduler to see who has died

_crew: ContextVar[_Crew | None] = ContextVar("skdgp_crew", default=None)
_stopped: set[str] = set()  # names of the work that shall come to an end, in this process
_former: list = []  # what Ctrl-C did before, in this process


def check_n_jobs(n_jobs) -> None:
    """Raise ValueError where a number of processes makes no sense."""
    cpus = cpu_count()
    sense = isinstance(n_jobs, Integral) and not isinstance(n_jobs, bool) and n_jobs != 0 and n_jobs >= -cpus
    if n_jobs is not None and not sense:
        raise ValueError(
            f"Got n_jobs={n_jobs!r}, but expected None (what joblib.parallel_config says, else one process), a number "
            f"of processes from 1 on, or counted from all processors: -1 is all {cpus} of this machine, -2 all but one."
        )


# -- the same shares, again and again ------------------------------------------------------------------


def share_map(function: Callable, state: tuple, shares: Sequence) -> list:
    """Return ``[function(*state, share) for share in shares]``.

    ``function`` stands at module level; ``state`` changes from call to call, ``shares`` are the same objects in every
    call of a fit. Threads do the work, or the workers that hold the shares, see ``sharing``.
    """
    crew = _crew.get()
    if crew is not None and crew.shares is shares:
        return crew.map(function, state)
    return thread_map(lambda share: function(*state, share), shares)


@contextmanager
def sharing(shares: Sequence) -> Iterator[None]:
    """Let joblib's active backend, if it has other processes or machines, hold the shares and work on them.

    The shares are sent once, the state with every call. What a worker was to do when it died, others do; where none
    is left, the call is finished here, with a warning.
    """
    workers = _workers(None)
    token = _crew.set(_Crew(workers, shares) if workers else None)
    try:
        yield
    finally:
        _crew.reset(token)


class _Crew:
    """Workers and the shares that they hold."""

    def __init__(self, workers, shares):
        self.workers, self.shares, self.failures, self.warned = workers, shares, 0, False

    def map(self, function, state):
        error = "no worker is left"
        for _ in range(TRIES):
            try:
                n = min(self.workers.count(), len(self.shares))
                if n == 0 or self.failures >= FAILURES:
                    break
                parts = self.workers.work(function, state, [self.shares[k::n] for k in range(n)])
            except (Exception, CancelledError) as caught:
                error = _in_short(caught)
                self.workers.forget()
            else:
                self.failures = 0
                _raise_first(parts)
                return [parts[k % n][k // n] for k in range(len(self.shares))]
        return self._here(function, state, error)

    def _here(self, function, state, error):
        self.failures += error != "no worker is left"
        if not self.warned:
            self.warned = True
            _warn_of_loss(error)
        return thread_map(lambda share: function(*state, share), self.shares)


def _work(function, state, shares):
    """Be a worker: one core, so one thread of BLAS. What the function raises is a result too."""
    try:
        with one_blas_thread():
            return [function(*state, share) for share in shares]
    except MemoryError:
        raise  # another machine may have more
    except Exception as error:
        return error


def _same(thing):
    return thing


def _raise_first(results):
    for result in results:
        if isinstance(result, Exception):
            raise result


def _in_short(error):
    return f"{type(error).__name__}: {error}".splitlines()[0]


def _warn_of_loss(error):
    warnings.warn(
        f"Work given to other processes or machines did not come back ({error}). Nothing is lost: it was done in this "
        "process.",
        RuntimeWarning,
        stacklevel=2,
    )


# -- whole fits side by side ---------------------------------------------------------------------------


def fit_map(fit: Callable, starts: Sequence[dict], n_jobs=None) -> list:
    """Return ``[fit(**start) for start in starts]``, side by side where joblib has workers.

    What ``fit`` returns says in ``interrupted`` whether Ctrl-C ended it early. Then the list holds what was found so
    far, the best of every fit that had begun. A second Ctrl-C interrupts as ever.
    """
    workers = _workers(n_jobs, threads=True) if len(starts) > 1 else None
    found = _elsewhere(workers, fit, starts) if workers else {}
    for k, start in enumerate(starts):
        if any(end.interrupted for end in found.values()):
            break
        if k not in found:
            found[k] = fit(**start)
    return [found[k] for k in sorted(found)]


def _elsewhere(workers, fit, starts):
    """Return the fits that workers could finish or, interrupted, begin; Ctrl-C when none was begun."""
    found, error = {}, "interrupted there"
    name = os.path.join(tempfile.gettempdir(), f"skdgp-stop-{uuid4().hex}")
    stop = threading.Event()
    with _first_interrupt(stop, name):
        for _ in range(TRIES):
            left = {k: start for k, start in enumerate(starts) if k not in found}
            if stop.is_set() or not left:
                break
            try:
                for k, end in workers.fits(fit, name, left, stop):
                    found[k] = end
            except (Exception, CancelledError) as caught:
                error = _in_short(caught)
    _raise_first(found.values())
    ends = {k: end for k, end in found.items() if end is not None}
    if stop.is_set():
        if not ends:
            raise KeyboardInterrupt
        return {k: end._replace(interrupted=True) for k, end in ends.items()}
    if len(ends) < len(starts):
        _warn_of_loss(error)
    return ends


@contextmanager
def _first_interrupt(stop, name):
    """Let the first Ctrl-C set ``stop`` and lay down a file that workers of this machine see."""
    former = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(former):
        yield
        return

    def ask_to_stop(*_):
        signal.signal(signal.SIGINT, former)
        stop.set()
        with open(name, "w"):
            pass

    signal.signal(signal.SIGINT, ask_to_stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)
        with suppress(FileNotFoundError):
            os.remove(name)


def _fit(fit, name, k, start):
    """Be a worker that stops when the work of that name shall stop; None where there is nothing to keep yet."""

    def heed(*_):
        if name in _stopped or os.path.exists(name):
            raise KeyboardInterrupt

    try:
        with listening(heed):
            return k, fit(**start)
    except KeyboardInterrupt:
        return k, None
    except MemoryError:
        raise
    except Exception as error:
        return k, error


def _stop_here(name):
    _stopped.add(name)


def _be_deaf(deaf):
    """Let a worker live through a Ctrl-C that is meant for who sent it work: in a terminal it reaches all processes."""
    with suppress(ValueError):  # not the main thread of a process: nothing reaches it
        if deaf:
            _former.append(signal.signal(signal.SIGINT, signal.SIG_IGN) or signal.SIG_DFL)
        elif _former:
            signal.signal(signal.SIGINT, _former.pop())


def _fit_on_one_core(*task):
    with one_blas_thread():
        return _fit(*task)


# -- who works -----------------------------------------------------------------------------------------


def _workers(n_jobs, threads=False):
    """Return the workers of joblib's active backend, or None where this process works alone."""
    backend, _ = get_active_backend()
    client = getattr(backend, "client", None)
    if n_jobs == 1 or backend.nesting_level or _inside_a_task(client):
        return None  # the outermost loop is the one that is spread
    if getattr(backend, "supports_sharedmem", False) and not threads:
        return None
    try:
        n = effective_n_jobs(n_jobs)
    except TimeoutError as error:
        _warn_of_loss(_in_short(error))
        return None
    if n < 2:
        return None
    return _Cluster(client) if hasattr(client, "scatter") else _Pool(n_jobs)


def _inside_a_task(client):
    if client is None:
        return False
    from distributed import get_worker

    try:
        get_worker()
    except ValueError:
        return False
    return True


class _Pool:
    """The processes of any backend of joblib."""

    def __init__(self, n_jobs):
        self.n_jobs = n_jobs

    def count(self):
        return effective_n_jobs(self.n_jobs)

    def work(self, function, state, parts):
        return Parallel(n_jobs=self.n_jobs)(delayed(_work)(function, state, part) for part in parts)

    def forget(self):
        """Nothing is held: joblib maps large arrays into memory that the processes share."""

    def fits(self, fit, name, starts, stop):
        backend, _ = get_active_backend()
        unordered = getattr(backend, "supports_return_generator", False)
        parallel = Parallel(n_jobs=self.n_jobs, return_as="generator_unordered" if unordered else "list")
        yield from parallel(delayed(_fit)(fit, name, k, start) for k, start in starts.items())


class _Cluster:
    """The workers of dask.distributed."""

    def __init__(self, client):
        self.client, self.held = client, []

    def count(self):
        return sum(self.client.ncores().values()) if self.client.status == "running" else 0

    def work(self, function, state, parts):
        if len(self.held) != len(parts):
            self.held = self.client.scatter(parts, hash=False)
        told = self._tell(state)
        futures = [self.client.submit(_work, function, told, part, pure=False) for part in self.held]
        try:
            return self._fetch(futures)
        finally:
            self._drop(futures)

    def forget(self):
        self.held = []
        time.sleep(PAUSE)

    def fits(self, fit, name, starts, stop):
        told = self._tell(fit)
        self._order(_be_deaf, True)
        futures = {
            self.client.submit(_fit_on_one_core, told, name, k, start, pure=False): k for k, start in starts.items()
        }
        asked = False
        try:
            while futures:
                self._wait_for_one(list(futures))
                if stop.is_set() and not asked:
                    asked = True
                    self._order(_stop_here, name)
                for future in [future for future in futures if future.done()]:
                    yield self._fetch(future)
                    del futures[future]
        finally:
            self._drop(list(futures))
            self._order(_be_deaf, False)

    def _tell(self, thing):
        """Send something so that it outlives every worker: as a task, which the scheduler can have done again."""
        import dask

        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"}):
            return self.client.submit(_same, thing, pure=False)

    def _order(self, function, *words):
        """Have every worker process do something at once, of those that can be reached."""
        if self.count():
            self.client.run(function, *words, on_error="ignore")

    def _wait_for_one(self, futures):
        """Return when one of them is done, or after a moment."""
        from distributed import wait

        try:
            with self.client.as_current():
                wait(futures, timeout=PATIENCE, return_when="FIRST_COMPLETED")
        except TimeoutError:
            self._check()

    def _fetch(self, futures):
        """Return the results when they are there."""
        results = self.client.gather(futures, asynchronous=True)
        coming = run_coroutine_threadsafe(results, self.client.loop.asyncio_loop)
        while True:
            try:
                return coming.result(PATIENCE)
            except TimeoutError:
                if coming.done():
                    raise
                self._check()

    def _check(self):
        """Raise RuntimeError where nobody is left to wait for: dask would wait for ever."""
        if self.count() == 0:
            raise RuntimeError("no worker is left")

    def _drop(self, futures):
        if self.client.status == "running":
            self.client.cancel([future for future in futures if not future.done()])
