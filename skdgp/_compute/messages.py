"""Messages to who runs a fit: warnings, its progress, for a listener, and packages that are not installed."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeAlias


@dataclass
class Messages:
    """Messages of warnings, each once, and the kinds that are ignored, by category and first words."""

    texts: list[str] = field(default_factory=list)
    ignored: list[tuple[type[Warning], str | tuple[str, ...]]] = field(default_factory=list)

    def ignore(self, category: type[Warning], start: str | tuple[str, ...] = "") -> None:
        """Ignore warnings of a category whose text begins so, until the end of the block."""
        self.ignored.append((category, start))

    def takes(self, text: str, category: type[Warning]) -> bool:
        """Return whether a warning is ignored; record its text if it is not."""
        if any(
            issubclass(category, kind) and text.startswith(start) for kind, start in self.ignored
        ):
            return True
        if text not in self.texts:
            self.texts.append(text)
        return False


_active: ContextVar[tuple[Messages, ...]] = ContextVar("skdgp_messages", default=())


def warn(message: str, category: type[Warning] = UserWarning, stacklevel: int = 1) -> None:
    """Warn as ``warnings.warn``, unless a block around it ignores the message; the outer blocks may record it."""
    text = " ".join(message.split())
    if not any(messages.takes(text, category) for messages in reversed(_active.get())):
        warnings.warn(message, category, stacklevel=stacklevel + 1)


@contextmanager
def _within(messages: Messages) -> Iterator[Messages]:
    token = _active.set((*_active.get(), messages))
    try:
        yield messages
    finally:
        _active.reset(token)


def recorded_warnings() -> AbstractContextManager[Messages]:
    """Record the package's warnings inside the ``with`` block; they are shown all the same."""
    return _within(Messages())


def without_warnings(
    category: type[Warning] = Warning,
) -> AbstractContextManager[Messages]:
    """Ignore the package's warnings of a category inside the ``with`` block, in this thread alone."""
    return _within(Messages(ignored=[(category, "")]))


Listener: TypeAlias = Callable[[str, int, float], Any]

_listener: ContextVar[Listener | None] = ContextVar("skdgp_progress", default=None)
_keeps_best: ContextVar[bool] = ContextVar("skdgp_keeps_best", default=False)


@contextmanager
def listening(listener: Listener, *, keep_best: bool = False) -> Iterator[None]:
    """Call ``listener(stage, n_evaluations, log_likelihood)`` during every fit inside the ``with`` block.

    It is called after every evaluation of the likelihood. ``stage`` is "output 1", ... where each
    output is fitted alone, "fit" where all are fitted together, "members" where components of the
    average learn their noise; ``n_evaluations`` counts the evaluations of a stage;
    ``log_likelihood`` is the best so far. Fits in other processes do not call it.

    An error that the listener raises leaves ``fit``, as Ctrl-C does. With ``keep_best`` a
    KeyboardInterrupt, by the listener or by Ctrl-C, ends the search instead: ``fit`` returns the
    best model so far, with a ConvergenceWarning. Do not use it around a search over candidates,
    whose scores would be of unfinished fits.

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
    kept = _keeps_best.set(keep_best)
    try:
        yield
    finally:
        _keeps_best.reset(kept)
        _listener.reset(heard)


def keeps_best() -> bool:
    """Return whether an interrupted fit keeps the best so far, see ``listening``."""
    return _keeps_best.get()


def notify(stage: str, n_evaluations: int = 0, log_likelihood: float = float("nan")) -> None:
    """Call the listener, if there is one; of a stage that has no evaluations, with 0 and NaN."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, n_evaluations, log_likelihood)


def extra(package: str, name: str) -> Any:
    """Return a package of an extra; raise ImportError, with what to install, if it is absent."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f"This needs {package.partition('.')[0]}, which is not installed: "
            f"pip install 'skdgp[{name}]'."
        ) from error
