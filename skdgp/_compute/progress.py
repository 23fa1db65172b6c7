"""Listeners to the progress of a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_listener: ContextVar[Callable[[str, int, float], None] | None] = ContextVar("skdgp_progress", default=None)


@contextmanager
def listening(listener: Callable[[str, int, float], None]) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    Parameters
    ----------
    listener : callable
        Called after every evaluation of the likelihood. ``stage`` is "output 1", ... where each output is fitted alone,
        side by side, "fit" where all are fitted together, "bound" where inducing inputs are placed; ``n_evaluations``
        counts those of a stage; ``log_likelihood`` is the best so far. What it raises reaches the fit:
        KeyboardInterrupt ends the search as Ctrl-C does, with the best so far. Restarts in other processes are not
        heard.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor, listening
    >>> x, heard = np.linspace(0.0, 6.0, 40)[:, None], []
    >>> with listening(lambda stage, n_evaluations, log_likelihood: heard.append((stage, n_evaluations))):
    ...     model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
    >>> heard[0], len(heard) == model.n_evaluations_
    (('fit', 1), True)
    """
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def listening_too(listener: Callable[[str, int, float], None]) -> Iterator[None]:
    """Call the listener inside the block after who listens already."""
    former = _listener.get()

    def tell_both(*news):
        if former is not None:
            former(*news)
        listener(*news)

    with listening(tell_both):
        yield


def tell(stage: str, n_evaluations: int, log_likelihood: float) -> None:
    """Tell the listener, if there is one."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)
