"""Warnings that a caller records or silences for itself: no filter of the process changes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass
class Messages:
    """Messages of warnings, each once, and the kinds that are ignored, by category and first words."""

    texts: list[str] = field(default_factory=list)
    ignored: list[tuple[type[Warning], str]] = field(default_factory=list)

    def ignore(self, category: type[Warning], start: str = "") -> None:
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
