"""DAVE-ML 2.0 (AIAA S-119): the build-up with its uncertainty and check cases."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from skdgp._compute.files import write_atomically
from skdgp._compute.typing import Array
from skdgp._flight.channels import CHANNELS, COEFFICIENTS
from skdgp.export._build_up import BuildUp, Table

DOCTYPE = (
    '<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"\n'
    '  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">'
)
NAMESPACE, MATHML = "http://daveml.org/2010/DAVEML", "http://www.w3.org/1998/Math/MathML"
STANDARD_NAMES = {
    "alpha": "angleOfAttack", "beta": "angleOfSideslip", "elevator": "elevatorDeflection",
    "aileron": "aileronDeflection", "rudder": "rudderDeflection", "airspeed": "trueAirspeed",
    "CX": "aeroBodyForceCoefficient_X", "CY": "aeroBodyForceCoefficient_Y", "CZ": "aeroBodyForceCoefficient_Z",
    "Cl": "aeroBodyMomentCoefficient_Roll", "Cm": "aeroBodyMomentCoefficient_Pitch",
    "Cn": "aeroBodyMomentCoefficient_Yaw",
}  # fmt: skip
CHECK_TOLERANCE = 1e-9


def write_dave_ml(path: str | os.PathLike, build: BuildUp, *, n_checks: int = 16) -> None:
    """Write a build-up as a DAVE-ML 2.0 file.

    Inputs are the regressors of the model, SI units and radians; outputs are CX CY CZ Cl Cm Cn. Constants, derivatives
    and cells of tables have ``uncertainty`` elements: additive, normal, one standard deviation. Cells of all terms are
    correlated, which the file does not state; ``BuildUp.sample`` draws them jointly. Check cases are values of the
    build-up at its samples.

    Parameters
    ----------
    path : path-like
        Such as ``uav.dml``; ``xmllint --dtdvalid DAVEfunc.dtd uav.dml`` validates it.
    build : BuildUp
    n_checks : int, default=16
        Number of check cases.

    Raises
    ------
    ValueError
        If ``n_checks`` is less than 1.

    Examples
    --------
    ``write_dave_ml("uav.dml", build_up(model, aircraft))`` writes the model of a pipeline.
    """
    if n_checks < 1:
        raise ValueError(f"Got n_checks={n_checks!r}, but expected at least one check case.")
    root = Element("DAVEfunc", xmlns=NAMESPACE)
    _add_header(root, build)
    _add_inputs(root, build)
    tables = [(f"{name}_t{k}", table) for name in COEFFICIENTS for k, table in enumerate(build.tables[name])]
    for name in COEFFICIENTS:
        _add_constants(root, build, name)
    for name, _ in tables:
        SubElement(root, "variableDef", name=name, varID=name, units="nd")
    for name in COEFFICIENTS:
        _add_output(root, build, name)
    for name, table in tables:
        for axis, points in enumerate(table.breakpoints):
            place = SubElement(root, "breakpointDef", bpID=f"{name}_b{axis}", units=_unit(table.regressors[axis]))
            SubElement(place, "bpVals").text = _numbers(points)
    for name, table in tables:
        _add_function(root, name, table)
    _add_checks(root, build, n_checks)
    ElementTree.indent(root)
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{DOCTYPE}\n{ElementTree.tostring(root, encoding="unicode")}\n'
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _add_header(root: Element, build: BuildUp) -> None:
    header = SubElement(root, "fileHeader", name=f"Aerodynamics of {build.aircraft.name}")
    SubElement(header, "author", name="skdgp", org="skdgp")
    SubElement(header, "creationDate", date=datetime.now(UTC).date().isoformat())
    loss = "; ".join(f"{n} {row.loss:.3g} of {row.deviation:.3g}" for n, row in build.loss.iterrows())
    SubElement(header, "description").text = (
        "Learned from flights. Body axes, x forward, y right, z down. Elevator > 0 pitches down, aileron > 0 rolls "
        f"right, rudder > 0 yaws left. Loss of the build-up and posterior deviation, root mean square: {loss}."
    )


def _add_inputs(root: Element, build: BuildUp) -> None:
    for k, name in enumerate(build.regressors):
        low, high = (_number(limit) for limit in build.limits[:, k])
        place = SubElement(root, "variableDef", name=_name(name), varID=name, units=_unit(name))
        SubElement(place, "description").text = f"flown from {low} to {high}"
        SubElement(place, "isInput")


def _add_constants(root: Element, build: BuildUp, name: str) -> None:
    """Write the constant at the reference and the derivatives, with their uncertainty."""
    values = {f"{name}_0": (build.constants[name], build.constants_std[name])}
    for regressor in build.regressors:
        entry = build.derivatives.loc[name, regressor], build.derivatives_std.loc[name, regressor]
        values[f"{name}_{regressor}"] = entry
    for variable, (value, std) in values.items():
        text = _number(value)
        place = SubElement(root, "variableDef", name=variable, varID=variable, units="nd", initialValue=text)
        SubElement(_normal(place), "bounds").text = _number(std)


def _add_output(root: Element, build: BuildUp, name: str) -> None:
    place = SubElement(root, "variableDef", name=_name(name), varID=name, units="nd")
    apply = SubElement(SubElement(SubElement(place, "calculation"), "math", xmlns=MATHML), "apply")
    SubElement(apply, "plus")
    SubElement(apply, "ci").text = f"{name}_0"
    for k, regressor in enumerate(build.regressors):
        product = SubElement(apply, "apply")
        SubElement(product, "times")
        SubElement(product, "ci").text = f"{name}_{regressor}"
        difference = SubElement(product, "apply")
        SubElement(difference, "minus")
        SubElement(difference, "ci").text = regressor
        SubElement(difference, "cn").text = _number(build.reference[k])
    for k in range(len(build.tables[name])):
        SubElement(apply, "ci").text = f"{name}_t{k}"
    SubElement(place, "isOutput")


def _add_function(root: Element, name: str, table: Table) -> None:
    function = SubElement(root, "function", name=name)
    for regressor, points in zip(table.regressors, table.breakpoints, strict=True):
        place = SubElement(function, "independentVarRef", varID=regressor, extrapolate="neither")
        place.set("min", _number(points[0]))
        place.set("max", _number(points[-1]))
    SubElement(function, "dependentVarRef", varID=name)
    grid = SubElement(SubElement(function, "functionDefn"), "griddedTableDef", gtID=f"{name}_g", units="nd")
    references = SubElement(grid, "breakpointRefs")
    for axis in range(len(table.breakpoints)):
        SubElement(references, "bpRef", bpID=f"{name}_b{axis}")
    SubElement(SubElement(_normal(grid), "bounds"), "dataTable").text = _numbers(table.std)
    SubElement(grid, "dataTable").text = _numbers(table.values)


def _normal(parent: Element) -> Element:
    return SubElement(SubElement(parent, "uncertainty", effect="additive"), "normalPDF", numSigmas="1")


def _add_checks(root: Element, build: BuildUp, n_checks: int) -> None:
    X = build.samples[np.linspace(0, len(build.samples) - 1, n_checks).astype(int)]
    checks = SubElement(root, "checkData")
    for k, (x, y) in enumerate(zip(X, build.evaluate(X), strict=True)):
        shot = SubElement(checks, "staticShot", name=f"sample {k + 1}")
        _signals(SubElement(shot, "checkInputs"), build.regressors, x)
        for signal in _signals(SubElement(shot, "checkOutputs"), COEFFICIENTS, y):
            SubElement(signal, "tol").text = _number(CHECK_TOLERANCE)


def _signals(parent: Element, names: Sequence[str], values: Array) -> list[Element]:
    found = []
    for name, value in zip(names, values, strict=True):
        signal = SubElement(parent, "signal")
        SubElement(signal, "signalName").text, SubElement(signal, "signalUnits").text = _name(name), _unit(name)
        SubElement(signal, "signalValue").text = _number(value)
        found.append(signal)
    return found


def _name(name: str) -> str:
    return STANDARD_NAMES.get(name, name)


def _unit(name: str) -> str:
    unit = CHANNELS[name].unit if name in CHANNELS else "-"
    return {"-": "nd", "m/s": "m_s", "rad/s": "rad_s", "rad/s^2": "rad_s2", "m/s^2": "m_s2", "kg/m^3": "kg_m3"}.get(
        unit, unit
    )


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Array) -> str:
    return ", ".join(map(_number, np.ravel(values)))
