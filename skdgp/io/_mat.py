"""MATLAB tables: vectors named as columns, loose or as fields of one struct, in files of versions 5 to 7.

``scipy.io.loadmat`` trusts types and sizes in a file: of 3000 damaged files 18 end the process
(SciPy 1.17.1; https://github.com/scipy/scipy/issues/6072). So every element is checked first. The
format is that of MathWorks, MAT-File Format (R2019b): nested elements, each after its type and size.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS
from skdgp.io._tables import FlightReadError, base_name, check_room, check_width, room_for

HDF5 = b"MATLAB 7.3"
HEADER_SIZE = 128
ORDER = {b"IM": "little", b"MI": "big"}  # of the bytes of numbers, by the end of the header
MATRIX, COMPRESSED = 14, 15
KINDS = {*range(1, 8), 9, *range(12, 19)}  # of elements: numbers, texts, these two
HEAD = b"\6\5\1"  # kinds of the first elements of a matrix: flags, shape, name
CELL, STRUCT, TEXT, NUMBERS, OPAQUE = 1, 2, 4, range(6, 16), 17  # classes of matrices
OBJECT = b"\6\1\1\1\16"  # kinds of the elements of an opaque object, such as a string
MATRICES = bytes([MATRIX])
BYTES_OF_ONE = 256  # that a variable, field or cell takes in Python, about
DEEPEST = 8  # levels of structs and cells
MOST_ELEMENTS = 50_000  # each is checked in Python, and becomes an array of its own


def read_mat(path: Path) -> pd.DataFrame:
    """Return the table of a MATLAB file; raise FlightReadError if it is damaged or holds no table with ``time``."""
    from scipy.io import loadmat

    data = path.read_bytes()
    if data.startswith(HDF5):
        raise FlightReadError(
            "Got a file of MATLAB's version 7.3 (HDF5), but expected version 7 or earlier: "
            "save('flight.mat', '-v7', ...) in MATLAB, or writetable(..., 'flight.csv')."
        )
    try:
        order = ORDER.get(data[126:128])
        if order is None:
            raise ValueError("it does not begin as a MAT-file of version 5 to 7 does")
        _Check(order, room_for(len(data))).elements(memoryview(data)[HEADER_SIZE:])
        content = loadmat(path, appendmat=False, simplify_cells=True)
    except FlightReadError:
        raise
    except Exception as error:  # a damaged file makes SciPy raise nearly anything
        raise FlightReadError(
            f"Got a file that is not a whole MATLAB file ({error}), but expected one of version 5 "
            f"to 7: save it again, with '-v7'."
        ) from error
    return _table({name: value for name, value in content.items() if not name.startswith("__")})


def _table(content: dict[str, Any]) -> pd.DataFrame:
    check_width(len(content))
    tables = {name: vectors for name, vectors in _structs("", content) if "time" in vectors}
    if len(tables) != 1:
        names = [name or "loose vectors" for name in tables]
        lacking = f"no vector 'time' among {sorted(content)[:12]}"
        raise FlightReadError(
            f"Got {f'several tables, {names}' if names else lacking}, but expected one: vectors "
            "of equal length, loose or in one struct (of a MATLAB table: table2struct(T, "
            "'ToScalar', true))."
        )
    (vectors,) = tables.values()
    n = len(vectors["time"])
    uneven = {
        name: len(vector)
        for name, vector in vectors.items()
        if len(vector) != n and base_name(name) in CHANNELS
    }
    if uneven:
        raise FlightReadError(
            f"Got vectors of lengths {uneven}, but expected {n}, as many values as time has."
        )
    return pd.DataFrame({name: vector for name, vector in vectors.items() if len(vector) == n})


def _structs(name: str, content: dict[str, Any]) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Yield the struct's own vectors, then those of the structs in it."""
    vectors = {key: _vector(value) for key, value in content.items()}
    yield name, {key: vector for key, vector in vectors.items() if vector is not None}
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _structs(f"{name}.{key}".lstrip("."), value)


