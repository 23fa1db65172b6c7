"""DAVE-ML 2.0 (AIAA S-119): functions or tables with their uncertainty and check cases."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple, cast
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array, Matrix
from skdgp._effects import split_model
from skdgp._flight.channels import CHANNELS, COEFFICIENTS
from skdgp._flight.checks import check_choice
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import BuildUp, Table, build_up
from skdgp.export._model import Block, PortableModel
from skdgp.export._pipeline import portable_model
from skdgp.export._reduce import loss_of, reduced
from skdgp.export._text import add_text, changes_text, check_distinct, identifiers, number_text, write_xml

DOCTYPE = (
    '<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"\n'
    '  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">\n'
)
NAMESPACE, MATHML = "http://daveml.org/2010/DAVEML", "http://www.w3.org/1998/Math/MathML"
N_CHECKS = 16
STANDARD_NAMES = {
    "alpha": "angleOfAttack", "beta": "angleOfSideslip", "elevator": "elevatorDeflection",
    "aileron": "aileronDeflection", "rudder": "rudderDeflection", "airspeed": "trueAirspeed",
    "CX": "aeroBodyForceCoefficient_X", "CY": "aeroBodyForceCoefficient_Y", "CZ": "aeroBodyForceCoefficient_Z",
    "Cl": "aeroBodyMomentCoefficient_Roll", "Cm": "aeroBodyMomentCoefficient_Pitch",
    "Cn": "aeroBodyMomentCoefficient_Yaw",
}  # fmt: skip
CHECK_TOLERANCE = 1e-9
BASE = math.e  # of powers: fewer readers know the element exp
MAX_FUNCTIONS = 6000  # Gaussian functions of all outputs: a model with more is reduced
MAX_ENTRIES = 60000  # of the roots of the deviations of all outputs
MAX_STD_LOSS = 0.1  # largest relative change of deviations by fewer functions, root mean square
MAX_CORRELATED = 100  # samples over which the correlation of the coefficients is averaged


class _Facts(NamedTuple):
    """Content of both forms: the regressors and their limits, and the model at its samples."""

    aircraft: Aircraft
    regressors: tuple[str, ...]
    limits: Matrix
    samples: Matrix
    predicted: Matrix
    predicted_std: Matrix
    loss: pd.DataFrame


def write_dave_ml(
    path: str | os.PathLike,
    model: Any,
    aircraft: Aircraft | None = None,
    *,
    form: str = "functions",
    **options: Any,
) -> pd.DataFrame:
    r"""Write a model as a DAVE-ML 2.0 file with its uncertainty and check cases, and return its loss.

    Inputs are the regressors of the model, SI units and radians; outputs are CX CY CZ Cl Cm Cn. Check cases are
    predictions of the model at flown points; their tolerance is the largest difference of the file at them.

    With ``form="functions"`` outputs are the posterior mean in MathML. Each has an ``uncertainty``: additive, normal,
    one standard deviation, which is the variable ``CX_std`` of the same inputs, and the correlation with the other
    outputs, the average over samples. Deviations have fewer functions than the model; a change by more than
    10 %, root mean square, is refused. ``internalValues`` of the check cases state those of the model.

    With ``form="tables"`` outputs are those of :func:`build_up`. Constants, derivatives and cells have uncertainties,
    constants and derivatives of a coefficient their correlation. Raises ValueError if a parameter is invalid, the
    pipeline has no portable form or too many functions (functions), or the build-up is refused (tables).

    Parameters
    ----------
    path : path-like
        Such as ``uav.dml``; ``xmllint --dtdvalid DAVEfunc.dtd uav.dml`` validates it.
    model : Pipeline or BuildUp
        Fitted; a build-up is written as tables.
    aircraft : Aircraft, optional
        Of a pipeline.
    form : {"functions", "tables"}, default="functions"
    **options
        Of :func:`build_up`, for tables.

    Returns
    -------
    DataFrame (6, 2)
        "loss", the root mean square difference of the outputs to the model at samples, and "deviation", that of the
        posterior.

    Examples
    --------
    ``write_dave_ml("uav.dml", saved.pipeline, saved.aircraft)`` writes what ``load_model("model.joblib")`` returns.
    """
    check_choice("form", form, ("functions", "tables"))
    root = Element("DAVEfunc", xmlns=NAMESPACE)
    build = model if isinstance(model, BuildUp) else None
    if build is None and aircraft is None:
        raise ValueError(f"Got {type(model).__name__} without an aircraft, but expected both: give the aircraft, too.")
    if build is None and form == "tables":
        build = build_up(model, cast("Aircraft", aircraft), **options)
    if build is not None:
        names = identifiers(build.regressors)
        build = build.renamed(names)
        facts = _Facts(**{name: getattr(build, name) for name in _Facts._fields})
        _add_head(root, facts, names)
        _add_build_up(root, build)
        values = build.evaluate(build.samples)
    else:
        portable, names = portable_model(model, cast("Aircraft", aircraft)).with_identifiers()
        shown = reduced(portable, lambda m: sum(block.size for block in m.blocks), MAX_FUNCTIONS)
        of_std = reduced(portable, lambda m: sum(len(m.readouts[k].packed_root) for k in m.readout_of), MAX_ENTRIES)
        facts = _facts(portable, shown)
        _check_loss(facts.loss, of_std)
        _add_head(root, facts, names)
        _add_functions(root, shown, of_std, _correlation(model, portable, facts.samples))
        values = shown.predict(facts.samples)[:, _order(portable)]
    _add_checks(root, facts, values, internal=build is None)
    check_distinct((place.attrib["varID"] for place in root.findall("variableDef")), "the file")
    _indent(root)
    write_xml(path, root, DOCTYPE)
    return facts.loss


def _indent(root: Element) -> None:
    """Break lines between elements, but not within formulas, which are long."""
    ElementTree.indent(root)
    for formula in root.iter("math"):
        tail = formula.tail
        for element in formula.iter():
            element.tail = None
            element.text = (element.text or "").strip() or None
        formula.tail = tail


def _facts(model: PortableModel, shown: PortableModel) -> _Facts:
    """Return what the file says of a model, of which it shows another form."""
    samples, order = model.envelope.samples, _order(model)
    if not len(samples):  # of a compact model: its inducing inputs lie among them
        samples = model.centres[:MAX_FUNCTIONS] * model.scale + model.shift
    mean, std = (values[:, order] for values in model.predict(samples, True, False))
    off = shown.predict(samples)[:, order] - mean
    loss, deviation = (np.sqrt(np.mean(values**2, axis=0)) for values in (off, std))
    limits = np.stack([model.envelope.low, model.envelope.high])
    table = pd.DataFrame({"loss": loss, "deviation": deviation}, index=list(COEFFICIENTS))
    return _Facts(model.aircraft, model.regressor_names, limits, samples, mean, std, table)


def _check_loss(loss: pd.DataFrame, of_std: PortableModel) -> None:
    """Raise ValueError if fewer functions change mean or deviation too much."""
    mean = float((loss["loss"] / loss["deviation"]).max())
    std = max((found["std"] for found in loss_of(of_std).values()), default=0.0)
    if mean > 1.0 or std > MAX_STD_LOSS:
        raise ValueError(
            f"Got a model that {MAX_FUNCTIONS} functions change by {mean:.2g} posterior deviations, and its deviations "
            f"by {std:.2g} of themselves, but expected at most 1 and {MAX_STD_LOSS:g}: use form='tables', or a model "
            "with inference='sparse'."
        )


def _order(model: PortableModel) -> list[int]:
    """Return the places of CX CY CZ Cl Cm Cn among the outputs."""
    lacking = [name for name in COEFFICIENTS if name not in model.outputs]
    if lacking:
        raise ValueError(f"Got a model without {lacking}, but expected one of all six coefficients.")
    return [model.outputs.index(name) for name in COEFFICIENTS]


def _correlation(model: Any, portable: PortableModel, samples: Matrix) -> Matrix:
    """Return the correlation of the six coefficients at a point, by the mean covariance over samples, (6, 6)."""
    X = (samples[:: -(-len(samples) // MAX_CORRELATED)] - portable.shift) / portable.scale
    joint = split_model(model)[0].posterior_.covariance(X).reshape(len(portable.outputs), len(X), -1, len(X))
    mean = np.einsum("ikjk->ij", joint)[np.ix_(_order(portable), _order(portable))]
    size = np.sqrt(np.diag(mean))
    return mean / np.multiply.outer(size, size)


def _add_head(root: Element, facts: _Facts, names: dict[str, str]) -> None:
    """Write the header and the inputs."""
    header = SubElement(root, "fileHeader", name=f"Aerodynamics of {facts.aircraft.name}")
    SubElement(header, "author", name="skdgp", org="skdgp")
    SubElement(header, "creationDate", date=datetime.now(UTC).date().isoformat())
    loss = "; ".join(f"{n} {row.loss:.3g} of {row.deviation:.3g}" for n, row in facts.loss.iterrows())
    SubElement(header, "description").text = (
        "Learned from flights. Body axes, x forward, y right, z down. Elevator > 0 pitches down, aileron > 0 rolls "
        f"right, rudder > 0 yaws left. Difference to the model and posterior deviation, root mean square: {loss}."
        + (f" Names: {text}." if (text := changes_text(names)) else "")
    )
    for k, name in enumerate(facts.regressors):
        low, high = (number_text(limit) for limit in facts.limits[:, k])
        place = SubElement(root, "variableDef", name=_name(name), varID=name, units=_unit(name))
        SubElement(place, "description").text = f"flown from {low} to {high}"
        SubElement(place, "isInput")


# -- functions -------------------------------------------------------------------------------------------------


def _add_functions(root: Element, model: PortableModel, of_std: PortableModel, correlation: Matrix) -> None:
    """Write mean and deviation of every output, with the scaled regressors s = (x - shift) / scale - trend_center."""
    scaled = [f"s_{name}" for name in model.regressor_names]
    for name, short, shift, scale, center in zip(
        model.regressor_names, scaled, model.shift, model.scale, model.trend_center, strict=True
    ):
        place = _variable(root, short)
        _calculate(place, _apply("times", _apply("minus", name, float(shift + scale * center)), float(1.0 / scale)))
    for i, name in zip(_order(model), COEFFICIENTS, strict=True):
        shares, mixed = model.mixture[:, i].tolist(), f"{name}_m"
        for k in range(len(shares)):
            _mean(root, model, k * len(model.outputs) + i, f"{name}_m{k}", scaled)
            _variance(root, of_std, k * len(model.outputs) + i, f"{name}_v{k}", scaled)
        _calculate(_variable(root, mixed), _sum([_apply("times", q, f"{name}_m{k}") for k, q in enumerate(shares)]))
        scatter = [_power(_apply("minus", f"{name}_m{k}", mixed), 2.0) for k in range(len(shares))]
        spread = [_apply("times", q, _apply("plus", f"{name}_v{k}", scatter[k])) for k, q in enumerate(shares)]
        deviation = _apply("times", float(model.deviation_scale[i]), _power(_sum(spread), 0.5))
        _calculate(_variable(root, f"{name}_std"), deviation)
        place = SubElement(root, "variableDef", name=_name(name), varID=name, units="nd")
        _calculate(place, _apply("plus", float(model.center[i]), _apply("times", float(model.output_scale[i]), mixed)))
        SubElement(place, "isOutput")
        normal = _normal(place)
        SubElement(SubElement(normal, "bounds"), "variableRef", varID=f"{name}_std")
        _add_correlations(normal, COEFFICIENTS, COEFFICIENTS.index(name), correlation)


def _mean(root: Element, model: PortableModel, part: int, name: str, scaled: Sequence[str]) -> None:
    """Write the variable of the mean of a part, v^T p + w^T g."""
    functions = []
    for k, (block, weights, _) in enumerate(model.terms(part)):
        functions.append(f"{name}_g{k}")
        exponents = _exponents(root, model, block, functions[-1])
        terms = [_apply("times", float(w), e) for w, e in zip(block.gain * weights, exponents, strict=True)]
        _calculate(_variable(root, functions[-1]), _sum(terms))
    constant, *slopes = model.trend_weights[part]
    trend = [_apply("times", float(v), s) for v, s in zip(slopes, scaled, strict=True) if v]
    _calculate(_variable(root, name), _apply("plus", float(constant), *trend, *functions))


def _variance(root: Element, model: PortableModel, part: int, name: str, scaled: Sequence[str]) -> None:
    """Write the variable of the variance of a part, a + |tau p|^2 - |h|^2 with h = T^T p + (0, U^T g)."""
    functions, rows = [], []
    for k, (block, _, U) in enumerate(model.terms(part)):
        exponents = _exponents(root, model, block, f"{name}_h{k}")
        for j, (exponent, row) in enumerate(zip(exponents, block.gain * U, strict=True)):
            functions.append(f"{name}_e{k}_{j}")
            rows.append(row)
            _calculate(_variable(root, functions[-1]), exponent)
    squares = []
    for j, column in enumerate(np.vstack([model.trend_roots[part], *rows]).T):
        of = [_apply("times", float(v), f) for v, f in zip(column[1:], [*scaled, *functions], strict=True) if v]
        squares.append(f"{name}_r{j}")
        _calculate(_variable(root, squares[-1]), _apply("plus", float(column[0]), *of))
    tau = model.trend_scale[part] ** 2
    prior = [_apply("times", float(t), s, s) for t, s in zip(tau[1:], scaled, strict=True) if t]
    explained = [_apply("times", -1.0, square, square) for square in squares]
    constant = float(model.prior_variance[part] + tau[0])
    _calculate(_variable(root, name), _apply("plus", constant, *prior, *explained))


def _exponents(root: Element, model: PortableModel, block: Block, name: str) -> list[Element]:
    """Write what the functions of a block share, -s^T A s / 2, and return the functions over the gain."""
    A = block.root @ block.root.T if block.root.ndim == 2 else np.diag(block.root**2)
    centres = model.centres[block.rows] + block.shift - model.trend_center
    used, names = list(block.regressors), [f"s_{n}" for n in model.regressor_names]
    pairs = [(j, k, (0.5 if j == k else 1.0) * A[j, k]) for j in used for k in used if j <= k and A[j, k]]
    terms = [_apply("times", float(-a), names[j], names[k]) for j, k, a in pairs]
    _calculate(_variable(root, f"{name}_q"), _apply("plus", 0.0, *terms))
    slopes, constants = centres @ A, -0.5 * np.einsum("kj,jl,kl->k", centres, A, centres)
    found = []
    for constant, slope in zip(constants, slopes, strict=True):
        of = [_apply("times", float(slope[k]), names[k]) for k in used]
        found.append(_power(BASE, _apply("plus", f"{name}_q", float(constant), *of)))
    return found


def _variable(root: Element, name: str) -> Element:
    return SubElement(root, "variableDef", name=name, varID=name, units="nd")


def _calculate(place: Element, value: Element) -> None:
    SubElement(SubElement(place, "calculation"), "math", xmlns=MATHML).append(value)


def _apply(operator: str, *operands: Element | str | float) -> Element:
    """Return an operator of numbers, variables and other operators."""
    apply = Element("apply")
    SubElement(apply, operator)
    for operand in operands:
        if isinstance(operand, Element):
            apply.append(operand)
        else:
            add_text(apply, "ci" if isinstance(operand, str) else "cn", operand)
    return apply


def _sum(terms: list[Element]) -> Element:
    return _apply("plus", *terms) if len(terms) > 1 else terms[0]


def _power(base: Element | float, exponent: Element | float) -> Element:
    return _apply("power", base, exponent)


def _add_correlations(normal: Element, names: Sequence[str], k: int, correlation: Matrix) -> None:
    """Write with which variables the one of number k is correlated: later ones, then earlier ones with coefficients."""
    for later in names[k + 1 :]:
        SubElement(normal, "correlatesWith", varID=later)
    for j, earlier in enumerate(names[:k]):
        SubElement(normal, "correlation", varID=earlier, corrCoef=number_text(np.clip(correlation[k, j], -1.0, 1.0)))


# -- tables ----------------------------------------------------------------------------------------------------


def _add_build_up(root: Element, build: BuildUp) -> None:
    tables = [(f"{name}_t{k}", table) for name in COEFFICIENTS for k, table in enumerate(build.tables[name])]
    for name in COEFFICIENTS:
        _add_constants(root, build, name)
    for name, _ in tables:
        _variable(root, name)
    for name in COEFFICIENTS:
        _add_output(root, build, name)
    for name, table in tables:
        for axis, points in enumerate(table.breakpoints):
            place = SubElement(root, "breakpointDef", bpID=f"{name}_b{axis}", units=_unit(table.regressors[axis]))
            SubElement(place, "description").text = table.regressors[axis]
            SubElement(place, "bpVals").text = _numbers(points)
    for name, table in tables:
        _add_function(root, name, table)


def _add_constants(root: Element, build: BuildUp, name: str) -> None:
    """Write the constant at the reference and the derivatives, with their uncertainty and correlation."""
    names = [f"{name}_0", *(f"{name}_{regressor}" for regressor in build.regressors)]
    values = [build.constants[name], *build.derivatives.loc[name]]
    stds = [build.constants_std[name], *build.derivatives_std.loc[name]]
    correlation = build.correlation(name)
    for k, (variable, value, std) in enumerate(zip(names, values, stds, strict=True)):
        place = _variable(root, variable)
        place.set("initialValue", number_text(value))
        normal = _normal(place)
        add_text(normal, "bounds", std)
        _add_correlations(normal, names, k, correlation)


def _add_output(root: Element, build: BuildUp, name: str) -> None:
    place = SubElement(root, "variableDef", name=_name(name), varID=name, units="nd")
    lines = [
        _apply("times", f"{name}_{regressor}", _apply("minus", regressor, float(reference)))
        for regressor, reference in zip(build.regressors, build.reference, strict=True)
    ]
    _calculate(place, _apply("plus", f"{name}_0", *lines, *(f"{name}_t{k}" for k in range(len(build.tables[name])))))
    SubElement(place, "isOutput")


def _add_function(root: Element, name: str, table: Table) -> None:
    function = SubElement(root, "function", name=name)
    for regressor, points in zip(table.regressors, table.breakpoints, strict=True):
        place = SubElement(function, "independentVarRef", varID=regressor, extrapolate="neither")
        place.set("min", number_text(points[0]))
        place.set("max", number_text(points[-1]))
    SubElement(function, "dependentVarRef", varID=name)
    grid = SubElement(
        SubElement(function, "functionDefn", name=f"{name}_f"), "griddedTableDef", gtID=f"{name}_g", units="nd"
    )
    references = SubElement(grid, "breakpointRefs")
    for axis in range(len(table.breakpoints)):
        SubElement(references, "bpRef", bpID=f"{name}_b{axis}")
    SubElement(SubElement(_normal(grid), "bounds"), "dataTable").text = _numbers(table.std)
    SubElement(grid, "dataTable").text = _numbers(table.values)


def _normal(parent: Element) -> Element:
    return SubElement(SubElement(parent, "uncertainty", effect="additive"), "normalPDF", numSigmas="1")


def _add_checks(root: Element, facts: _Facts, values: Matrix, internal: bool) -> None:
    """Write predictions of the model, with the largest difference of the file's values at them as tolerance."""
    rows = np.linspace(0, len(facts.samples) - 1, N_CHECKS).astype(int)
    tolerance = CHECK_TOLERANCE + np.abs(values - facts.predicted)[rows].max(axis=0)
    checks = SubElement(root, "checkData")
    for k, row in enumerate(rows):
        shot = SubElement(checks, "staticShot", name=f"sample {k + 1}")
        _signals(SubElement(shot, "checkInputs"), facts.regressors, facts.samples[row])
        if internal:
            inside = SubElement(shot, "internalValues")
            for name, std in zip(COEFFICIENTS, facts.predicted_std[row], strict=True):
                signal = SubElement(inside, "signal")
                add_text(signal, "varID", f"{name}_std")
                add_text(signal, "signalValue", std)
        outputs = _signals(SubElement(shot, "checkOutputs"), COEFFICIENTS, facts.predicted[row])
        for signal, most in zip(outputs, tolerance, strict=True):
            add_text(signal, "tol", most)


def _signals(parent: Element, names: Sequence[str], values: Array) -> list[Element]:
    found = []
    for name, value in zip(names, values, strict=True):
        signal = SubElement(parent, "signal")
        SubElement(signal, "signalName").text, SubElement(signal, "signalUnits").text = _name(name), _unit(name)
        add_text(signal, "signalValue", value)
        found.append(signal)
    return found


def _name(name: str) -> str:
    return STANDARD_NAMES.get(name, name)


def _unit(name: str) -> str:
    unit = CHANNELS[name].unit if name in CHANNELS else "-"
    return {"-": "nd", "m/s": "m_s", "rad/s": "rad_s", "rad/s^2": "rad_s2", "m/s^2": "m_s2", "kg/m^3": "kg_m3"}.get(
        unit, unit
    )


def _numbers(values: Array) -> str:
    return ", ".join(map(number_text, np.ravel(values)))
