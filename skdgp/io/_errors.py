"""FlightReadError, the one error of the readers; limits of columns and of unpacked size."""

from __future__ import annotations

WIDEST = 10_000
"""Columns that a table may have."""
ALWAYS, TIMES = 2**28, 100
"""Bytes that any file may take when unpacked, and how many times its own size a file may take beyond."""


class FlightReadError(ValueError):
    """A file could not be read as a flight: what was got, what was expected, what to do."""


def check_width(n_columns: int) -> None:
    """Raise a FlightReadError if a table has too many columns."""
    if n_columns > WIDEST:
        raise FlightReadError(
            f"Got {n_columns} columns, but expected at most {WIDEST}: keep those of the flight, a row for each sample."
        )


def room_for(n_bytes: int) -> int:
    """Return how many bytes a file of n_bytes may take when unpacked."""
    return ALWAYS + TIMES * n_bytes


def check_room(needed: int, room: int) -> None:
    """Raise a FlightReadError if what is unpacked takes more bytes than there is room for."""
    if needed > room:
        raise FlightReadError(
            f"Got a file that takes {needed / 2**20:.0f} MiB when unpacked, but expected at most {room / 2**20:.0f} "
            f"MiB (256 MiB and {TIMES} times its size): write each flight into a file of its own."
        )
