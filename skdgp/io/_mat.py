"""MATLAB tables: vectors named as columns, as variables or as fields of one struct, in files of versions 5 to 7.

The format is that of MathWorks, MAT-File Format (R2019b): nested elements, each after its type and
length. This module exists because ``scipy.io.loadmat`` crashes the process on some damaged files:
SciPy 1.17.1 on 6 of 3000 (the kinds of damage of the tests; the first report is
https://github.com/scipy/scipy/issues/6072). Every length is checked.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS
from skdgp.io._tables import FlightReadError, base_name, check_room, check_width, room_for

HDF5 = b"MATLAB 7.3"
HEADER_SIZE = 128
NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
LETTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, CHAR, NUMERIC = 1, 2, 4, range(6, 16)
COMPLEX = 0x0800
DEEPEST = 8  # levels of structs and cells


def read_mat(path: Path) -> pd.DataFrame:
    """Return the table of a MATLAB file; raise FlightReadError if it is damaged or holds no table with ``time``."""
    data = path.read_bytes()
    if data.startswith(HDF5):
        raise FlightReadError(
            "Got a file of MATLAB's version 7.3 (HDF5), but expected version 7 or earlier: "
            "save('flight.mat', '-v7', "
            "...) in MATLAB, or writetable(..., 'flight.csv')."
        )
    try:
        content = parse_mat5(data)
    except FlightReadError:
        raise
    except ValueError as error:
        raise FlightReadError(
            f"Got a file that is not a whole MATLAB file ({error}), but expected one of version 5 "
            f"to 7: save it "
            "again, with '-v7'."
        ) from error
    tables = {name: vectors for name, vectors in _structs("", content) if "time" in vectors}
    if len(tables) != 1:
        found = [name or "loose vectors" for name in tables]
        what = (
            f"several tables, {found}"
            if found
            else f"no vector 'time' among {sorted(content)[:12]}"
        )
        raise FlightReadError(
            f"Got {what}, but expected one: vectors of equal length, loose or in one struct (of a "
            f"MATLAB table: "
            "table2struct(T, 'ToScalar', true))."
        )
    (vectors,) = tables.values()
    n = len(vectors["time"])
    uneven = {
        name: len(each)
        for name, each in vectors.items()
        if len(each) != n and base_name(name) in CHANNELS
    }
    if uneven:
        raise FlightReadError(
            f"Got vectors of lengths {uneven}, but expected {n}, as many values as time has."
        )
    return pd.DataFrame({name: each for name, each in vectors.items() if len(each) == n})


def _structs(name, content):
    """Yield the struct's own vectors, then those of the structs in it."""
    vectors = {key: _vector(value) for key, value in content.items()}
    yield name, {key: vector for key, vector in vectors.items() if vector is not None}
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _structs(f"{name}.{key}".lstrip("."), value)


def _vector(value):
    """Return numbers or texts as a vector, or None if they are none."""
    if isinstance(value, list):
        return np.array(value, dtype=object)
    if isinstance(value, np.ndarray) and value.size and value.size == max(value.shape):
        return value.astype(float).ravel()
    return None


def parse_mat5(data: bytes) -> dict[str, object]:
    """Return the variables of a file: numbers as arrays, texts as lists of str, structs as dicts, others as None.

    Raise FlightReadError if they are too many or take far more memory than the file, ValueError if
    one is damaged.
    """
    mark = data[126:128]
    if mark not in (b"IM", b"MI"):
        raise ValueError("it does not begin as a MAT-file of version 5 to 7 does")
    return _Reader(len(data), "<" if mark == b"IM" else ">").variables(
        memoryview(data)[HEADER_SIZE:]
    )


