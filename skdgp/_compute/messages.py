"""Warnings with findings, records of warnings, progress of a fit, and missing packages."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType
from typing import Any, TypeAlias

from skdgp._compute.findings import Finding, PlainText

#: Packages that are passed over in the search for the user's line of a warning
LIBRARIES = frozenset(
    {"skdgp", "sklearn", "scipy", "joblib", "contextlib", "functools", "dataclasses"}
)


class FindingWarning(UserWarning):
    """A warning with its ``finding``, None of a warning by a text alone."""

    def __init__(self, content: Finding | str = "") -> None:
        self.finding = content if isinstance(content, Finding) else None
        super().__init__(content.text if isinstance(content, Finding) else content)


_record: ContextVar[list[Finding] | None] = ContextVar("skdgp_findings", default=None)


def report(finding: Finding, category: type[FindingWarning] = FindingWarning) -> None:
    """Warn of a finding; a block around it may record it."""
    _keep(finding)
    warnings.warn(category(finding), stacklevel=_level_of_user())


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn by a text, which is recorded as a finding of the code ``MESSAGE``."""
    _keep(Finding(PlainText.MESSAGE, text=" ".join(message.split())))
    warnings.warn(message, category, stacklevel=_level_of_user())


def _keep(finding: Finding) -> None:
    """Add a finding to the record, if there is one, once."""
    record = _record.get()
    if record is not None and finding not in record:
        record.append(finding)


@contextmanager
def recorded_findings() -> Iterator[list[Finding]]:
    """Record the findings of the package's warnings inside the ``with`` block; they are shown all the same."""
    record: list[Finding] = []
    token = _record.set(record)
    try:
        yield record
    finally:
        _record.reset(token)


def _level_of_user() -> int:
    """Return the ``stacklevel``, seen from the function that warns, of the first line outside of ``LIBRARIES``."""
    level = 0
    frame = inspect.currentframe()
    while frame is not None and _package_of(frame) in LIBRARIES:
        frame = frame.f_back
        level += 1
    return level


def _package_of(frame: FrameType) -> str:
    """Return the first part of the name of a frame's module."""
    return str(frame.f_globals.get("__name__", "")).partition(".")[0]


Listener: TypeAlias = Callable[[str, int, float], Any]

_listener: ContextVar[Listener | None] = ContextVar("skdgp_progress", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    It is called after every evaluation of the likelihood. ``stage`` is "output 1", ... where each
    output is fitted alone, "fit" where all are fitted together, "members" where components of the
    average learn their noise; ``n_evaluations`` counts the evaluations of a stage;
    ``log_likelihood`` is the best so far. Fits in other processes do not call it.

    An error that the listener raises leaves ``fit``, as Ctrl-C does.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor, listening
    >>> x, calls = np.linspace(0.0, 6.0, 40)[:, None], []
    >>> with listening(lambda stage, n_evaluations, log_likelihood: calls.append((stage, n_evaluations))):
    ...     model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
    >>> calls[0]
    ('output 1', 1)
    """
    heard = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(heard)


class Progress(str):
    """A stage of which ``done`` of ``total`` steps are done; a search may converge before."""

    __slots__ = ("done", "total")
    done: int
    total: int

    def __new__(cls, stage: str, done: int, total: int) -> Progress:
        progress = super().__new__(cls, stage)
        progress.done = done
        progress.total = total
        return progress


def notify(stage: str, n_evaluations: int = 0, log_likelihood: float = float("nan")) -> None:
    """Call the listener, if there is one; of a stage that has no evaluations, with 0 and NaN."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def extra(package: str, name: str) -> Any:
    """Return a package of an extra; if it is absent, raise an ImportError that names the extra."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f"This needs {package.partition('.')[0]}, which is not installed: "
            f"pip install 'skdgp[{name}]'."
        ) from error
