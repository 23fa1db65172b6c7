"""The model as C99: one header, one source, no allocation, and a self-test with vectors of the model."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from skdgp._compute.files import text_writer, write_together
from skdgp._compute.typing import Array
from skdgp.export._model import PortableModel, Reference, packed

# Of the self-test, relative to the largest value; of deviations at least PortableModel.rounding
TOLERANCE = 1e-9
# Allowed above the stated loss of a reduced model, in posterior standard deviations
LOSS_TOLERANCE = 1e-6
N_VECTORS = 40  # of the model's own values
PER_LINE = 8
TERM_BYTES = 56
PART_BYTES = 72  # pointers and numbers of a part
CODE_BYTES = 4096  # of the functions and names
SHARED = (
    *("shift", "scale", "center", "output_scale", "trend_center"),
    *("mixture", "prior_variance", "trend_weights"),
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
        "aero.h": _header(model) | {"hash": model.content_hash},
        "aero.c": _source(model),
        "test_aero.c": _test(model),
        "Makefile": {},
    }
    templates = Path(__file__).with_name("c")
    texts = {name: Template((templates / name).read_text(encoding="utf-8")) for name in values}
    writers = {
        name: text_writer(text.safe_substitute(values[name])) for name, text in texts.items()
    }
    write_together(Path(folder), writers)
    return [Path(folder, name) for name in values]


def c_bytes(model: PortableModel) -> int:
    """Return the bytes of a model in C, tables and code: an estimate from above for a processor of 64 bits."""
    numbers = sum(values.nbytes for _, values in _tables(model))
    n_terms = sum(len(part.terms) for part in model.parts)
    return CODE_BYTES + numbers + TERM_BYTES * n_terms + PART_BYTES * len(model.parts)


def _tables(model: PortableModel) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of numbers by name; of terms one after another."""
    arrays = model.arrays()
    for name in SHARED:
        yield name, arrays[name]
    terms = [term for part in model.parts for term in part.terms]
    roots = [term.root[list(term.regressors)].ravel() for term in terms]
    yield "roots", np.concatenate([np.empty(0), *roots])
    yield "centres", np.concatenate([np.empty(0), *(term.centres.ravel() for term in terms)])
    for k, readout in enumerate(model.readouts):
        yield f"weights_{k}", readout.weights
        yield f"root_{k}", packed(readout.root)
    for j, part in enumerate(model.parts):
        yield f"trend_prior_{j}", part.trend_prior.T.ravel()
        yield f"trend_root_{j}", part.trend_root.T.ravel()


def _header(model: PortableModel) -> dict[str, Any]:
    aircraft = model.aircraft
    constants = {n.upper(): getattr(aircraft, n) for n in ("mass", "wing_area", "span", "chord")}
    tensor = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    constants |= {f"I{'XYZ'[i]}{'XYZ'[j]}": aircraft.inertia[i, j] for i, j in tensor}
    constants["SERVO_LAG"] = model.servo_lag[0]
    functions = max(len(readout.weights) for readout in model.readouts)
    name = re.sub(r"[^ -~]|[*\\$]", "?", aircraft.name)
    return {
        "aircraft": name.replace("??", "? ?"),  # which can stand in a comment
        "size": c_bytes(model),
        "stack": 8 * (functions + 5 * len(model.regressors) + 2 + 2 * len(model.mixture)),
        "n_sources": len(model.columns),
        "d": len(model.regressors),
        "P": len(model.outputs),
        "sources": ", ".join(model.columns),
        "inputs": ", ".join(f"{r.name} [{r.unit}]" if r.unit else r.name for r in model.regressors),
        "outputs": ", ".join(model.outputs),
        "constants": "\n".join(
            f"#define AERO_{name} {float(value)!r}" for name, value in constants.items()
        ),
    }


