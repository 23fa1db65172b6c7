"""The model as C99: one header, one source, no allocation, and a self-test with vectors of the model."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.files import text_writer, write_together
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.checks import check_choice
from skdgp.export._model import PortableModel, Readout
from skdgp.export._text import changes_text

TOLERANCE = {"double": 1e-9, "float": 1e-4}
"""Of the self-test, relative to the largest value; of deviations at least what
:meth:`PortableModel.rounding` says.
"""
ROUNDED = (
    2e-5  # largest change of a deviation, relative to the largest, by a root of 32-bit numbers
)
MAX_BYTES = 2**26  # a compiler takes no larger source in reasonable time
MAX_REGRESSORS = 32  # bits of an unsigned long
LARGE = 2**20  # numbers of roots from which their rounding is not tried before it is needed
C_FILES = ("aero.h", "aero.c", "test_aero.c", "Makefile")
N_VECTORS = 40
PER_LINE = 8
BLOCK_BYTES = 56
PART_BYTES = 192  # pointers and numbers of a part, and alignment of its arrays
CODE_BYTES = 4096  # of the functions and names
UNBOUNDED = 1e30  # edge of an envelope that is not known


def write_c(
    folder: str | os.PathLike[str], model: PortableModel, *, precision: str = "double"
) -> None:
    """Write a model as C99 into a folder: aero.h, aero.c, test_aero.c and a Makefile, all or none.

    ``aero_predict`` gives mean and standard deviation, ``aero_gradient`` the slopes of the mean,
    ``aero_beyond`` the regressors outside of the flown envelope, ``aero_inputs`` regressors of
    flight data. ``make test`` compares them with the model. :func:`export_model` writes a smaller
    form, too. Raises ValueError if ``precision`` is none of these, the model exceeds 64 MB, or
    there are more than 32 regressors.

    Parameters
    ----------
    folder : path-like
        It must exist.
    model : PortableModel
    precision : {"double", "float"}
        "float": arguments and results are of type float, and the root of the variance is rounded to
        32 bits where this changes no deviation visibly. Arithmetic is in double, since the
        explained variance nearly cancels the prior.
    """
    texts = c_files(model, precision)
    write_together(Path(folder), {name: text_writer(text) for name, text in texts.items()})


def c_files(model: PortableModel, precision: str = "double") -> dict[str, str]:
    """Return the texts of aero.h, aero.c, test_aero.c and the Makefile by name; errors as of :func:`write_c`."""
    size = c_bytes(model, precision)
    if size > MAX_BYTES:
        raise ValueError(
            f"Got a model that takes {size / 1e6:.0f} MB in C, but expected at most "
            f"{MAX_BYTES / 1e6:.0f} MB: "
            "give max_kb=256 (--max-kb 256), or another size."
        )
    if len(model.regressors) > MAX_REGRESSORS:
        raise ValueError(
            f"Got {len(model.regressors)} regressors, but expected at most {MAX_REGRESSORS}: name "
            f"fewer."
        )
    written, names = model.with_identifiers()
    header = _header(written, precision, size) | {
        "hash": model.content_hash,
        "renamed": changes_text(names) or "none",
    }
    values = {
        "aero.h": header,
        "aero.c": _source(written, precision),
        "test_aero.c": _test(model, precision),
    }
    texts = {name: Template(_template(name)).substitute(value) for name, value in values.items()}
    return texts | {"Makefile": _template("Makefile")}


def _template(name: str) -> str:
    return Path(__file__).with_name("c").joinpath(name).read_text(encoding="utf-8")


class _Rounded(NamedTuple):
    """A packed triangle of 32-bit numbers: entry (c, r) is row[c] * values * column[r]."""

    values: Array
    row: Vector
    column: Vector

    @classmethod
    def from_readout(cls, readout: Readout) -> _Rounded:
        row = np.abs(readout.root).max(axis=1, initial=0.0)
        row[row == 0] = 1.0
        scaled = readout.root / row[:, None]
        column = np.maximum(np.abs(scaled).max(axis=0, initial=0.0), 1e-300) / (2**31 - 1)
        return cls(np.rint((scaled / column).T[np.tril_indices(readout.size)]), row, column)

    def in_full(self) -> Vector:
        """Return the packed triangle."""
        rows, columns = np.tril_indices(len(self.row))
        return self.values * self.row[columns] * self.column[rows]


def _roots(model: PortableModel, precision: str) -> list[_Rounded | None]:
    """Return the rounded root of each readout, or None where it stays as it is."""
    if precision == "double":
        return [None] * len(model.readouts)
    rounded = [_Rounded.from_readout(readout) for readout in model.readouts]
    readouts = [
        Readout(readout.weights, root.in_full())
        for readout, root in zip(model.readouts, rounded, strict=True)
    ]
    X = _points(model)
    std, other = (
        m.predict(X, True, False)[1] for m in (model, replace(model, readouts=tuple(readouts)))
    )
    visible = np.abs(other - std).max(axis=0) > ROUNDED * std.max(axis=0)
    visible = np.tile(visible, len(model.mixture))
    return [
        None if visible[model.readout_of == k].any() else root for k, root in enumerate(rounded)
    ]


class _Table(NamedTuple):
    """The blocks of a model with their used regressors, and centres, shifts and roots, each set once."""

    rows: list[tuple]
    used: list[int]
    centres: Vector
    shifts: Vector
    roots: Vector
    full: bool


def _blocks(model: PortableModel) -> _Table:
    full = any(block.root.ndim == 2 for block in model.blocks)
    parts: dict[str, list[Vector]] = {"centres": [], "shifts": [], "roots": []}
    rows: list[tuple] = []
    used: list[int] = []
    places: dict[tuple, int] = {}
    sizes = dict.fromkeys(parts, 0)

    def add(name, values):
        parts[name].append(np.ravel(values))
        sizes[name] += np.size(values)
        return sizes[name] - np.size(values)

    for block in sorted(model.blocks, key=lambda block: block.output):
        index = list(range(len(model.regressors)) if full else block.regressors)
        key = block.first_centre, block.size, tuple(index)
        if key not in places:
            places[key] = add("centres", model.centres[block.rows][:, index])
        root = np.diag(block.root) if full and block.root.ndim == 1 else block.root[index]
        place = places[key], add("shifts", block.shift[index]), add("roots", root)
        rows.append((block.first_column, block.size, len(index), len(used), *place, block.gain))
        used += index
    centres, shifts, roots = (
        np.concatenate([*values, np.zeros(int(not values))]) for values in parts.values()
    )
    return _Table(rows, used, centres, shifts, roots, full)


def c_bytes(model: PortableModel, precision: str = "double") -> int:
    """Return the bytes of a model in C, tables and code: an estimate from above for a processor of 64 bits."""
    check_choice("precision", precision, TOLERANCE)
    table, triangles = _blocks(model), [len(readout.packed_root) for readout in model.readouts]
    numbers = sum(len(values) for values in (table.centres, table.shifts, table.roots))
    numbers += sum(np.size(getattr(model, name)) for name in _VECTORS) + 2 * len(model.regressors)
    numbers += sum(root.size for root in model.trend_roots) + sum(
        readout.size for readout in model.readouts
    )
    size = CODE_BYTES + 8 * numbers + len(table.used)
    size += BLOCK_BYTES * len(model.blocks) + PART_BYTES * len(model.readout_of)
    if precision == "double" or sum(triangles) > LARGE:
        return size + 8 * sum(triangles)
    roots = _roots(model, precision)
    return size + sum(
        8 * n if root is None else 4 * n + 16 * len(root.row)
        for n, root in zip(triangles, roots, strict=True)
    )


_VECTORS = (
    *(
        "shift",
        "scale",
        "center",
        "output_scale",
        "deviation_scale",
        "prior_variance",
        "trend_center",
        "trend_scale",
    ),
    *("trend_weights", "mixture"),
)


def _header(model, precision, size) -> dict[str, Any]:
    aircraft = model.aircraft
    constants = {
        name.upper(): getattr(aircraft, name) for name in ("mass", "wing_area", "span", "chord")
    }
    tensor = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    constants |= {f"I{'XYZ'[i]}{'XYZ'[j]}": aircraft.inertia[i, j] for i, j in tensor}
    functions = max(readout.size for readout in model.readouts)
    return {
        "aircraft": re.sub(r"[^ -~]|[*\\$]", "?", aircraft.name).replace(
            "??", "? ?"
        ),  # which can stand in a comment
        "size": size,
        "stack": 8 * (functions + 4 * len(model.regressors) + 1 + 2 * len(model.mixture)),
        "real": precision,
        "n_sources": len(model.columns),
        "d": len(model.regressors),
        "P": len(model.outputs),
        "sources": ", ".join(model.columns),
        "inputs": ", ".join(
            f"{each.name} [{each.unit}]" if each.unit else each.name for each in model.regressors
        ),
        "outputs": ", ".join(model.outputs),
        "constants": "\n".join(
            f"#define AERO_{name} {float(value)!r}" for name, value in constants.items()
        ),
    }


def _source(model, precision) -> dict[str, Any]:
    J, table = len(model.readout_of), _blocks(model)
    order = sorted(block.output for block in model.blocks)
    readouts = [model.readouts[k] for k in model.readout_of]
    roots, (low, high) = _roots(model, precision), _edges(model, precision)
    triangles = [
        f"{{root_{k}, NULL, NULL, NULL}}"
        if roots[k] is None
        else f"{{NULL, root_{k}, row_{k}, column_{k}}}"
        for k in model.readout_of
    ]
    blocks = [
        f"{{{column}, {size}, {n}, used + {used}, centres + {centre}, shifts + {shift}, roots + {root}, {gain!r}}}"
        for column, size, n, used, centre, shift, root, gain in table.rows
    ] or ["{0, 0, 0, used, centres, shifts, roots, 0}"]
    texts = [
        _names("aero_source_names", model.columns),
        _names("aero_input_names", model.regressor_names),
        _names("aero_output_names", model.outputs),
        _array("aero_low", low, "const aero_real"),
        _array("aero_high", high, "const aero_real"),
        *(_array(name, getattr(model, name)) for name in _VECTORS),
        *(_array(name, getattr(table, name)) for name in ("centres", "shifts", "roots")),
        _array("used", table.used or [0], "static const unsigned char"),
        _list("static const block blocks", blocks, ",\n"),
        _array("first_block", np.searchsorted(order, np.arange(J + 1)), _INT),
        _array("n_functions", [readout.size for readout in readouts], _INT),
        _array("n_columns", [root.shape[1] for root in model.trend_roots], _INT),
        *(_array(f"weights_{k}", readout.weights) for k, readout in enumerate(model.readouts)),
        *(text for k, root in enumerate(roots) for text in _triangle(k, root, model.readouts[k])),
        *(_array(f"trend_root_{j}", root.T.ravel()) for j, root in enumerate(model.trend_roots)),
        _list("static const double *const weights", [f"weights_{k}" for k in model.readout_of]),
        _list("static const double *const trend_root", [f"trend_root_{j}" for j in range(J)]),
        _list("static const triangle root", triangles, ",\n"),
    ]
    return {
        "members": len(model.mixture),
        "functions": max(1, *(readout.size for readout in model.readouts)),
        "full": int(table.full),
        "tables": "\n".join(texts),
        "formulas": "\n".join(_formulas(model)),
    }


def _triangle(k: int, root: _Rounded | None, readout: Readout) -> list[str]:
    """Return the arrays of one root."""
    if root is None:
        return [_array(f"root_{k}", readout.packed_root)]
    integers = _array(f"root_{k}", root.values, "static const int32_t")
    return [integers, _array(f"row_{k}", root.row), _array(f"column_{k}", root.column)]


def _test(model, precision) -> dict[str, Any]:
    X = _in_precision(_points(model), precision)
    mean, std = model.predict(X, return_std=True, include_input_noise=False)
    slope = model.predict_gradient(X)
    size = np.abs(slope * model.scale).max(axis=(0, 2))[:, None] / model.scale
    low, high = _edges(model, precision)
    bits = (((low > X) | (high < X)) * 2 ** np.arange(X.shape[1])).sum(axis=1)
    texts = [
        _array("at", X, "static const aero_real"),
        _array("beyond", bits, "static const unsigned long"),
        _array("says_mean", mean),
        _array("says_std", std),
        _array("says_slope", slope),
        _array("mean_size", np.abs(mean).max(axis=0)),
        _array("std_size", np.maximum(std.max(axis=0), model.rounding(X) / TOLERANCE[precision])),
        _array("slope_size", np.where(size > 0, size, 1.0)),
    ]
    return {"n": len(X), "tolerance": TOLERANCE[precision], "tables": "\n".join(texts)}


def _in_precision(values: Array, precision: str) -> Array:
    return values.astype(np.float32).astype(float) if precision == "float" else values


def _edges(model, precision) -> Array:
    """Return the smallest and the largest value of each input, (2, d)."""
    edges = np.stack([model.envelope.low, model.envelope.high])
    return _in_precision(np.clip(edges, -UNBOUNDED, UNBOUNDED), precision)


def _points(model) -> Matrix:
    """Return points of the envelope and around it, the same at every call."""
    rng, samples = np.random.default_rng(0), model.points()
    X = samples[np.linspace(0, len(samples) - 1, N_VECTORS).astype(int)].copy()
    X[1::2] += 0.5 * model.scale * rng.standard_normal(X[1::2].shape)
    return X


def _formulas(model) -> Iterator[str]:
    """Yield the statement of each input."""
    place = {name: k for k, name in enumerate(model.columns)}
    for k, regressor in enumerate(model.regressors):
        terms = [
            f"source[{place[name]}]" if factor == 1 else f"{factor!r} * source[{place[name]}]"
            for name, factor in zip(regressor.sources, regressor.factors, strict=True)
        ]
        text = " + ".join(terms)
        if regressor.power:
            rate = f" * ({regressor.length!r} / (2 * source[{place['airspeed']}]))"
            text = (f"({text})" if len(terms) > 1 else text) + rate * regressor.power
        yield f"    x[{k}] = (aero_real)({text}); /* {regressor.name} */"


_INT = "static const int"


def _array(name: str, values: Any, kind: str = "static const double") -> str:
    """Return a constant array of its shape; an empty one has one zero, since C has none."""
    values = np.asarray(values)
    values = values if values.size else np.zeros(1)
    shape = "".join(f"[{n}]" for n in values.shape)
    is_real = kind.endswith(("double", "real"))
    return f"{kind} {name}{shape} = {_braces(values.astype(float if is_real else np.int64))};"


def _braces(values: Array) -> str:
    if values.ndim > 1:
        return "{" + ",\n".join(_braces(row) for row in values) + "}"
    words = [repr(value) for value in values.tolist()]
    lines = [", ".join(words[a : a + PER_LINE]) for a in range(0, len(words), PER_LINE)]
    return "{" + ",\n".join(lines) + "}"


def _names(name: str, values: Iterable[str]) -> str:
    return _list(f"const char *const {name}", [json.dumps(value) for value in values])


def _list(declaration: str, words: list[str], separator: str = ", ") -> str:
    return f"{declaration}[{len(words)}] = {{{separator.join(words)}}};"
