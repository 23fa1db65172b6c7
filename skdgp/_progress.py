"""How a long fit tells whoever is listening where it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_listener: ContextVar[Callable[[str, int, float], None] | None] = ContextVar("skdgp_progress", default=None)


@contextmanager
def listening(listener: Callable[[str, int, float], None]) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    Examples
    --------
    >>> from skdgp._progress import listening, tell
    >>> with listening(lambda stage, n, value: print(stage, n, value)):
    ...     tell("fit", 1, -3.5)
    fit 1 -3.5
    """
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(stage: str, n_evaluations: int, log_likelihood: float) -> None:
    """Tell the listener, if there is one."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)
