"""JSBSim: an aircraft with the aerodynamics of a model."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any, TypeAlias
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape

import numpy as np
from scipy.constants import foot, lbf, slug

from skdgp._compute.files import text_writer, write_atomically
from skdgp._compute.typing import Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.tables import check_full_deflections
from skdgp.dynamics import Aircraft, Propeller
from skdgp.export._model import PortableModel, Regressor, Term, inertia_entries
from skdgp.io import FULL_THROW

TEMPLATES = Path(__file__).with_name("jsbsim")
# Command, the command of JSBSim's trim, and position
SURFACES = {
    "elevator": ("fcs/elevator-cmd-norm", "fcs/pitch-trim-cmd-norm", "fcs/elevator-pos-rad"),
    "aileron": ("fcs/aileron-cmd-norm", "fcs/roll-trim-cmd-norm", "fcs/left-aileron-pos-rad"),
    "rudder": ("fcs/rudder-cmd-norm", "fcs/yaw-trim-cmd-norm", "fcs/rudder-pos-rad"),
}
THROTTLE = "fcs/throttle-cmd-norm"
SPEED = "fcs/propeller_speed"
AIRSPEED = "velocities/vt-fps"
DENSITY = "atmosphere/rho-slugs_ft3"
SOURCES = {
    "alpha": "aero/alpha-rad",
    "beta": "aero/beta-rad",
    "alpha_dot": "aero/alphadot-rad_sec",
    "beta_dot": "aero/betadot-rad_sec",
    "p": "velocities/p-aero-rad_sec",
    "q": "velocities/q-aero-rad_sec",
    "r": "velocities/r-aero-rad_sec",
    "airspeed": AIRSPEED,
    "density": DENSITY,
    "altitude": "position/h-sl-ft",
    "u": "velocities/u-fps",
    "v": "velocities/v-fps",
    "w": "velocities/w-fps",
    "phi": "attitude/phi-rad",
    "theta": "attitude/theta-rad",
    "psi": "attitude/psi-rad",
    "throttle": THROTTLE,
    "elevator": "fcs/elevator-pos-rad",
    "aileron": "fcs/left-aileron-pos-rad",
    "rudder": "fcs/rudder-pos-rad",
}
# SI units of those that are in others
UNITS = dict.fromkeys(("airspeed", "altitude", "u", "v", "w"), foot) | {"density": slug / foot**3}
ACCELERATIONS = ("p_dot", "q_dot", "r_dot", "ax", "ay", "az")
# Of a function: other functions, a property or a number
Operand: TypeAlias = "Element[Any] | str | float"


def write_jsbsim(
    folder: str | os.PathLike[str],
    model: PortableModel,
    *,
    full: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write an aircraft that JSBSim loads: metrics, mass, inertia, thrust and aerodynamics; return its file.

    ``jsbsim.FGFDMExec(str(folder)).load_model(NAME)`` loads ``folder/aircraft/NAME/NAME.xml``, NAME
    the name of the aircraft. A coefficient is its posterior mean: a constant, a linear function and
    Gaussian functions. It has no gear: add ``ground_reactions``. The thrust is of
    ``aircraft.propeller`` at ``fcs/throttle-cmd-norm``, which JSBSim's trim finds, or at
    ``fcs/propeller_speed`` [rad/s]; without a propeller the throttle's command is the fraction of
    ``full["thrust"]``, or the thrust is the property ``external_reactions/thrust/magnitude`` [lbf], which
    JSBSim's trim does not move. Raises ValueError if the model lacks a
    coefficient, a regressor is an acceleration, a full deflection is not known or no number > 0, or ``full`` names
    another control.

    Parameters
    ----------
    folder : path-like
        Created if it does not exist.
    model : PortableModel
    full : mapping of str to float, optional
        Deflections of elevator, aileron and rudder at a command of 1, in the unit of the control,
        [rad] unless it is "full throw". Default: the ``full_deflections`` of the aircraft, and 1 of
        a control in parts of its full throw. Without a propeller also the ``thrust`` [N] at full throttle.

    Returns
    -------
    list of Path
        The files.
    """
    if lacking := [name for name in COEFFICIENTS if name not in model.outputs]:
        raise ValueError(
            f"Got a model without {lacking}, but expected all six coefficients: learn them all."
        )
    full = _full_deflections(model, full or {})
    name = re.sub(r"[^\w-]", "_", model.aircraft.name, flags=re.ASCII) or "aircraft"
    path = Path(folder, "aircraft", name, f"{name}.xml")
    root = _skeleton(name, model.aircraft)
    _add_thrust(root, model.aircraft, full)
    _add_controls(root, model, full)
    _add_aerodynamics(root, model)
    ElementTree.indent(root, space=" ")
    text = ElementTree.tostring(root, encoding="unicode")
    write_atomically(path, text_writer(f'<?xml version="1.0"?>\n{text}\n'))
    return [path]


