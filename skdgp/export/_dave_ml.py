"""DAVE-ML 2.0 (AIAA S-119): functions or tables with their uncertainty and check cases."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import repeat
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array, Matrix
from skdgp._effects import split_model
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import BuildUp, Table, build_up
from skdgp.export._model import Block, PortableModel
from skdgp.export._pipeline import portable_model
from skdgp.export._reduce import loss_of, reduced
from skdgp.export._text import (
    changes_text,
    check_distinct,
    element,
    identifiers,
    number_text,
    units_of,
    write_xml,
)

DOCTYPE = (
    '<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"\n'
    '  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">\n'
)
NAMESPACE, MATHML = "http://daveml.org/2010/DAVEML", "http://www.w3.org/1998/Math/MathML"
STANDARD_NAMES = {
    "alpha": "angleOfAttack", "beta": "angleOfSideslip", "elevator": "elevatorDeflection",
    "aileron": "aileronDeflection", "rudder": "rudderDeflection", "airspeed": "trueAirspeed",
    "CX": "aeroBodyForceCoefficient_X", "CY": "aeroBodyForceCoefficient_Y", "CZ": "aeroBodyForceCoefficient_Z",
    "Cl": "aeroBodyMomentCoefficient_Roll", "Cm": "aeroBodyMomentCoefficient_Pitch",
    "Cn": "aeroBodyMomentCoefficient_Yaw",
}  # fmt: skip
UNITS = {
    "-": "nd",
    "m/s": "m_s",
    "rad/s": "rad_s",
    "rad/s^2": "rad_s2",
    "m/s^2": "m_s2",
    "kg/m^3": "kg_m3",
}
N_CHECKS, CHECK_TOLERANCE = 16, 1e-9
BASE = math.e  # of powers: fewer readers know the element exp
MAX_FUNCTIONS = 6000  # Gaussian functions of all outputs: a model with more is reduced
MAX_ENTRIES = 60000  # of the roots of the deviations of all outputs
MAX_STD_LOSS = 0.1  # largest relative change of deviations by fewer functions, root mean square
MAX_CORRELATED = 100  # samples over which the correlation of the coefficients is averaged


class _Facts(NamedTuple):
    """What both forms say, by the names of a build-up: the regressors and their limits, the model at its samples."""

    aircraft: Aircraft
    regressors: tuple[str, ...]
    units: tuple[str, ...]
    limits: Matrix
    samples: Matrix
    predicted: Matrix
    predicted_std: Matrix
    loss: pd.DataFrame


def write_dave_ml(
    path: str | os.PathLike,
    model: Any,
    aircraft: Aircraft,
    *,
    form: str = "functions",
    **options: Any,
) -> pd.DataFrame:
    r"""Write a model as a DAVE-ML 2.0 file with its uncertainty and check cases, and return its loss.

    Inputs are the regressors, SI units and radians; outputs CX CY CZ Cl Cm Cn. Check cases are
    predictions at flown points; their tolerance is the largest difference of the file at them.

    ``form="functions"``: outputs are the posterior mean in MathML, each with an additive normal
    ``uncertainty``: its standard deviation, the variable ``CX_std`` of the same inputs, and the
    correlation with the others, average over samples. Deviations have fewer functions than the
    model; a change by more than 10 %, root mean square, is refused. ``form="tables"``: outputs are
    those of :func:`build_up`; constants, derivatives and cells have uncertainties. Raises
    ValueError if a parameter is invalid, the pipeline has no portable form or too many functions
    (functions), or the build-up is refused (tables).

    Parameters
    ----------
    path : path-like
        Such as ``uav.dml``; ``xmllint --dtdvalid DAVEfunc.dtd uav.dml`` validates it.
    model : Pipeline or BuildUp
        Fitted; a build-up is written as tables.
    aircraft : Aircraft
    form : {"functions", "tables"}, default="functions"
    **options
        Of :func:`build_up`, for tables.

    Returns
    -------
    DataFrame (6, 2)
        Root mean squares over samples: "loss", the difference to the model, and "deviation", of the
        posterior.
    """
    check_choice("form", form, ("functions", "tables"))
    build = model if isinstance(model, BuildUp) else None
    if build is None and form == "tables":
        build = build_up(model, aircraft, **options)
    facts: _Facts | BuildUp
    if build is not None:
        names = identifiers(build.regressors)
        facts = build = replace(build, regressors=tuple(names[name] for name in build.regressors))
        content = _build_up(build)
        values = build.evaluate(build.samples)
    else:
        portable, names = portable_model(model, aircraft).with_identifiers()
        shown = reduced(portable, lambda m: sum(block.size for block in m.blocks), MAX_FUNCTIONS)
        of_std = reduced(
            portable,
            lambda m: sum(len(m.readouts[k].packed_root) for k in m.readout_of),
            MAX_ENTRIES,
        )
        facts = _facts(portable, shown)
        _check_loss(facts.loss, of_std)
        content = _functions(shown, of_std, _correlation(model, portable, facts.samples))
        values = shown.predict(facts.samples)[:, portable.order]
    checks = _checks(facts, values, internal=build is None)
    root = element(
        "DAVEfunc", _header(facts, names), *_inputs(facts), *content, checks, xmlns=NAMESPACE
    )
    check_distinct((place.attrib["varID"] for place in root.findall("variableDef")), "the file")
    ElementTree.indent(root)
    for formula in root.iter("math"):  # which are long, and stay on one line
        tail = formula.tail
        for part in formula.iter():
            part.tail, part.text = None, (part.text or "").strip() or None
        formula.tail = tail
    write_xml(path, root, DOCTYPE)
    return facts.loss


def _facts(model: PortableModel, shown: PortableModel) -> _Facts:
    """Return what the file says of a model, of which it shows another form."""
    samples, order = model.points(), model.order
    mean, std = (values[:, order] for values in model.predict(samples, True, False))
    off = shown.predict(samples)[:, order] - mean
    loss, deviation = (np.sqrt(np.mean(values**2, axis=0)) for values in (off, std))
    limits = np.stack([model.envelope.low, model.envelope.high])
    table = pd.DataFrame({"loss": loss, "deviation": deviation}, index=list(COEFFICIENTS))
    units = units_of(model.regressor_names, {each.name: each.unit for each in model.regressors})
    return _Facts(model.aircraft, model.regressor_names, units, limits, samples, mean, std, table)


def _check_loss(loss: pd.DataFrame, of_std: PortableModel) -> None:
    """Raise ValueError if fewer functions change mean or deviation too much."""
    mean = float((loss["loss"] / loss["deviation"]).max())
    std = max((found["std"] for found in loss_of(of_std).values()), default=0.0)
    if mean > 1.0 or std > MAX_STD_LOSS:
        raise ValueError(
            f"Got a model that {MAX_FUNCTIONS} functions change by {mean:.2g} posterior "
            f"deviations, and its deviations "
            f"by {std:.2g} of themselves, but expected at most 1 and {MAX_STD_LOSS:g}: use "
            f"form='tables', or a model "
            "with inference='sparse'."
        )


def _correlation(model: Any, portable: PortableModel, samples: Matrix) -> Matrix:
    """Return the correlation of the six coefficients at a point, by the mean covariance over samples, (6, 6)."""
    X = (samples[:: -(-len(samples) // MAX_CORRELATED)] - portable.shift) / portable.scale
    joint = (
        split_model(model)[0]
        .posterior_.covariance(X)
        .reshape(len(portable.outputs), len(X), -1, len(X))
    )
    mean = np.einsum("ikjk->ij", joint)[np.ix_(portable.order, portable.order)]
    size = np.sqrt(np.diag(mean))
    return mean / np.multiply.outer(size, size)


def _header(facts: _Facts | BuildUp, names: dict[str, str]) -> Element:
    loss = "; ".join(
        f"{n} {row.loss:.3g} of {row.deviation:.3g}" for n, row in facts.loss.iterrows()
    )
    text = (
        "Learned from flights. Body axes, x forward, y right, z down. Elevator > 0 pitches down, "
        "aileron > 0 rolls "
        f"right, rudder > 0 yaws left. Difference to the model and posterior deviation, root mean "
        f"square: {loss}." + (f" Names: {changes}." if (changes := changes_text(names)) else "")
    )
    return element(
        "fileHeader",
        element("author", name="skdgp", org="skdgp"),
        element("creationDate", date=datetime.now(UTC).date().isoformat()),
        element("description", text),
        name=f"Aerodynamics of {facts.aircraft.name}",
    )


def _inputs(facts: _Facts | BuildUp) -> Iterator[Element]:
    for name, unit, limits in zip(facts.regressors, facts.units, facts.limits.T, strict=True):
        flown = element(
            "description", f"flown from {number_text(limits[0])} to {number_text(limits[1])}"
        )
        yield _variable(name, flown, element("isInput"), units=_unit(unit))


def _functions(
    model: PortableModel, of_std: PortableModel, correlation: Matrix
) -> Iterator[Element]:
    """Yield mean and deviation of every output, of the scaled regressors s = (x - shift) / scale - trend_center."""
    scaled, P = [f"s_{name}" for name in model.regressor_names], len(model.outputs)
    origin = model.shift + model.scale * model.trend_center
    for name, short, zero, scale in zip(
        model.regressor_names, scaled, origin, model.scale, strict=True
    ):
        yield _computed(short, _apply("times", _apply("minus", name, zero), 1.0 / scale))
    for n, (i, name) in enumerate(zip(model.order, COEFFICIENTS, strict=True)):
        shares, mixed = model.mixture[:, i].tolist(), f"{name}_m"
        for k in range(len(shares)):
            yield from _mean(model, k * P + i, f"{name}_m{k}", scaled)
            yield from _variance(of_std, k * P + i, f"{name}_v{k}", scaled)
        yield _computed(
            mixed,
            _apply("plus", *(_apply("times", q, f"{name}_m{k}") for k, q in enumerate(shares))),
        )
        scatter = [
            _apply("power", _apply("minus", f"{name}_m{k}", mixed), 2.0) for k in range(len(shares))
        ]
        spread = [
            _apply("times", q, _apply("plus", f"{name}_v{k}", scatter[k]))
            for k, q in enumerate(shares)
        ]
        deviation = _apply(
            "times", model.deviation_scale[i], _apply("power", _apply("plus", *spread), 0.5)
        )
        yield _computed(f"{name}_std", deviation)
        mean = _apply("plus", model.center[i], _apply("times", model.output_scale[i], mixed))
        normal = _normal(
            element("variableRef", varID=f"{name}_std"),
            *_correlations(COEFFICIENTS, n, correlation),
        )
        yield _computed(name, mean, element("isOutput"), normal)


def _mean(model: PortableModel, part: int, name: str, scaled: Sequence[str]) -> Iterator[Element]:
    """Yield the variables of the mean of a part, v^T p + w^T g."""
    functions = []
    for k, (block, weights, _) in enumerate(model.terms(part)):
        functions.append(f"{name}_g{k}")
        shared, exponentials = _exponentials(model, block, functions[-1], scaled)
        terms = [
            _apply("times", w, e) for w, e in zip(block.gain * weights, exponentials, strict=True)
        ]
        yield shared
        yield _computed(functions[-1], _apply("plus", *terms))
    constant, *slopes = model.trend_weights[part]
    trend = [_apply("times", v, s) for v, s in zip(slopes, scaled, strict=True) if v]
    yield _computed(name, _apply("plus", constant, *trend, *functions))


def _variance(
    model: PortableModel, part: int, name: str, scaled: Sequence[str]
) -> Iterator[Element]:
    """Yield the variables of the variance of a part, a + |tau p|^2 - |h|^2 with h = T^T p + (0, U^T g)."""
    functions, rows = [], []
    for k, (block, _, U) in enumerate(model.terms(part)):
        shared, exponentials = _exponentials(model, block, f"{name}_h{k}", scaled)
        yield shared
        for j, (exponential, row) in enumerate(zip(exponentials, block.gain * U, strict=True)):
            functions.append(f"{name}_e{k}_{j}")
            rows.append(row)
            yield _computed(functions[-1], exponential)
    squares = []
    for j, column in enumerate(np.vstack([model.trend_roots[part], *rows]).T):
        terms = [
            _apply("times", v, f)
            for v, f in zip(column[1:], [*scaled, *functions], strict=True)
            if v
        ]
        squares.append(f"{name}_r{j}")
        yield _computed(squares[-1], _apply("plus", column[0], *terms))
    tau = model.trend_scale[part] ** 2
    prior = [_apply("times", t, s, s) for t, s in zip(tau[1:], scaled, strict=True) if t]
    explained = [_apply("times", -1.0, square, square) for square in squares]
    yield _computed(name, _apply("plus", model.prior_variance[part] + tau[0], *prior, *explained))


def _exponentials(
    model: PortableModel, block: Block, name: str, scaled: Sequence[str]
) -> tuple[Element, list[Element]]:
    """Return the variable that the functions of a block share, -s^T A s / 2, and the functions over the gain."""
    A = block.root @ block.root.T if block.root.ndim == 2 else np.diag(block.root**2)
    centres, used = model.centres[block.rows] + block.shift - model.trend_center, block.regressors
    pairs = [
        (j, k, (0.5 if j == k else 1.0) * A[j, k]) for j in used for k in used if j <= k and A[j, k]
    ]
    terms = [_apply("times", -a, scaled[j], scaled[k]) for j, k, a in pairs]
    slopes, constants = centres @ A, -0.5 * np.einsum("kj,jl,kl->k", centres, A, centres)
    found = []
    for constant, slope in zip(constants, slopes, strict=True):
        lines = [_apply("times", slope[k], scaled[k]) for k in used]
        found.append(_apply("power", BASE, _apply("plus", f"{name}_q", constant, *lines)))
    return _computed(f"{name}_q", _apply("plus", 0.0, *terms)), found


def _apply(operator: str, *operands: Element | str | float) -> Element:
    """Return an operator of numbers, variables and other operators."""
    parts = [
        o if isinstance(o, Element) else element("ci" if isinstance(o, str) else "cn", o)
        for o in operands
    ]
    return element("apply", Element(operator), *parts) if len(parts) > 1 else parts[0]


def _build_up(build: BuildUp) -> Iterator[Element]:
    tables = [
        (f"{name}_t{k}", table)
        for name in COEFFICIENTS
        for k, table in enumerate(build.tables[name])
    ]
    for name in COEFFICIENTS:
        yield from _constants(build, name)
    for name, _ in tables:
        yield _variable(name)
    for name in COEFFICIENTS:
        lines = [
            _apply("times", f"{name}_{regressor}", _apply("minus", regressor, reference))
            for regressor, reference in zip(build.regressors, build.reference, strict=True)
        ]
        added = [f"{name}_t{k}" for k in range(len(build.tables[name]))]
        yield _computed(name, _apply("plus", f"{name}_0", *lines, *added), element("isOutput"))
    units = dict(zip(build.regressors, build.units, strict=True))
    for name, table in tables:
        for axis, (regressor, points) in enumerate(
            zip(table.regressors, table.breakpoints, strict=True)
        ):
            parts = [element("description", regressor), element("bpVals", _numbers(points))]
            yield element(
                "breakpointDef", *parts, bpID=f"{name}_b{axis}", units=_unit(units[regressor])
            )
    for name, table in tables:
        yield _table(name, table)


def _constants(build: BuildUp, name: str) -> Iterator[Element]:
    """Yield the constant at the reference and the derivatives, with their uncertainty and correlation."""
    names = [f"{name}_0", *(f"{name}_{regressor}" for regressor in build.regressors)]
    values = [build.constants[name], *build.derivatives.loc[name]]
    stds = [build.constants_std[name], *build.derivatives_std.loc[name]]
    correlation = build.correlation(name)
    for k, (variable, value, std) in enumerate(zip(names, values, stds, strict=True)):
        normal = _normal(std, *_correlations(names, k, correlation))
        yield _variable(variable, normal, initialValue=number_text(value))


def _table(name: str, table: Table) -> Element:
    """Return the function that is a table: constant beyond its edges."""
    edges = [
        {"min": number_text(points[0]), "max": number_text(points[-1])}
        for points in table.breakpoints
    ]
    inputs = [
        element("independentVarRef", varID=regressor, extrapolate="neither", **edge)
        for regressor, edge in zip(table.regressors, edges, strict=True)
    ]
    grid = element(
        "griddedTableDef",
        element(
            "breakpointRefs",
            *(element("bpRef", bpID=f"{name}_b{axis}") for axis in range(len(inputs))),
        ),
        _normal(element("dataTable", _numbers(table.std))),
        element("dataTable", _numbers(table.values)),
        gtID=f"{name}_g",
        units="nd",
    )
    definition = element("functionDefn", grid, name=f"{name}_f")
    return element(
        "function", *inputs, element("dependentVarRef", varID=name), definition, name=name
    )


def _variable(name: str, *content: Element, units: str = "nd", **attributes: str) -> Element:
    return element("variableDef", *content, name=_name(name), varID=name, units=units, **attributes)


def _computed(name: str, value: Element, *content: Element) -> Element:
    """Return a variable that a formula gives."""
    return _variable(name, element("calculation", element("math", value, xmlns=MATHML)), *content)


def _normal(bounds: Element | float, *correlations: Element) -> Element:
    """Return an additive, normal uncertainty of one standard deviation."""
    normal = element("normalPDF", element("bounds", bounds), *correlations, numSigmas="1")
    return element("uncertainty", normal, effect="additive")


def _correlations(names: Sequence[str], k: int, correlation: Matrix) -> list[Element]:
    """Return what variable k is correlated with: names of later variables, coefficients of earlier ones."""
    numbers = [number_text(np.clip(value, -1.0, 1.0)) for value in correlation[k, :k]]
    return [
        *(element("correlatesWith", varID=later) for later in names[k + 1 :]),
        *(
            element("correlation", varID=name, corrCoef=number)
            for name, number in zip(names, numbers, strict=False)
        ),
    ]


def _checks(facts: _Facts | BuildUp, values: Matrix, internal: bool) -> Element:
    """Return predictions of the model, with the largest difference of the file's values at them as tolerance."""
    rows = np.linspace(0, len(facts.samples) - 1, N_CHECKS).astype(int)
    tolerance = CHECK_TOLERANCE + np.abs(values - facts.predicted)[rows].max(axis=0)
    shots = []
    for k, row in enumerate(rows):
        inputs = map(_signal, facts.regressors, facts.units, facts.samples[row])
        inside = [
            element("signal", element("varID", f"{name}_std"), element("signalValue", std))
            for name, std in zip(COEFFICIENTS, facts.predicted_std[row], strict=True)
        ]
        shots.append(
            element(
                "staticShot",
                element("checkInputs", *inputs),
                *([element("internalValues", *inside)] if internal else []),
                element(
                    "checkOutputs",
                    *map(_signal, COEFFICIENTS, repeat("-"), facts.predicted[row], tolerance),
                ),
                name=f"sample {k + 1}",
            )
        )
    return element("checkData", *shots)


def _signal(name: str, unit: str, value: float, *tolerance: float) -> Element:
    parts = (
        element("signalName", _name(name)),
        element("signalUnits", _unit(unit)),
        element("signalValue", value),
    )
    return element("signal", *parts, *(element("tol", most) for most in tolerance))


def _name(name: str) -> str:
    return STANDARD_NAMES.get(name, name)


def _unit(unit: str) -> str:
    return UNITS.get(unit, unit)


def _numbers(values: Array) -> str:
    return ", ".join(map(number_text, np.ravel(values)))
