"""MATLAB's MAT-files of versions 5 to 7: nested elements, each behind its type and length.

The format is that of MathWorks, MAT-File Format (R2019b). It is read here because ``scipy.io.loadmat`` ends the process
on some damaged files. No length in the file is trusted.
"""

from __future__ import annotations

import math
import zlib

import numpy as np

HEADER_SIZE = 128
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
LETTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, CHAR, NUMERIC = 1, 2, 4, range(6, 16)
COMPLEX = 0x0800
DEEPEST = 8
"""Levels of structs and cells."""
LARGEST = 2**31
"""Bytes that one compressed variable may take."""


def parse_mat5(data: bytes) -> dict[str, object]:
    """Return the variables of a file: numbers as arrays, texts as lists of str, structs as dicts.

    What a flight table cannot hold (complex numbers, sparse matrices, objects, arrays of structs) is None.

    Raises
    ------
    ValueError
        If an element does not fit into the file or into itself.
    """
    mark = data[126:128]
    if mark not in (b"IM", b"MI"):
        raise ValueError("it does not begin as a MAT-file of version 5 to 7 does")
    order = "<" if mark == b"IM" else ">"
    variables = {}
    for kind, content in _elements(data[HEADER_SIZE:], order):
        if kind == COMPRESSED:
            ((kind, content),) = _elements(_unpacked(content), order)
        if kind == MATRIX:
            name, value = _matrix(content, order, 0)
            variables[name] = value
    return variables


def _unpacked(content):
    try:
        unpacking = zlib.decompressobj()
        unpacked = unpacking.decompress(content, LARGEST)
    except zlib.error as error:
        raise ValueError(f"a variable cannot be unpacked: {error}") from error
    if not unpacking.eof:
        raise ValueError("a variable is not whole")
    return unpacked


def _elements(data, order) -> list[tuple[int, bytes]]:
    """Return types and contents of the elements that stand one after another."""
    position, found, view = 0, [], memoryview(data)
    while position + 8 <= len(data):
        kind, size = np.frombuffer(data, f"{order}u4", 2, position).tolist()
        start, padded = position + 8, (size + 7) // 8 * 8
        if kind >> 16:  # up to four bytes stand in the place of the length
            kind, size, start, padded = kind & 0xFFFF, kind >> 16, position + 4, 4
        if start + size > len(data) or size > padded:
            raise ValueError(f"an element of {size} bytes is larger than what it is in")
        found.append((kind, bytes(view[start : start + size])))
        position = start + (size if kind == COMPRESSED else padded)
    return found


def _matrix(content, order, depth):
    """Return name and value of one variable, field or cell."""
    if not content:
        return "", np.empty(0)
    parts = _elements(content, order)
    if len(parts) < 3 or len(parts[0][1]) != 8 or depth > DEEPEST:
        raise ValueError("a variable has no head, or is nested too deep")
    (flags, _), shape = (
        np.frombuffer(parts[0][1], f"{order}u4").tolist(),
        _numbers(parts[1], order).astype(int).tolist(),
    )
    name, rest, kind = parts[2][1].decode("latin-1"), parts[3:], flags & 0xFF
    value = None
    if kind in NUMERIC and not flags & COMPLEX and len(rest) == 1:
        value = _numbers(rest[0], order)
        if value.size != math.prod(shape):
            raise ValueError(f"{name} holds {value.size} numbers, but should hold {shape}")
        value = value.reshape(shape, order="F")
    elif kind == CHAR and len(rest) == 1:
        value = _texts(rest[0], order, shape)
    elif kind == CELL:
        cells = [_matrix(part[1], order, depth + 1)[1] for part in rest]
        texts = all(isinstance(cell, list) and len(cell) == 1 for cell in cells)
        value = [cell[0] for cell in cells] if cells and texts else None
    elif kind == STRUCT and math.prod(shape) == 1 and len(rest) > 1:
        length = _numbers(rest[0], order)
        width = int(length[0]) if length.size else 0
        names = [rest[1][1][i : i + width] for i in range(0, len(rest[1][1]), width)] if width > 0 else []
        values = [_matrix(part[1], order, depth + 1)[1] for part in rest[2:]]
        value = {key.split(b"\0")[0].decode("latin-1"): each for key, each in zip(names, values, strict=False)}
    return name, value


def _numbers(part, order):
    kind, content = part
    if kind not in NUMBERS:
        raise ValueError(f"an element of type {kind} holds no numbers")
    dtype = np.dtype(order + NUMBERS[kind])
    if len(content) % dtype.itemsize:
        raise ValueError(f"{len(content)} bytes are no numbers of {dtype.itemsize}")
    return np.frombuffer(content, dtype).astype(dtype.newbyteorder("="))


def _texts(part, order, shape):
    """Return the rows of a matrix of letters, without blanks at their ends."""
    kind, content = part
    coding = LETTERS.get(kind, "latin-1") + ({"<": "-le", ">": "-be"}[order] if LETTERS.get(kind) == "utf-16" else "")
    letters = content.decode(coding, "replace")
    rows = shape[0] if shape else 0
    return [letters[row::rows].rstrip() for row in range(min(rows, len(letters)))]
