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
from skdgp.export._model import PortableModel, inertia_entries

# Tolerances of the self-test, relative to the largest value; deviations are small differences of large sums
TOLERANCE = 1e-9
STD_TOLERANCE = 1e-5
# Arrays of the portable file that the source has, too
SHARED = (
    "shift",
    "scale",
    "center",
    "output_scale",
    "mixture",
    "prior_variance",
    "trend_weights",
    "term_inverse_widths",
    "centres",
)


def write_c(folder: str | os.PathLike[str], model: PortableModel) -> list[Path]:
    """Write a model as C99 into a folder: aero.h, aero.c, test_aero.c and a Makefile, all or none.

    ``aero_predict`` gives mean and standard deviation, ``aero_gradient`` the slopes of the mean,
    ``aero_inputs`` the regressors of flight data; ``aero_limits`` holds the range of the training
    data. ``make test`` compares them with values of the pipeline that the model holds
    (``model.reference``).

    Parameters
    ----------
    folder : path-like
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
    makefile = Path(folder, "Makefile")
    if makefile.exists() and "test_aero" not in makefile.read_text(errors="replace"):
        raise FileExistsError(
            f"Got {makefile}, which is of something else, but expected none: export into a folder of its own."
        )
    templates = Path(__file__).with_name("c")
    writers = {}
    for name, of_file in values.items():
        template = Template((templates / name).read_text(encoding="utf-8"))
        writers[name] = text_writer(template.safe_substitute(of_file))
    write_together(Path(folder), writers)
    return [Path(folder, name) for name in values]


def _tables(model: PortableModel) -> dict[str, Array]:
    """Return the arrays of numbers by name."""
    arrays = model.arrays()
    tables = {name: arrays[name] for name in SHARED}
    for name, array in arrays.items():
        if name.startswith(("trend_prior_", "trend_root_")):
            tables[name] = array.T.ravel()
        elif name.startswith(("weights_", "root_")):
            tables[name] = array
    return tables


def _header(model: PortableModel) -> dict[str, Any]:
    constants = model.aircraft.to_dict() | inertia_entries(model.aircraft)
    lag, delay, rate_limit = model.servos.tolist()
    constants |= {
        "lag": lag,
        "delay": delay,
        "rate": rate_limit if np.isfinite(rate_limit) else 0.0,
    }
    inputs = [f"{r.name} [{r.unit}]" if r.unit else r.name for r in model.regressors]
    name = re.sub(r"[^ -~]|[*\\$]", "?", model.aircraft.name)
    return constants | {
        "created": model.provenance.get("created", "at an unknown time"),
        "aircraft": name.replace("??", "? ?"),  # which can stand in a comment
        "n_sources": len(model.columns),
        "d": len(inputs),
        "P": len(model.outputs),
        "sources": ", ".join(model.columns),
        "inputs": ", ".join(inputs),
        "outputs": ", ".join(model.outputs),
    }


def _source(model: PortableModel) -> dict[str, Any]:
    texts = [_array("aero_limits", model.limits, "const double")]
    for name, table in _tables(model).items():
        texts.append(_array(name, table))
    texts.append(_structs("term terms", _terms(model) or ["0, 0, 0, 0"]))
    texts.append(_structs("posterior parts", _parts(model)))
    largest = max(len(readout.weights) for readout in model.readouts)
    return {
        "components": len(model.mixture),
        "functions": max(1, largest),
        "tables": "\n".join(texts),
        "formulas": "\n".join(_formulas(model)),
    }


def _terms(model: PortableModel) -> list[str]:
    """Return the rows of the table of terms."""
    arrays = model.arrays()
    _, first, count = arrays["term_place"].T.tolist()
    places = (np.cumsum(count) - count).tolist()
    columns = zip(first, count, places, arrays["term_gain"].tolist(), strict=True)
    return [", ".join(map(repr, row)) for row in columns]


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


def _test(model: PortableModel) -> dict[str, Any]:
    """Return the self-test, with values of the pipeline."""
    expected = model.reference
    X = expected.regressors
    slopes = expected.slopes
    size = np.abs(slopes * model.scale).max(axis=(0, 2))[:, None] / model.scale
    tables = {
        "at": X,
        "expected_mean": expected.mean,
        "expected_std": expected.std,
        "expected_slope": slopes,
        "mean_size": np.abs(expected.mean).max(axis=0),
        "std_size": STD_TOLERANCE / TOLERANCE * expected.std.max(axis=0),
        "slope_size": np.where(size > 0, size, 1.0),
    }
    return {
        "n": len(X),
        "tolerance": TOLERANCE,
        "tables": "\n".join(_array(name, values) for name, values in tables.items()),
    }


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
    """Return a constant array of its shape; an empty one has zeros, since C has none."""
    values = np.asarray(values)
    if not values.size:
        values = np.zeros((1, *values.shape[1:]))
    number = "double" if values.dtype.kind == "f" else "int"
    shape = "".join(f"[{n}]" for n in values.shape)
    numbers = str(values.tolist()).replace("[", "{").replace("]", "}").replace(", ", ",\n")
    return f"{kind or f'static const {number}'} {name}{shape} = {numbers};"


def _structs(declaration: str, rows: list[str]) -> str:
    lines = "},\n{".join(rows)
    return f"static const {declaration}[] = {{{{{lines}}}}};"