def _source(model: PortableModel) -> dict[str, Any]:
    parts = model.parts
    places = {id(readout): k for k, readout in enumerate(model.readouts)}
    numbers = [places[id(part.readout)] for part in parts]
    rows, used = _terms(model)
    texts = [
        _array("aero_limits", model.limits, "const double"),
        *(_array(name, values) for name, values in _tables(model)),
        _array("used", used or [0], "static const unsigned char"),
        _list("static const term terms", rows or ["{0, 0, 0, 0, used, roots, centres, 0}"], ",\n"),
        _array("first_term", np.cumsum([0, *(len(part.terms) for part in parts)])),
        _array("n_functions", [len(part.readout.weights) for part in parts]),
        _array("n_columns", [part.trend_root.shape[1] for part in parts]),
        _array("n_prior", [part.trend_prior.shape[1] for part in parts]),
        _list("static const double *const weights", [f"weights_{k}" for k in numbers]),
        _list("static const double *const root", [f"root_{k}" for k in numbers]),
        _list(
            "static const double *const trend_prior",
            [f"trend_prior_{j}" for j in range(len(parts))],
        ),
        _list(
            "static const double *const trend_root", [f"trend_root_{j}" for j in range(len(parts))]
        ),
    ]
    return {
        "components": len(model.mixture),
        "functions": max(1, *(len(readout.weights) for readout in model.readouts)),
        "tables": "\n".join(texts),
        "formulas": "\n".join(_formulas(model)),
    }


def _terms(model: PortableModel) -> tuple[list[str], list[int]]:
    """Return the rows of the table of terms, and the regressors that they use."""
    rows: list[str] = []
    used: list[int] = []
    root = centre = 0
    for term in (term for part in model.parts for term in part.terms):
        (size, rank), n = term.centres.shape, len(term.regressors)
        places = f"used + {len(used)}, roots + {root}, centres + {centre}"
        rows.append(f"{{{term.first}, {size}, {n}, {rank}, {places}, {term.gain!r}}}")
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
        stated = [(losses[name]["mean"], losses[name]["std"]) for name in model.outputs]
        allowed = np.transpose(stated) + LOSS_TOLERANCE
    texts = [
        _array("at", X),
        _array("expected_mean", expected.mean),
        _array("expected_std", expected.std),
        _array("expected_slope", slopes),
        _array("mean_size", np.abs(expected.mean).max(axis=0)),
        _array("std_size", np.maximum(expected.std.max(axis=0), rounding / TOLERANCE)),
        _array("slope_size", np.where(size > 0, size, 1.0)),
        _array("pipeline_mean", reference.mean),
        _array("pipeline_std", reference.std),
        _array("allowed", allowed),
    ]
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


def _formulas(model: PortableModel) -> Iterator[str]:
    """Yield the statement of each input."""
    place = {name: k for k, name in enumerate(model.columns)}
    for k, regressor in enumerate(model.regressors):
        columns = zip(regressor.factors, regressor.sources, strict=True)
        text = " + ".join(f"{factor!r} * source[{place[name]}]" for factor, name in columns)
        if regressor.power:
            rate = f" * ({regressor.length!r} / (2 * source[{place['airspeed']}]))"
            text = f"({text})" + rate * regressor.power
        yield f"    x[{k}] = {text}; /* {regressor.name} */"


def _array(name: str, values: Any, kind: str = "") -> str:
    """Return a constant array of its shape; an empty one has one zero, since C has none."""
    values = np.asarray(values if np.size(values) else [0.0])
    kind = kind or f"static const {'double' if values.dtype.kind == 'f' else 'int'}"
    shape = "".join(f"[{n}]" for n in values.shape)
    return f"{kind} {name}{shape} = {_braces(values)};"


def _braces(values: Array) -> str:
    if values.ndim > 1:
        return "{" + ",\n".join(_braces(row) for row in values) + "}"
    numbers = [repr(value) for value in values.tolist()]
    lines = [", ".join(numbers[a : a + PER_LINE]) for a in range(0, len(numbers), PER_LINE)]
    return "{" + ",\n".join(lines) + "}"


def _list(declaration: str, items: list[str], separator: str = ", ") -> str:
    return f"{declaration}[{len(items)}] = {{{separator.join(items)}}};"
