"""JSBSim: an aircraft with the aerodynamics of a model."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any, TypeAlias
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from skdgp._compute.files import text_writer, write_atomically
from skdgp._compute.messages import warn
from skdgp._compute.typing import Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_number
from skdgp.dynamics import Aircraft, ThrustLine
from skdgp.export._model import PortableModel, Regressor, Term
from skdgp.io import FULL_THROW

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
SLUG, FOOT_POUND = POUND_FORCE / FOOT, POUND_FORCE * FOOT
CENTRE = (0.0, 0.0, 0.0)
AXES = {"CX": "X", "CY": "Y", "CZ": "Z", "Cl": "ROLL", "Cm": "PITCH", "Cn": "YAW"}
REFERENCES = {"Cl": ["metrics/bw-ft"], "Cm": ["metrics/cbarw-ft"], "Cn": ["metrics/bw-ft"]}
SURFACES = {
    "elevator": ("fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
    "aileron": ("fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
    "rudder": ("fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
}
TRIMS = {
    "elevator": "fcs/pitch-trim-cmd-norm",
    "aileron": "fcs/roll-trim-cmd-norm",
    "rudder": "fcs/yaw-trim-cmd-norm",
}
THROTTLE, SPEED, AIRSPEED = "fcs/throttle-cmd-norm", "fcs/propeller_speed", "velocities/vt-fps"
SOURCES = {  # property and factor to SI units
    "alpha": ("aero/alpha-rad", 1.0),
    "beta": ("aero/beta-rad", 1.0),
    "alpha_dot": ("aero/alphadot-rad_sec", 1.0),
    "beta_dot": ("aero/betadot-rad_sec", 1.0),
    "p": ("velocities/p-aero-rad_sec", 1.0),
    "q": ("velocities/q-aero-rad_sec", 1.0),
    "r": ("velocities/r-aero-rad_sec", 1.0),
    "airspeed": (AIRSPEED, FOOT),
    "density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3),
    "altitude": ("position/h-sl-ft", FOOT),
    "u": ("velocities/u-fps", FOOT),
    "v": ("velocities/v-fps", FOOT),
    "w": ("velocities/w-fps", FOOT),
    "phi": ("attitude/phi-rad", 1.0),
    "theta": ("attitude/theta-rad", 1.0),
    "psi": ("attitude/psi-rad", 1.0),
    "throttle": (THROTTLE, 1.0),
    **{name: (position, 1.0) for name, (_, position) in SURFACES.items()},
}
ACCELERATIONS = ("p_dot", "q_dot", "r_dot", "ax", "ay", "az")
NOTE = """
 Made by skdgp from flights. Forces act along body axes (x forward, y right, z down) at the centre of gravity, which is
 the origin. Properties of the aerodynamics:
   aero/regressor/NAME      regressors, SI units and radians, or the unit of the control; NAME_hat: non-dimensional rate
   aero/coefficient/CX      coefficients CX CY CZ Cl Cm Cn
 Signs: elevator > 0 pitches down, aileron > 0 rolls right, rudder > 0 yaws left. Surfaces follow commands with the lag
 of the servos. Of a model with controls in parts of their full throw, -pos-rad holds these parts.
 Deflections at a command of 1: $full.
"""
# Of an element: other elements and comments, or a text or a number
Content: TypeAlias = "Element[Any] | str | float"
# Terms with the weights of their functions
Gaussians: TypeAlias = "list[tuple[Term, Vector]]"


def write_jsbsim(
    folder: str | os.PathLike[str],
    model: PortableModel,
    *,
    full: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write an aircraft that JSBSim loads: metrics, mass, inertia, thrust and aerodynamics; return its file.

    ``jsbsim.FGFDMExec(str(folder)).load_model(NAME)`` loads ``folder/aircraft/NAME/NAME.xml``, NAME
    the name of the aircraft. A coefficient is its posterior mean: a constant, a linear function and
    Gaussian functions. The thrust is of
    ``aircraft.propeller`` at ``fcs/throttle-cmd-norm``, which JSBSim's trim finds, or at
    ``fcs/propeller_speed`` [rad/s]; without a propeller it is the property
    ``external_reactions/thrust/magnitude`` [lbf]. Raises ValueError if the model lacks a
    coefficient, a regressor is an acceleration, or ``full`` names another control or is no number > 0.

    Parameters
    ----------
    folder : path-like
        Created if it does not exist.
    model : PortableModel
    full : mapping of str to float, optional
        Deflections of elevator, aileron and rudder at a command of 1, in the unit of the control,
        [rad] unless it is "full throw". Default: the ``full_deflections`` of the aircraft, or 1 of
        a control in parts of its full throw.

    Returns
    -------
    list of Path
        The files.

    Warns
    -----
    UserWarning
        If no full deflection of a control is known. A command of 1 is then the largest deflection
        of the flights, so gains tuned in JSBSim are too large for servos that throw more.
    """
    if lacking := [name for name in COEFFICIENTS if name not in model.outputs]:
        raise ValueError(
            f"Got a model without {lacking}, but expected all six coefficients: learn them all."
        )
    full = _full_deflections(model, full or {})
    name = re.sub(r"[^\w-]", "_", model.aircraft.name, flags=re.ASCII) or "aircraft"
    path = Path(folder, "aircraft", name, f"{name}.xml")
    root = _config(name, model, full)
    path.parent.mkdir(parents=True, exist_ok=True)
    ElementTree.indent(root, space=" ")
    text = ElementTree.tostring(root, encoding="unicode")
    write_atomically(path, text_writer(f'<?xml version="1.0"?>\n{text}\n'))
    return [path]


