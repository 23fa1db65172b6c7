"""Progress of a fit, for a listener."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeAlias

__all__ = ["listening", "notify"]

Listener: TypeAlias = Callable[[str, int, float], Any]

_listener: ContextVar[Listener | None] = ContextVar("skdgp_progress", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    It is called after every evaluation of the likelihood. ``stage`` is "output 1", ... where each
    output is fitted alone, "fit" where all are fitted together, "members" where components of the
    average learn their noise; ``n_evaluations`` counts the evaluations of a stage;
    ``log_likelihood`` is the best so far. An error that the listener raises reaches the fit:
    KeyboardInterrupt ends the search as Ctrl-C does, with the best so far. Fits that ``n_jobs``
    moves to other processes do not call it.

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
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def notify(stage: str, n_evaluations: int = 0, log_likelihood: float = float("nan")) -> None:
    """Call the listener, if there is one; of a stage that has no evaluations, with 0 and NaN."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)
