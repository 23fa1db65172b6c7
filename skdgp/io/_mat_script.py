"""Script: write the vectors of the MATLAB file PATH, at most ROOM bytes, to standard output, pickled.

    python -P _mat_script.py PATH ROOM

It imports nothing of the package, and ends with an exit code where the file is damaged.
"""

from __future__ import annotations

import contextlib
import pickle
import sys
from typing import Any

import numpy as np
from scipy.io import loadmat

OVERHEAD = 2**31  # bytes of addresses that NumPy and SciPy take without a file


def _vectors(struct: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the vectors of real numbers or texts in a struct."""
    vectors = {}
    for name, value in struct.items():
        values = np.atleast_1d(np.asarray(value))
        kind = float if values.dtype.kind in "biuf" else str
        is_text = all(isinstance(text, str) for text in values.ravel())
        if values.size and values.ndim == 1 and (kind is float or is_text):
            vectors[name] = values.astype(kind)
    return vectors


def main() -> None:
    """Read PATH, and write it within ROOM."""
    path, room = sys.argv[1], int(sys.argv[2])
    with contextlib.suppress(ImportError, ValueError, OSError):  # systems without such limits
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (OVERHEAD + 2 * room, OVERHEAD + 2 * room))
    content = loadmat(path, appendmat=False, simplify_cells=True)
    loose = {name: value for name, value in content.items() if not name.startswith("__")}
    structs = {"": loose} | {name: part for name, part in loose.items() if isinstance(part, dict)}
    tables = {name: _vectors(part) for name, part in structs.items()}
    vectors = pickle.dumps(tables, protocol=5)
    if len(vectors) > room:
        sys.exit(f"it takes {len(vectors) >> 20} MiB when unpacked, more than {room >> 20}")
    sys.stdout.buffer.write(vectors)


if __name__ == "__main__":
    main()
