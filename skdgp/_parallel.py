"""Work on shares of the data, wherever it is done."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skdgp._threads import thread_map


def share_map(function: Callable, state: tuple, shares: Sequence) -> list:
    """Return ``[function(*state, share) for share in shares]``.

    ``function`` stands at module level; ``state`` changes from call to call, ``shares`` are the same objects in every
    call of a fit.
    """
    return thread_map(lambda share: function(*state, share), shares)
