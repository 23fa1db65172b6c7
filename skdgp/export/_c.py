"""The model as C99: one header, one source, no allocation, and a self-test with vectors of the model."""

from __future__ import annotations

import os
import re
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from skdgp._compute.files import text_writer, write_together
from skdgp._compute.typing import Array
from skdgp.export._model import PortableModel, Reference, Term, packed

# Of the self-test, relative to the largest value; of deviations at least PortableModel.rounding
TOLERANCE = 1e-9
# Allowed above the stated loss of a reduced model, in posterior standard deviations
LOSS_TOLERANCE = 1e-6
# Vectors of the model's own values
N_VECTORS = 40
# Numbers in a line
PER_LINE = 8
# Bytes of the pointers and numbers of a term, and of a part
TERM_BYTES = 56
PART_BYTES = 72
# Bytes of the functions and names
CODE_BYTES = 4096
# Arrays of the portable file that the source has, too
SHARED = (
    "shift",
    "scale",
    "center",
    "output_scale",
    "trend_center",
    "mixture",
    "prior_variance",
    "trend_weights",
)


def write_c(folder: str | os.PathLike[str], model: PortableModel) -> list[Path]:
    """Write a model as C99 into a folder: aero.h, aero.c, test_aero.c and a Makefile, all or none.

    ``aero_predict`` gives mean and standard deviation, ``aero_gradient`` the slopes of the mean,
    ``aero_inputs`` the regressors of flight data; ``aero_limits`` holds the range of the training
    data. ``make test`` compares them with values of the pipeline that the model holds
    (``model.reference``). :func:`export_model` with ``max_kb`` writes a smaller form, which is
    compared with the smaller model, and with the pipeline within the stated loss.

    Parameters
    ----------
    folder : path-like
        It must exist.
    model : PortableModel

    Returns
    -------
    list of Path
        The files.
    """
    values = {
        "aero.h": _header(model),
        "aero.c": _source(model),
        "test_aero.c": _test(model),
        "Makefile": {},
    }
    templates = Path(__file__).with_name("c")
    writers = {}
    for name, of_file in values.items():
        template = Template((templates / name).read_text(encoding="utf-8"))
        writers[name] = text_writer(template.safe_substitute(of_file))
    write_together(Path(folder), writers)
    return [Path(folder, name) for name in values]


def c_bytes(model: PortableModel) -> int:
    """Return the bytes of a model in C, tables and code: an estimate from above for a processor of 64 bits."""
    size = CODE_BYTES + PART_BYTES * len(model.parts) + TERM_BYTES * len(_all_terms(model))
    for table in _tables(model).values():
        size += table.nbytes
    return size


def _all_terms(model: PortableModel) -> list[Term]:
    return [term for part in model.parts for term in part.terms]


def _tables(model: PortableModel) -> dict[str, Array]:
    """Return the arrays of numbers by name; of terms one after another."""
    arrays = model.arrays()
    tables = {name: arrays[name] for name in SHARED}
    roots = [np.empty(0)]
    centres = [np.empty(0)]
    for term in _all_terms(model):
        roots.append(term.root[list(term.regressors)].ravel())
        centres.append(term.centres.ravel())
    tables["roots"] = np.concatenate(roots)
    tables["centres"] = np.concatenate(centres)
    for k, readout in enumerate(model.readouts):
        tables[f"weights_{k}"] = readout.weights
        tables[f"root_{k}"] = packed(readout.root)
    for j, part in enumerate(model.parts):
        tables[f"trend_prior_{j}"] = part.trend_prior.T.ravel()
        tables[f"trend_root_{j}"] = part.trend_root.T.ravel()
    return tables


def _header(model: PortableModel) -> dict[str, Any]:
    aircraft = model.aircraft
    inertia = aircraft.inertia
    constants = {
        "MASS": aircraft.mass,
        "WING_AREA": aircraft.wing_area,
        "SPAN": aircraft.span,
        "CHORD": aircraft.chord,
        "IXX": inertia[0, 0],
        "IYY": inertia[1, 1],
        "IZZ": inertia[2, 2],
        "IXY": inertia[0, 1],
        "IXZ": inertia[0, 2],
        "IYZ": inertia[1, 2],
        "SERVO_LAG": model.servo_lag[0],
    }
    lines = [f"#define AERO_{name} {float(value)!r}" for name, value in constants.items()]
    inputs = [f"{r.name} [{r.unit}]" if r.unit else r.name for r in model.regressors]
    functions = max(len(readout.weights) for readout in model.readouts)
    name = re.sub(r"[^ -~]|[*\\$]", "?", aircraft.name)
    return {
        "hash": model.content_hash,
        "aircraft": name.replace("??", "? ?"),  # which can stand in a comment
        "size": c_bytes(model),
        "stack": 8 * (functions + 5 * len(inputs) + 2 + 2 * len(model.mixture)),
        "n_sources": len(model.columns),
        "d": len(inputs),
        "P": len(model.outputs),
        "sources": ", ".join(model.columns),
        "inputs": ", ".join(inputs),
        "outputs": ", ".join(model.outputs),
        "constants": "\n".join(lines),
    }


