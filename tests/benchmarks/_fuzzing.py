"""What the campaigns of the fuzz share: the outcome of a case, and the workers that run cases."""

import contextlib
import multiprocessing
import re
import resource
import time
import traceback
import warnings
from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np
from _common import _field
from threadpoolctl import threadpool_limits

MEMORY = 8 * 2**30  # bytes of addresses that a worker may ask for
LONGEST = 60.0  # s, after which a case counts as one without an end
FOREIGN, DIFFERENT = "foreign", "different"
OURS = re.compile(r"/skdgp/(?!.*/tests/)(.+\.py)$")


class Difference(Exception):
    """What came out is wrong, and nothing said so. The first word names the check."""


class Result(NamedTuple):
    """One case: ``outcome`` is the campaign's own word, "refused", FOREIGN or DIFFERENT."""

    number: int
    outcome: str
    seconds: float
    what: str = ""


class Campaign(NamedTuple):
    """Cases by number: ``prepare(folder, seed)`` returns what a worker needs, ``case(prepared, rng)`` a word.

    ``case`` raises Difference where something is wrong in silence; any other exception is foreign.
    """

    name: str
    count: int
    share: float  # of the time
    accepted: str
    prepare: object
    case: object


@contextlib.contextmanager
def only(*messages, others=()):
    """Let documented warnings pass, by what they say or by their classes; any other one is an exception."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for message in messages:
            warnings.filterwarnings("ignore", message, UserWarning)
        for category in others:
            warnings.simplefilter("ignore", category)
        yield


def judged(campaign, prepared, seed, number) -> Result:
    """Run one case."""
    began = time.monotonic()
    try:
        outcome, what = campaign.case(prepared, rng_of(campaign, seed, number)), ""
    except Difference as found:
        outcome, what = DIFFERENT, str(found)
    except (Exception, Warning) as error:
        outcome, what = FOREIGN, described(error)
    return Result(number, outcome, time.monotonic() - began, what)


def rng_of(campaign, seed, number):
    return np.random.default_rng([seed, *campaign.name.encode(), number])


def described(error) -> str:
    """Return the type of an exception, where in the package it came from, and what it says."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [(match[1], frame.name) for frame in frames if (match := OURS.search(frame.filename))]
    where = "{}:{}".format(*ours[-1]) if ours else f"{Path(frames[-1].filename).name}:{frames[-1].name}"
    return f"{type(error).__name__} in {where}: {' '.join(str(error).split())[:200]}"


def kind_of(what: str) -> str:
    """Return what failures of one kind have in common: all but the numbers."""
    return re.sub(r"[-+]?[\d.]*\d(e[-+]?\d+)?", "#", what.split("; ")[0])[:110]


def run(campaign, seed, folder, jobs, seconds, count, told=print):
    """Return one row of counts, and rows of failures, of cases 0 to ``count`` as far as the time allows."""
    began = time.monotonic()
    tally, shown = _Tally(campaign), Counter()

    def take(result, memory):
        kind = tally.add(result)
        if kind and (shown.update([kind]) or shown[kind] <= 3):
            told(f"  {campaign.name}:{result.number} {result.outcome}: {result.what}")
        tally.memory = max(tally.memory, memory)

    if jobs:
        _in_workers(campaign, seed, folder, jobs, began + seconds, count, take)
    else:
        for result, memory in _results(campaign, seed, folder, range(count), began + seconds):
            take(result, memory)
    return tally.row(count, time.monotonic() - began), tally.failures()


def _results(campaign, seed, folder, numbers, deadline):
    """Yield the results of cases and the peak of the memory, as far as the time allows."""
    prepared = campaign.prepare(Path(folder), seed)
    for number in numbers:
        yield judged(campaign, prepared, seed, number), _peak()
        if time.monotonic() > deadline:
            return


class _Tally:
    def __init__(self, campaign):
        self.campaign, self.counts, self.kinds = campaign, Counter(), {}
        self.longest, self.memory = Result(-1, "", 0.0), 0

    def add(self, result):
        """Count a result and return the kind of its failure, if it is one."""
        self.counts[result.outcome] += 1
        self.longest = max(self.longest, result, key=lambda each: each.seconds)
        if result.outcome not in (FOREIGN, DIFFERENT):
            return None
        kind = kind_of(result.what)
        self.kinds.setdefault((result.outcome, kind), []).append(result)
        return kind

    def row(self, wanted, seconds):
        done = sum(self.counts.values())
        return {
            "campaign": self.campaign.name,
            "cases": done,
            "ended by": "count" if done >= wanted else "time",
            "accepted": self.counts[self.campaign.accepted],
            "refused": self.counts["refused"],
            "foreign exceptions": self.counts[FOREIGN],
            "silent differences": self.counts[DIFFERENT],
            "peak memory MB": round(self.memory / 1e6),
            "longest case s": self.longest.seconds,
            "which": f"{self.campaign.name}:{self.longest.number}",
            "seconds": round(seconds),
            "cases / s": round(done / max(seconds, 1e-9)),
        }

    def failures(self):
        """Return one row for each kind of failure, the most frequent first."""
        rows = sorted(self.kinds.items(), key=lambda item: -len(item[1]))
        return [
            {
                "campaign": self.campaign.name,
                "outcome": outcome,
                "cases": len(results),
                "first": f"{self.campaign.name}:{min(result.number for result in results)}",
                "what": min(results).what,
            }
            for (outcome, _), results in rows
        ]


# -- workers ---------------------------------------------------------------------------------------------


def _in_workers(campaign, seed, folder, jobs, deadline, count, take):
    """Run every ``jobs``-th case in a process; one that dies or hangs fails its case, and another takes up the rest."""
    context, lock = multiprocessing.get_context("spawn"), Lock()

    def work(first):
        left = deque(range(first, count, jobs))
        while left and time.monotonic() < deadline:
            pipe, theirs = context.Pipe(duplex=False)
            words = (theirs, campaign, seed, str(folder), list(left), deadline)
            process = context.Process(target=_work, args=words, daemon=True)
            process.start()
            theirs.close()
            why = "the process died"
            with contextlib.suppress(EOFError):
                while pipe.poll(LONGEST):
                    result, memory = pipe.recv()
                    left.popleft()
                    with lock:
                        take(result, memory)
                why = f"no end within {LONGEST:g} s"
                process.kill()
            process.join()
            if process.exitcode == 1:
                raise RuntimeError(f"A worker of {campaign.name} failed between two cases.")
            if process.exitcode:
                with lock:
                    take(Result(left.popleft(), FOREIGN, LONGEST, f"{why} (exit code {process.exitcode})"), 0)

    with ThreadPoolExecutor(jobs) as threads:
        list(threads.map(work, range(jobs)))


def _work(pipe, *words):
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with threadpool_limits(1):
        for each in _results(*words):
            pipe.send(each)


def _peak():
    return _field("/proc/self/status", "VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