def _full_deflections(model: PortableModel, full: Mapping[str, float]) -> dict[str, float]:
    """Return the deflections at a command of 1: given, of the aircraft, or the largest flown with a warning."""
    units = {r.name: r.unit for r in model.regressors if r.name in SURFACES}
    for name, value in full.items():
        if name not in units:
            raise ValueError(
                f"Got a full deflection of {name!r}, but expected one of the commands of this "
                f"model: {', '.join(units) or 'it has none'}."
            )
        check_number(f"full deflection of the {name}", value, unit=units[name])
    of_aircraft = model.aircraft.full_deflections or {}
    deflections = {}
    flown = {}
    for name, unit in units.items():
        if name in full:
            deflections[name] = float(full[name])
        elif unit == FULL_THROW:
            deflections[name] = 1.0
        elif name in of_aircraft:
            deflections[name] = of_aircraft[name]
        else:
            column = model.regressor_names.index(name)
            flown[name] = deflections[name] = float(np.abs(model.limits[:, column]).max())
    if flown:
        values = ", ".join(f"{name} {value:.3g} {units[name]}" for name, value in flown.items())
        example = " ".join(f"{name}=..." for name in flown)
        warn(
            f"Got no full deflections, so a command of 1 is the largest deflection of the flights: "
            f"{values}. Gains tuned with it are too large for servos that throw more: give full "
            f"(--full {example}).",
            stacklevel=3,
        )
    return deflections


def _config(name: str, model: PortableModel, full: Mapping[str, float]) -> Element:
    """Return the file of an aircraft."""
    aircraft = model.aircraft
    controls = [r.name for r in model.regressors if not r.power and r.name not in SOURCES]
    has_engine = aircraft.propeller is not None and aircraft.propeller.speed_range is not None
    regressors = [
        _function(f"aero/regressor/{r.name}", _apply("product", *_source(r, aircraft)))
        for r in model.regressors
    ]
    scaled = [
        _function(
            f"aero/scaled/{r}",
            _apply("product", 1.0 / scale, _apply("difference", f"aero/regressor/{r}", shift)),
        )
        for r, shift, scale in zip(model.regressor_names, model.shift, model.scale, strict=True)
    ]
    coefficients = [each for c in COEFFICIENTS for each in _coefficient(model, c)]
    note = Template(NOTE).substitute(full=_full_text(model, full))
    settable = [*([] if has_engine else [THROTTLE]), *(f"fcs/{c}" for c in controls)]
    return element(
        "fdm_config",
        ElementTree.Comment(note),
        element(
            "fileheader", element("description", f"{aircraft.name}, learned from flights by skdgp")
        ),
        element(
            "metrics",
            element("wingarea", aircraft.wing_area, unit="M2"),
            element("wingspan", aircraft.span, unit="M"),
            element("chord", aircraft.chord, unit="M"),
            *(
                _vector("location", CENTRE, name=place, unit="M")
                for place in ("AERORP", "EYEPOINT", "VRP")
            ),
        ),
        _mass(aircraft),
        element("ground_reactions"),
        _thrust(aircraft),
        *([_engine()] if has_engine else []),
        _controls(model, settable, full),
        element("aerodynamics", *regressors, *scaled, *coefficients, *map(_load, COEFFICIENTS)),
        name=name,
        version="2.0",
        release="BETA",
    )