def _source(model: PortableModel) -> dict[str, Any]:
    terms, used = _terms(model)
    texts = [_array("aero_limits", model.limits, "const double")]
    for name, table in _tables(model).items():
        texts.append(_array(name, table))
    texts += [
        _array("used", used or [0], "static const unsigned char"),
        _structs("term terms", terms or ["0, 0, 0, 0, used, roots, centres, 0"]),
        _structs("posterior parts", _parts(model)),
    ]
    largest = max(len(readout.weights) for readout in model.readouts)
    return {
        "components": len(model.mixture),
        "functions": max(1, largest),
        "tables": "\n".join(texts),
        "formulas": "\n".join(_formulas(model)),
    }


def _parts(model: PortableModel) -> list[str]:
    """Return the rows of the table of parts."""
    readouts = model.readouts
    rows = []
    first = 0
    for j, part in enumerate(model.parts):
        k = readouts.index(part.readout)
        last = first + len(part.terms)
        columns = f"{part.trend_root.shape[1]}, {part.trend_prior.shape[1]}"
        arrays = f"weights_{k}, root_{k}, trend_prior_{j}, trend_root_{j}"
        rows.append(f"{first}, {last}, {len(part.readout.weights)}, {columns}, {arrays}")
        first = last
    return rows


def _terms(model: PortableModel) -> tuple[list[str], list[int]]:
    """Return the rows of the table of terms, and the regressors that they use."""
    rows: list[str] = []
    used: list[int] = []
    root = 0
    centre = 0
    for term in _all_terms(model):
        size, rank = term.centres.shape
        n = len(term.regressors)
        places = f"used + {len(used)}, roots + {root}, centres + {centre}"
        rows.append(f"{term.first}, {size}, {n}, {rank}, {places}, {term.gain!r}")
        used += term.regressors
        root += n * rank
        centre += size * rank
    return rows, used


def _test(model: PortableModel) -> dict[str, Any]:
    """Return the self-test: values of the pipeline; of a reduced model its own, and the pipeline's."""
    reference = model.reference or _own_values(model)
    losses = model.provenance.get("reduction", {})
    X = reference.regressors
    expected = reference
    if losses:
        expected = Reference(X, *model.predict(X, return_std=True, include_input_noise=False))
    slopes = model.predict_gradient(X)
    size = np.abs(slopes * model.scale).max(axis=(0, 2))[:, None] / model.scale
    rounding = model.rounding(X)
    allowed = np.zeros((2, len(model.outputs)))
    if losses:
        of_mean = [losses[name]["mean"] for name in model.outputs]
        of_std = [losses[name]["std"] for name in model.outputs]
        allowed = np.array([of_mean, of_std]) + LOSS_TOLERANCE
    tables = {
        "at": X,
        "expected_mean": expected.mean,
        "expected_std": expected.std,
        "expected_slope": slopes,
        "mean_size": np.abs(expected.mean).max(axis=0),
        "std_size": np.maximum(expected.std.max(axis=0), rounding / TOLERANCE),
        "slope_size": np.where(size > 0, size, 1.0),
        "pipeline_mean": reference.mean,
        "pipeline_std": reference.std,
        "allowed": allowed,
    }
    texts = [_array(name, values) for name, values in tables.items()]
    source = "the pipeline" if model.reference else "the portable model"
    return {
        "n": len(X),
        "tolerance": TOLERANCE,
        "reduced": int(bool(losses)),
        "source": "the reduced model" if losses else source,
        "tables": "\n".join(texts),
    }


def _own_values(model: PortableModel) -> Reference:
    """Return the values of the model itself at some of its samples."""
    X = model.samples[np.linspace(0, len(model.samples) - 1, N_VECTORS).astype(int)]
    return Reference(X, *model.predict(X, return_std=True, include_input_noise=False))


def _formulas(model: PortableModel) -> list[str]:
    """Return the statement of each input."""
    sources = {name: f"source[{k}]" for k, name in enumerate(model.columns)}
    lines = []
    for k, regressor in enumerate(model.regressors):
        columns = zip(regressor.factors, regressor.sources, strict=True)
        text = " + ".join(f"{factor!r} * {sources[name]}" for factor, name in columns)
        if regressor.power:
            rate = f" * ({regressor.length!r} / (2 * {sources['airspeed']}))"
            text = f"({text})" + rate * regressor.power
        lines.append(f"    x[{k}] = {text}; /* {regressor.name} */")
    return lines


def _array(name: str, values: Any, kind: str = "") -> str:
    """Return a constant array of its shape; an empty one has one zero, since C has none."""
    values = np.asarray(values if np.size(values) else [0.0])
    number = "double" if values.dtype.kind == "f" else "int"
    shape = "".join(f"[{n}]" for n in values.shape)
    return f"{kind or f'static const {number}'} {name}{shape} = {_braces(values)};"


def _braces(values: Array) -> str:
    if values.ndim > 1:
        lines = [_braces(row) for row in values]
    else:
        numbers = [repr(value) for value in values.tolist()]
        begins = range(0, len(numbers), PER_LINE)
        lines = [", ".join(numbers[begin : begin + PER_LINE]) for begin in begins]
    return "{" + ",\n".join(lines) + "}"


def _structs(declaration: str, rows: list[str]) -> str:
    lines = "},\n{".join(rows)
    return f"static const {declaration}[] = {{{{{lines}}}}};"