class _Reader:
    def __init__(self, n_bytes, order):
        self.order, self.room, self.used = order, room_for(n_bytes), 0

    def _use(self, n_bytes):
        self.used += n_bytes
        check_room(self.used, self.room)

    def variables(self, data) -> dict[str, object]:
        found = {}
        for kind, content in self._elements(data):
            if kind == COMPRESSED:
                ((kind, content),) = self._elements(self._unpacked(content))
            if kind == MATRIX:
                name, value = self._matrix(content, 0)
                found[name] = value
                check_width(len(found))
        return found

    def _unpacked(self, content):
        """Return a compressed element; its size stands in its first bytes and is checked first."""
        try:
            head = zlib.decompressobj().decompress(content, 8)
            size = 8 + int(np.frombuffer(head, f"{self.order}u4")[1]) if len(head) == 8 else 8
            self._use(size)
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(content, size + 8)
        except zlib.error as error:
            raise ValueError(f"a variable cannot be unpacked: {error}") from error
        if not unpacking.eof:
            raise ValueError("a variable is not whole")
        return unpacked

    def _elements(self, data) -> Iterator[tuple[int, memoryview]]:
        """Yield types and contents of the elements that stand one after another."""
        position, view = 0, memoryview(data)
        while position + 8 <= len(view):
            kind, size = np.frombuffer(view, f"{self.order}u4", 2, position).tolist()
            start, padded = position + 8, (size + 7) // 8 * 8
            if kind >> 16:  # up to four bytes stand in the place of the length
                kind, size, start, padded = kind & 0xFFFF, kind >> 16, position + 4, 4
            if start + size > len(view) or size > padded:
                raise ValueError(f"an element of {size} bytes is larger than what it is in")
            yield kind, view[start : start + size]
            position = start + (size if kind == COMPRESSED else padded)

    def _matrix(self, content, depth):
        """Return name and value of one variable, field or cell."""
        if not content:
            return "", np.empty(0)
        parts = self._elements(content)
        head = list(islice(parts, 3))
        if len(head) < 3 or len(head[0][1]) != 8 or depth > DEEPEST:
            raise ValueError("a variable has no head, or is nested too deep")
        flags, _ = np.frombuffer(head[0][1], f"{self.order}u4").tolist()
        shape, name = (
            self._numbers(head[1]).astype(int).tolist(),
            bytes(head[2][1]).decode("latin-1"),
        )
        kind, value = flags & 0xFF, None
        if (kind in NUMERIC and not flags & COMPLEX) or kind == CHAR:
            rest = list(islice(parts, 2))
            if len(rest) == 1 and kind == CHAR:
                value = self._texts(rest[0], shape)
            elif len(rest) == 1:
                value = self._numbers(rest[0])
                if value.size != math.prod(shape):
                    raise ValueError(f"{name} holds {value.size} numbers, but should hold {shape}")
                value = value.reshape(shape, order="F")
        elif kind == CELL:
            value = self._cells(parts, depth)
        elif kind == STRUCT and math.prod(shape) == 1:
            value = self._struct(parts, depth)
        return name, value

    def _cells(self, parts, depth):
        """Return one text of each cell, or None if a cell holds something else."""
        texts = []
        for _, content in parts:
            cell = self._matrix(content, depth + 1)[1]
            if not isinstance(cell, list) or len(cell) != 1:
                return None
            texts += cell
        return texts or None

    def _struct(self, parts, depth):
        head = list(islice(parts, 2))
        if len(head) < 2:
            return None
        length, letters = self._numbers(head[0]), bytes(head[1][1])
        width = int(length[0]) if length.size else 0
        starts = range(0, len(letters), width) if width > 0 else ()
        check_width(len(starts))
        names = [
            letters[start : start + width].split(b"\0")[0].decode("latin-1") for start in starts
        ]
        fields = zip(names, parts, strict=False)
        return {name: self._matrix(content, depth + 1)[1] for name, (_, content) in fields}

    def _numbers(self, part):
        """Return an element's numbers, which become floats in a table."""
        kind, content = part
        if kind not in NUMBERS:
            raise ValueError(f"an element of type {kind} holds no numbers")
        dtype = np.dtype(self.order + NUMBERS[kind])
        if len(content) % dtype.itemsize:
            raise ValueError(f"{len(content)} bytes are no numbers of {dtype.itemsize}")
        self._use(8 * (len(content) // dtype.itemsize))
        return np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))

    def _texts(self, part, shape):
        """Return the rows of a matrix of letters, without blanks at their ends."""
        kind, content = part
        coding = LETTERS.get(kind, "latin-1")
        if coding == "utf-16":
            coding += {"<": "-le", ">": "-be"}[self.order]
        letters = bytes(content).decode(coding, "replace")
        rows = shape[0] if shape else 0
        return [letters[row::rows].rstrip() for row in range(min(rows, len(letters)))]