def _mass(aircraft: Aircraft) -> Element:
    """Return mass and inertia: JSBSim reads Ixy and Iyz in structural axes (x aft, z up), Ixz as the tensor's entry."""
    J = aircraft.inertia
    entries = {
        "ixx": J[0, 0],
        "iyy": J[1, 1],
        "izz": J[2, 2],
        "ixy": -J[0, 1],
        "ixz": J[0, 2],
        "iyz": -J[1, 2],
    }
    return element(
        "mass_balance",
        *(element(tag, value, unit="KG*M2") for tag, value in entries.items()),
        element("emptywt", aircraft.mass, unit="KG"),
        _vector("location", CENTRE, name="CG", unit="M"),
        negated_crossproduct_inertia="true",
    )


def _thrust(aircraft: Aircraft) -> Element:
    line, propeller = aircraft.thrust_line or ThrustLine(), aircraft.propeller
    x, y, z = map(float, line.position)
    placement = [_vector("location", (-x, y, -z), unit="M"), _vector("direction", line.direction)]
    if propeller is None:
        return element(
            "external_reactions", element("force", *placement, name="thrust", frame="BODY")
        )
    loads = propeller.thrust_coefficients, propeller.torque_coefficients
    thrust = _propeller("propulsion/thrust-lbs", propeller, loads[0], 4, 1.0 / POUND_FORCE)
    parts = [element("force", thrust, *placement, name="thrust", frame="BODY")]
    if loads[1]:
        torque = _propeller(
            "propulsion/torque-lbsft", propeller, loads[1], 5, -propeller.rotation / FOOT_POUND
        )
        parts.append(
            element(
                "moment",
                torque,
                _vector("direction", line.direction),
                name="propeller",
                frame="BODY",
            )
        )
    return element("external_reactions", element("property", SPEED), *parts)


def _propeller(
    name: str, propeller: Any, coefficients: Sequence[float], power: int, factor: float
) -> Element:
    """Return the function rho D^power (c0 n^2 + c1 n V / D + c2 V^2 / D^2), n in revolutions per second."""

    def turns():
        if propeller.speed_range is None:
            return _apply("product", 0.5 / np.pi, SPEED)
        idle, full = (speed / (2 * np.pi) for speed in propeller.speed_range)
        return _apply("sum", idle, _apply("product", full - idle, THROTTLE))

    terms = [
        _apply(
            "product",
            c * (FOOT / propeller.diameter) ** k,
            *[AIRSPEED] * k,
            *(turns() for _ in range(2 - k)),
        )
        for k, c in enumerate(coefficients)
    ]
    scale = factor * propeller.diameter**power * SLUG / FOOT**3
    return _function(
        name, _apply("product", scale, "atmosphere/rho-slugs_ft3", _apply("sum", *terms))
    )


def _engine() -> Element:
    """Return an engine without power: JSBSim's trim moves the throttles of its engines, and no other property."""
    power = element("electric_engine", element("power", 0.0, unit="WATTS"), name="throttle")
    thruster = element(
        "thruster", element("direct", name="none"), _vector("location", CENTRE, unit="M")
    )
    return element("propulsion", element("engine", power, thruster))


def _full_text(model: PortableModel, full: Mapping[str, float]) -> str:
    """Return the deflections at a command of 1 as text."""
    units = {r.name: r.unit for r in model.regressors}
    values = ", ".join(f"{name} {value:.4g} {units[name]}" for name, value in full.items())
    return values or "none"


def _controls(
    model: PortableModel, properties: Sequence[str], full: Mapping[str, float]
) -> Element:
    parts = []
    for name, (command, position) in SURFACES.items():
        if name in model.regressor_names:
            # JSBSim trims by the second
            inputs = [element("input", place) for place in (command, TRIMS[name])]
            servo = element(
                "actuator",
                element("input", f"fcs/{name}-sum"),
                *(element("lag", 1.0 / lag) for lag in model.servo_lag.tolist() if lag > 0),
                name=f"fcs/{name}-servo",
            )
            scale = element(
                "aerosurface_scale",
                element("input", f"fcs/{name}-servo"),
                element("range", element("min", -full[name]), element("max", full[name])),
                element("output", position),
                name=f"fcs/{name}-scale",
            )
            parts += [element("summer", *inputs, name=f"fcs/{name}-sum"), servo, scale]
    settable = [element("property", name, value="0") for name in properties]
    return element(
        "flight_control", *settable, element("channel", *parts, name="surfaces"), name="surfaces"
    )