def _full_deflections(model: PortableModel, full: Mapping[str, float]) -> dict[str, float]:
    """Return the deflections at a command of 1, given or of the aircraft; ValueError if one is not known."""
    units = {r.name: r.unit for r in model.regressors if r.name in SURFACES}
    commands = units if model.aircraft.propeller is not None else units | {"thrust": "N"}
    given = check_full_deflections(full, commands, commands)
    by_unit = {name: 1.0 for name, unit in units.items() if unit == FULL_THROW}
    known = {**(model.aircraft.full_deflections or {}), **by_unit, **given}
    if lacking := [name for name in units if name not in known]:
        raise ValueError(
            f"Got no full deflection of {', '.join(lacking)}, but expected those at a command of 1 [rad]: give "
            f"full (--full {' '.join(f'{name}=...' for name in lacking)})."
        )
    return {name: float(known[name]) for name in units} | given


def _filled(template: str, values: Mapping[str, Any]) -> Element:
    """Return the element of a template."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    return ElementTree.fromstring(Template(text).substitute(values), parser)


def _part(element: Element, path: str) -> Element:
    """Return the element at a path, which a template has."""
    (node,) = element.findall(path)
    return node


def _skeleton(file: str, aircraft: Aircraft) -> Element:
    """Return the file of an aircraft without its functions and controls.

    JSBSim reads Ixy and Iyz in structural axes (x aft, z up), Ixz as the tensor's entry.
    """
    inertia = inertia_entries(aircraft)
    line = aircraft.engine_line
    x, y, z = map(float, line.position)
    along_x, along_y, along_z = map(float, line.direction)
    values = aircraft.to_dict() | inertia
    values |= {
        "file": file,
        "name": escape(aircraft.name),
        "ixy": -inertia["ixy"],
        "iyz": -inertia["iyz"],
        "thrust_x": -x,
        "thrust_y": y,
        "thrust_z": -z,
        "along_x": along_x,
        "along_y": along_y,
        "along_z": along_z,
    }
    return _filled("aircraft.xml", values)


def _add_thrust(root: Element, aircraft: Aircraft, full: Mapping[str, float]) -> None:
    """Add thrust and torque of the propeller, or the thrust at full throttle.

    JSBSim's trim moves the throttles of engines and no other property, so the file has one without power.
    """
    reactions = _part(root, "external_reactions")
    force = _part(reactions, "force")
    propeller = aircraft.propeller
    if propeller is not None:
        reactions.insert(0, _named("property", SPEED))
        thrust = _propeller(propeller, propeller.thrust_coefficients, 4, 1.0 / lbf)
        force.insert(0, _function("propulsion/thrust-lbs", thrust))
        if propeller.torque_coefficients:
            factor = -propeller.rotation / (lbf * foot)
            torque = _propeller(propeller, propeller.torque_coefficients, 5, factor)
            _part(reactions, "moment").insert(0, _function("propulsion/torque-lbsft", torque))
    elif "thrust" in full:
        thrust = _apply("product", full["thrust"] / lbf, THROTTLE)
        force.insert(0, _function("propulsion/thrust-lbs", thrust))


def _propeller(
    propeller: Propeller, coefficients: Sequence[float], power: int, factor: float
) -> Element:
    """Return rho D^power (c0 n^2 + c1 n V / D + c2 V^2 / D^2), n in revolutions per second."""
    if propeller.speed_range is None:
        turns = _apply("product", 0.5 / np.pi, SPEED)
    else:
        idle, full = (speed / (2 * np.pi) for speed in propeller.speed_range)
        turns = _apply("sum", idle, _apply("product", full - idle, THROTTLE))
    terms = []
    for k, coefficient in enumerate(coefficients):
        scale = coefficient * (foot / propeller.diameter) ** k
        terms.append(_apply("product", scale, *[AIRSPEED] * k, *[turns] * (2 - k)))
    scale = factor * propeller.diameter**power * slug / foot**3
    return _apply("product", scale, DENSITY, _apply("sum", *terms))


def _add_controls(root: Element, model: PortableModel, full: Mapping[str, float]) -> None:
    """Add surfaces with their servos, and the properties of other controls."""
    control = _part(root, "flight_control")
    channel = _part(control, "channel")
    for name in SURFACES:
        if name in model.regressor_names:
            channel.extend(_surface(name, full[name], *model.servos.tolist()))
    names = [r.name for r in model.regressors if not r.power and r.name not in SOURCES]
    for i, name in enumerate(names):
        control.insert(i, _named("property", f"fcs/{name}", value="0"))


def _surface(name: str, full: float, lag: float, delay: float, rate_limit: float) -> Element:
    """Return the command of a surface and its servo, whose delay JSBSim cuts to whole frames."""
    command, trim, position = SURFACES[name]
    values = {"surface": name, "command": command, "trim": trim, "position": position, "full": full}
    parts = _filled("surface.xml", values)
    servo = _part(parts, "actuator")
    if lag > 0:
        servo.append(_named("lag", repr(1.0 / lag)))
    if np.isfinite(rate_limit):
        servo.append(_named("rate_limit", repr(rate_limit / full)))
    if delay > 0:
        servo.append(_named("delay", repr(delay), type="time"))
    return parts


def _add_aerodynamics(root: Element, model: PortableModel) -> None:
    """Add regressors and coefficients before the loads."""
    functions = []
    for regressor in model.regressors:
        value = _apply("product", *_source(regressor, model.aircraft))
        functions.append(_function(f"aero/regressor/{regressor.name}", value))
    for name, shift, scale in zip(model.regressor_names, model.shift, model.scale, strict=True):
        value = _apply("product", 1 / scale, _apply("difference", f"aero/regressor/{name}", shift))
        functions.append(_function(f"aero/scaled/{name}", value))
    for coefficient in COEFFICIENTS:
        functions += _coefficient(model, coefficient)
    aerodynamics = _part(root, "aerodynamics")
    for i, function in enumerate(functions):
        aerodynamics.insert(i, function)


def _source(regressor: Regressor, aircraft: Aircraft) -> list:
    """Return the factors whose product is a regressor: numbers and properties."""
    source = regressor.sources[0] if regressor.power else regressor.name
    if source in ACCELERATIONS:
        raise ValueError(
            f"Got a model with the regressor {regressor.name!r}, an acceleration, which follows "
            "from the loads: fit one with regressors='quasi-steady'."
        )
    name = SOURCES.get(source, f"fcs/{source}")
    if regressor.power:
        return [name, "aero/bi2vel", regressor.length / aircraft.span]
    return [name, UNITS[source]] if source in UNITS else [name]


def _coefficient(model: PortableModel, coefficient: str) -> list[Element]:
    r"""Return a coefficient, behind the squares of its terms, which their exponentials share.

    .. math:: |f \circ z - c|^2 = |f \circ z|^2 - 2 (f \circ c)^T z + |c|^2
    """
    constant, slopes, gaussians = _mean(model, model.outputs.index(coefficient))
    names = [f"aero/scaled/{regressor}" for regressor in model.regressor_names]
    total = _plane(constant, slopes, names)
    functions = []
    for number, (term, weights) in enumerate(gaussians):
        square = f"aero/square/{coefficient}-{number}"
        functions.append(_function(square, _half_square(term, names)))
        constants = -0.5 * np.square(term.centres).sum(axis=1)
        inner = term.centres * term.inverse_widths
        for weight, at_zero, slope in zip(weights, constants, inner, strict=True):
            exponent = _apply("sum", square, *_plane(at_zero, slope, names))
            total.append(_apply("product", weight, _apply("exp", exponent)))
    functions.append(_function(f"aero/coefficient/{coefficient}", _apply("sum", *total)))
    return functions


def _half_square(term: Term, names: Sequence[str]) -> Element:
    """Return minus half of the square of f o z."""
    products = []
    for name, f in zip(names, term.inverse_widths.tolist(), strict=True):
        products.append(_apply("product", -0.5 * f**2, name, name))
    return _apply("sum", *products)


def _plane(constant: float, slopes: Vector, names: Sequence[str]) -> list[Any]:
    """Return the summands of a linear function."""
    steep = np.flatnonzero(slopes).tolist()
    return [constant, *(_apply("product", slopes[k], names[k]) for k in steep)]


def _mean(model: PortableModel, i: int) -> tuple[float, Vector, list[tuple[Term, Vector]]]:
    """Return constant, slopes and Gaussian functions with their weights, which add up to the mean of an output."""
    trend = np.zeros(len(model.regressors) + 1)
    gaussians = []
    for share, part in model.components(i):
        weight = share * model.output_scale[i]
        trend += weight * part.trend_weights
        for term in part.terms:
            gains = weight * term.gain * part.readout.weights[term.entries]
            gaussians.append((term, gains))
    return float(model.center[i] + trend[0]), trend[1:], gaussians


def _apply(operator: str, *operands: Operand) -> Element:
    """Return an operation; JSBSim complains of sums and products of one operand. Numbers have all their digits."""
    parts = []
    for operand in operands:
        if isinstance(operand, str):
            parts.append(_named("p", operand))
        elif isinstance(operand, Element):
            parts.append(operand)
        else:
            parts.append(_named("v", repr(float(operand))))
    if len(parts) == 1 and operator in ("sum", "product"):
        return parts[0]
    node = Element(operator)
    node.extend(parts)
    return node


def _named(tag: str, text: str, **attributes: str) -> Element:
    """Return an element with a text."""
    node = Element(tag, attributes)
    node.text = text
    return node


def _function(name: str, value: Element) -> Element:
    node = Element("function", name=name)
    node.append(value)
    return node
