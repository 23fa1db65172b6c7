"""Script: write the vectors of the MATLAB file PATH, at most ROOM bytes, to standard output, pickled.

    python -P _mat_script.py PATH ROOM

It imports nothing of the package, and ends with an exit code where the file is damaged.
"""

from __future__ import annotations

import contextlib
import pickle
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat

OVERHEAD = 2**31  # bytes of addresses that NumPy and SciPy take without a file


def _vectors(place: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the vectors of real numbers or texts in a struct, with their places, such as ``log.time``."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _vectors(f"{place}.{key}".lstrip("."), part)
        return
    values = np.atleast_1d(np.asarray(value))
    is_number = values.dtype.kind in "biuf"
    is_text = not is_number and all(isinstance(text, str) for text in values.ravel())
    if values.size and values.ndim == 1 and (is_text or is_number):
        yield place, values.astype(str if is_text else float)


def main() -> None:
    """Read PATH, and write it within ROOM."""
    path, room = sys.argv[1], int(sys.argv[2])
    with contextlib.suppress(ImportError, ValueError, OSError):  # systems without such limits
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (OVERHEAD + 2 * room, OVERHEAD + 2 * room))
    content = loadmat(path, appendmat=False, simplify_cells=True)
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    vectors = pickle.dumps(dict(_vectors("", variables)), protocol=5)
    if len(vectors) > room:
        sys.exit(f"it takes {len(vectors) >> 20} MiB when unpacked, more than {room >> 20}")
    sys.stdout.buffer.write(vectors)


if __name__ == "__main__":
    main()