def _vector(value: Any) -> np.ndarray | None:
    """Return real numbers or texts as a vector, or None if they are none."""
    values = np.atleast_1d(np.asarray(value)) if not isinstance(value, dict) else np.empty(0)
    if not values.size or values.ndim > 1:
        return None
    if values.dtype.kind in "biuf":
        return values.astype(float)
    texts = [text for text in values.tolist() if isinstance(text, str)]
    return np.array(texts, dtype=object) if len(texts) == values.size else None


class _Check:
    """Check of all elements of a file, whose contents may take ``room`` bytes."""

    def __init__(self, order: str, room: int) -> None:
        self.order, self.room, self.used = order, room, 0
        self.n_elements = 0

    def _use(self, n_bytes: int) -> None:
        self.used += n_bytes
        check_room(self.used, self.room)

    def _int(self, data: memoryview | bytes) -> int:
        return int.from_bytes(data, "little" if self.order == "little" else "big", signed=True)

    def elements(self, data: memoryview, depth: int = 0) -> tuple[bytearray, list[memoryview]]:
        """Return types of the elements that stand one after another, and the contents of the first.

        Raise ValueError if one is of no known type, or larger than what it is in.
        """
        kinds = bytearray()
        contents: list[memoryview] = []
        position = 0
        while position + 8 <= len(data):
            kind, size = (self._int(data[position + k : position + k + 4]) for k in (0, 4))
            start = position + 8
            if kind >> 16:  # up to four bytes stand in the place of the size
                kind, size, start = kind & 0xFFFF, kind >> 16, position + 4
            if kind not in KINDS or not 0 <= size <= len(data) - start:
                raise ValueError(f"an element of type {kind} and {size} bytes is none")
            content = data[start : start + size]
            if kind == COMPRESSED:
                self.elements(self._unpacked(content), depth)
            elif kind == MATRIX:
                self._matrix(content, depth + 1)
            self.n_elements += 1
            if self.n_elements > MOST_ELEMENTS:
                raise FlightReadError(
                    f"Got a MATLAB file of more than {MOST_ELEMENTS} arrays, but expected vectors: "
                    "save columns as vectors, or as a struct of vectors."
                )
            kinds.append(kind)
            contents += [content] * (len(contents) < len(OBJECT))
            padded = size if kind == COMPRESSED else (size + 7) // 8 * 8
            position = position + 8 if start == position + 4 else start + padded
        return kinds, contents

    def _unpacked(self, content: memoryview) -> memoryview:
        """Return a compressed element; its size stands in its first bytes and is checked first."""
        head = zlib.decompressobj().decompress(content, 8)
        size = 8 + max(self._int(head[4:8]), 0)
        self._use(size)
        unpacking = zlib.decompressobj()
        unpacked = unpacking.decompress(content, size + 8)
        if not unpacking.eof:
            raise ValueError("a variable is not whole")
        return memoryview(unpacked)

    def _matrix(self, content: memoryview, depth: int) -> None:
        """Raise ValueError if a variable, field or cell does not hold what its head says."""
        if not len(content):
            self._use(BYTES_OF_ONE)
            return
        kinds, parts = self.elements(content, depth)
        if not parts:
            raise ValueError("a variable has no head")
        self._use(BYTES_OF_ONE)
        flags = self._int(parts[0][:4])
        kind, inner = flags & 0xFF, kinds[3:]
        if kind == OPAQUE and kinds == OBJECT:
            return
        if kinds[:3] != HEAD or len(parts[0]) != 8 or depth > DEEPEST:
            raise ValueError("a variable has no head, or is nested too deep")
        shape = parts[1]
        size = math.prod(self._int(shape[k : k + 4]) for k in range(0, len(shape), 4))
        sound = 0 <= size <= len(content)
        if kind == CELL:
            sound &= inner == MATRICES * size
        elif kind == STRUCT:
            width = self._int(parts[3]) if len(inner) > 1 else 0
            fields = len(parts[4]) // width if width > 0 else -1
            sound &= inner == b"\5\1" + MATRICES * (fields * size)
        else:
            is_complex = bool(flags & 0x0800)
            sound &= kind in (TEXT, *NUMBERS) and len(inner) == 1 + is_complex
            sound &= not {*inner} & {MATRIX, COMPRESSED}
        if not sound:
            raise ValueError(f"a variable of class {kind} does not hold {size} values")
        self._use(8 * size)