def _source(regressor: Regressor, aircraft: Aircraft) -> list:
    """Return the factors whose product is a regressor: numbers and properties."""
    source = regressor.sources[0] if regressor.power else regressor.name
    if source in ACCELERATIONS:
        raise ValueError(
            f"Got a model with the regressor {regressor.name!r}, an acceleration, which follows "
            "from the loads: fit one with regressors='quasi-steady'."
        )
    name, factor = SOURCES.get(source, (f"fcs/{source}", 1.0))
    if regressor.power:
        return [name, "aero/bi2vel", regressor.length / aircraft.span]
    return [name, factor] if factor != 1.0 else [name]


def _load(coefficient: str) -> Element:
    """Return the force or the moment of a coefficient."""
    axis, lengths = AXES[coefficient], REFERENCES.get(coefficient, [])
    factors = ["aero/qbar-psf", "metrics/Sw-sqft", *lengths, f"aero/coefficient/{coefficient}"]
    load = _function(f"aero/{'moment' if lengths else 'force'}/{axis}", _apply("product", *factors))
    return element("axis", load, name=axis, **({} if lengths else {"unit": "LBS"}))


def _coefficient(model: PortableModel, coefficient: str) -> Iterator[Element]:
    r"""Yield a coefficient, behind the squares of its terms, which their exponentials share.

    .. math:: |F^T z - c|^2 = z^T F F^T z - 2 (F c)^T z + |c|^2
    """
    constant, slopes, gaussians = _mean(model, model.outputs.index(coefficient))
    names = [f"aero/scaled/{regressor}" for regressor in model.regressor_names]
    total = _plane(constant, slopes, names)
    for number, (term, weights) in enumerate(gaussians):
        A = term.root @ term.root.T
        squares = [_apply("product", -0.5 * A[k, n], names[k], names[n]) for k, n in np.argwhere(A)]
        square = f"aero/square/{coefficient}-{number}"
        yield _function(square, _apply("sum", *squares))
        constants = -0.5 * np.square(term.centres).sum(axis=1)
        inner = term.centres @ term.root.T
        for weight, at_zero, slope in zip(weights, constants, inner, strict=True):
            exponent = _apply("sum", square, *_plane(at_zero, slope, names))
            total.append(_apply("product", weight, _apply("exp", exponent)))
    yield _function(f"aero/coefficient/{coefficient}", _apply("sum", *total))


def _plane(constant: float, slopes: Vector, names: Sequence[str]) -> list[Any]:
    """Return the summands of a linear function."""
    steep = np.flatnonzero(slopes).tolist()
    return [constant, *(_apply("product", slopes[k], names[k]) for k in steep)]


def _mean(model: PortableModel, i: int) -> tuple[float, Vector, Gaussians]:
    """Return constant, slopes and Gaussian functions with their weights, which add up to the mean of an output."""
    trend = np.zeros(len(model.regressors) + 1)
    gaussians: Gaussians = []
    weights = model.mixture[:, i] * model.output_scale[i]
    for weight, part in zip(weights, model.parts[i :: len(model.outputs)], strict=True):
        if weight == 0.0:
            continue
        trend += weight * part.trend_weights
        for term in part.terms:
            gains = weight * term.gain * part.readout.weights[term.entries]
            gaussians.append((term, gains))
    constant = float(model.center[i] + trend[0] - trend[1:] @ model.trend_center)
    return constant, trend[1:], gaussians


def element(tag: str, *content: Content, **attributes: str) -> Element:
    """Return an element of XML; numbers have all their digits."""
    node = Element(tag, attributes)
    for child in content:
        if isinstance(child, Element):
            node.append(child)
        else:
            node.text = child if isinstance(child, str) else repr(float(child))
    return node


def _apply(operator: str, *operands: Content) -> Element:
    """Return an operation of numbers, properties and others; JSBSim complains of sums and products of one."""
    parts = [
        o if isinstance(o, Element) else element("p" if isinstance(o, str) else "v", o)
        for o in operands
    ]
    return (
        parts[0]
        if len(parts) == 1 and operator in ("sum", "product")
        else element(operator, *parts)
    )


def _function(name: str, *content: Content) -> Element:
    return element("function", *content, name=name)


def _vector(tag: str, values: Sequence[float], **attributes: str) -> Element:
    return element(tag, *map(element, "xyz", values), **attributes)
