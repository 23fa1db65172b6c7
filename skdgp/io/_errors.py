"""FlightReadError, the error of all readers; limits of the number of columns and of the unpacked size."""

from __future__ import annotations

MOST_COLUMNS = 10_000
ROOM, ROOM_PER_BYTE = 2**28, 100
"""Bytes that any file may take when unpacked, and bytes more for each byte of it."""


class FlightReadError(ValueError):
    """A file cannot be read as a flight."""


def check_width(n_columns: int) -> None:
    """Raise a FlightReadError if a table has too many columns."""
    if n_columns > MOST_COLUMNS:
        raise FlightReadError(
            f"Got {n_columns} columns, but expected at most {MOST_COLUMNS}: keep those of the flight, with a row for "
            "each sample."
        )


def room_for(n_bytes: int) -> int:
    """Return how many bytes a file of n_bytes may take when unpacked."""
    return ROOM + ROOM_PER_BYTE * n_bytes


def check_room(needed: int, room: int) -> None:
    """Raise a FlightReadError if what is unpacked takes more bytes than there is room for."""
    if needed > room:
        raise FlightReadError(
            f"Got a file that takes {needed / 2**20:.0f} MiB when unpacked, but expected at most {room / 2**20:.0f} "
            f"MiB (256 MiB and {ROOM_PER_BYTE} times its size): write each flight into a file of its own."
        )
