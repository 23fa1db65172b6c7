"""Memory of the machine, and a check that matrices fit into it."""

from __future__ import annotations

import os


def check_memory(n_values: int, what: str, remedy: str, n_matrices: int = 2) -> None:
    """Refuse what needs so many matrices of n_values x n_values doubles and would not fit the machine."""
    needed, there = 8 * n_matrices * n_values**2, _physical_memory()
    if needed > 0.8 * there:
        raise ValueError(
            f"{what} {n_values} values needs about {needed / 2**30:.0f} GiB, but this machine has "
            f"{there / 2**30:.0f} GiB. {remedy}"
        )


def _physical_memory():
    """Return the machine's memory in bytes; infinite where it cannot be told."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return float("inf")
