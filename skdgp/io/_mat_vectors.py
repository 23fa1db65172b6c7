"""Script: write the vectors of the MATLAB file PATH, at most ROOM bytes, to standard output as npz.

    python -P _mat_vectors.py PATH ROOM

It imports nothing of the package, and ends with an exit code where the file is damaged.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat

OVERHEAD = 2**31  # bytes of addresses that NumPy and SciPy take without a file
BYTES_OF_ONE = 256  # that a variable takes besides its values, about


def limit_memory(room: int) -> None:
    """Let this process take no more memory than needed, where the system knows such limits."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (OVERHEAD + 2 * room, OVERHEAD + 2 * room))


def vectors(place: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the vectors of real numbers or texts in a struct, with their places, such as ``log.time``."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from vectors(f"{place}.{key}".lstrip("."), part)
        return
    values = np.atleast_1d(np.asarray(value))
    if not values.size or values.ndim > 1:
        return
    if values.dtype.kind in "biuf":
        yield place, values.astype(float)
    elif all(isinstance(text, str) for text in values.tolist()):
        yield place, values.astype(str)


def main() -> None:
    """Read PATH, and write it within ROOM."""
    path, room = sys.argv[1], int(sys.argv[2])
    limit_memory(room)
    content = loadmat(path, appendmat=False, simplify_cells=True)
    found = dict(
        vectors("", {name: value for name, value in content.items() if not name.startswith("__")})
    )
    size = sum(vector.nbytes + BYTES_OF_ONE for vector in found.values())
    if size > room:
        sys.exit(f"it takes {size / 2**20:.0f} MiB when unpacked, more than {room / 2**20:.0f}")
    file = io.BytesIO()
    np.savez(file, np.array(list(found), dtype=str), *found.values())
    sys.stdout.buffer.write(file.getbuffer())


if __name__ == "__main__":
    main()
