"""JSBSim: aircraft folders with the aerodynamics of a model, as functions or as tables."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skdgp._compute.typing import Seed, Vector
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, HAT, RATE_LENGTHS
from skdgp._flight.checks import check_choice
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import BuildUp, build_up
from skdgp.export._gaussians import GaussianSum, gaussian_sums
from skdgp.export._text import add_text, changes_text, file_name, identifiers, number_text, write_xml

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
SLUG = POUND_FORCE / FOOT
AXES = {"CX": "X", "CY": "Y", "CZ": "Z", "Cl": "ROLL", "Cm": "PITCH", "Cn": "YAW"}
LENGTHS = {"Cl": "metrics/bw-ft", "Cm": "metrics/cbarw-ft", "Cn": "metrics/bw-ft"}
SURFACES = {
    "elevator": ("fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
    "aileron": ("fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
    "rudder": ("fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
}
TRIMS = {"elevator": "fcs/pitch-trim-cmd-norm", "aileron": "fcs/roll-trim-cmd-norm", "rudder": "fcs/yaw-trim-cmd-norm"}
THROTTLE = "fcs/throttle-cmd-norm"
SOURCES = {  # property and factor to SI units
    "alpha": ("aero/alpha-rad", 1.0),
    "beta": ("aero/beta-rad", 1.0),
    "alpha_dot": ("aero/alphadot-rad_sec", 1.0),
    "beta_dot": ("aero/betadot-rad_sec", 1.0),
    "p": ("velocities/p-aero-rad_sec", 1.0),
    "q": ("velocities/q-aero-rad_sec", 1.0),
    "r": ("velocities/r-aero-rad_sec", 1.0),
    "airspeed": ("velocities/vt-fps", FOOT),
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
IMPLICIT = ("p_dot", "q_dot", "r_dot", "ax", "ay", "az")
NOTE = """
 Made by skdgp from flights. Forces act along body axes (x forward, y right, z down) at the centre of gravity, which is
 the origin. Properties of the aerodynamics:
   aero/regressor/NAME    regressors, SI units and radians; NAME_hat: non-dimensional rate
   aero/coefficient/CX    coefficients CX CY CZ Cl Cm Cn
 Signs: elevator > 0 pitches down, aileron > 0 rolls right, rudder > 0 yaws left. A command of 1 is the largest
 deflection of the flights.
"""


def write_jsbsim(
    folder: str | os.PathLike,
    model: Any,
    aircraft: Aircraft,
    *,
    form: str = "functions",
    n_draws: int = 0,
    random_state: Seed = 0,
    tolerance: float = 0.1,
    max_loss: float = 0.25,
    **options: Any,
) -> list[Path]:
    """Write an aircraft that JSBSim loads: metrics, mass, inertia, thrust and aerodynamics.

    With ``form="functions"`` the coefficients are the posterior mean, as sums of exponentials, and further aircraft are
    functions drawn from the posterior, as sums of exponentials and cosines: those that ``sample_paths`` and
    ``simulate(n_paths=n_draws, gusts=None, drift=False)`` draw with the same ``random_state``. A model with exact
    inference is compacted first (``DependentGPRegressor.compact``), and its draws are those of the compact model. With
    ``form="tables"`` the coefficients are those of :func:`build_up`, faster to evaluate and easier to read, where they
    lose at most ``max_loss``, and so are the draws.

    The aircraft is ``folder/aircraft/NAME/NAME.xml``, so ``jsbsim.FGFDMExec(str(folder)).load_model(NAME)`` loads it.
    The thrust is that of ``aircraft.propeller`` at ``fcs/throttle-cmd-norm``, which JSBSim's trim finds, or at
    ``fcs/propeller_speed`` [rad/s]; without a propeller it is the property ``external_reactions/thrust/magnitude``
    [lbf]. Raises ValueError if a
    parameter is invalid, a regressor is no property of JSBSim (accelerations), the kernel is not a sum of Gaussian
    processes and a linear trend (functions, and tables that lose more than ``max_loss``).

    Parameters
    ----------
    folder : path-like
        Created if it does not exist.
    model : DependentGPRegressor, Pipeline or BuildUp
        Fitted; a build-up is written as tables.
    aircraft : Aircraft
        Its name names the files.
    form : {"functions", "tables"}, default="functions"
    n_draws : int, default=0
        Number of further aircraft ``NAME_001``, ...: functions drawn from the posterior.
    random_state : int, RandomState or None, default=0
        Of the draws.
    tolerance : float, default=0.1
        As of :func:`build_up`, or as of ``DependentGPRegressor.compact`` for functions.
    max_loss : float, default=0.25
        Largest loss of tables, as a fraction of the posterior deviation, both root mean squares over the samples. A
        coefficient that loses more is written as functions; ``np.inf`` accepts any loss.
    **options
        Of :func:`build_up`, for tables.

    Returns
    -------
    list of Path
        The files.
    """
    check_choice("form", form, ("functions", "tables"))
    if n_draws < 0:
        raise ValueError(f"Got n_draws={n_draws!r}, but expected a number of aircraft from 0 on.")
    if not isinstance(random_state, Integral):  # tables and functions are parts of the same draws
        random_state = check_random_state(random_state).randint(2**31 - 1)
    functions: list[GaussianSum] = []
    names: Sequence[str] = COEFFICIENTS  # that are written as functions
    build = model if isinstance(model, BuildUp) else None
    if build is None and form == "tables":
        build = build_up(model, aircraft, tolerance=tolerance, max_loss=np.inf, **options)
        ratio = build.loss["loss"] / build.loss["deviation"]
        names = list(ratio.index[ratio > max_loss])
    if model is not build and names:
        functions = gaussian_sums(
            model, aircraft, X=options.get("X"), tolerance=tolerance, n_draws=n_draws, random_state=random_state
        )
    tables = [] if build is None else [build, *build.sample(n_draws, random_state)]
    written = [
        {c: functions[k] if functions and c in names else tables[k] for c in COEFFICIENTS} for k in range(1 + n_draws)
    ]
    name = file_name(aircraft.name)
    paths = []
    for k, parts in enumerate(written):
        own = name if k == 0 else f"{name}_{k:03d}"
        paths.append(Path(folder, "aircraft", own, f"{own}.xml"))
        paths[-1].parent.mkdir(parents=True, exist_ok=True)
        root = jsbsim_config(own, parts, aircraft)
        ElementTree.indent(root, space=" ")
        write_xml(paths[-1], root)
    return paths


def jsbsim_config(name: str, parts: dict[str, BuildUp | GaussianSum], aircraft: Aircraft) -> Element:
    """Return the file of an aircraft, with each coefficient of ``parts`` as tables or as functions."""
    root = Element("fdm_config", name=name, version="2.0", release="BETA")
    names = identifiers(next(iter(parts.values())).regressors)
    parts = {coefficient: part.renamed(names) for coefficient, part in parts.items()}
    found = next(iter(parts.values()))
    loss = pd.concat([part.loss.loc[[coefficient]] for coefficient, part in parts.items()])
    lines = [*loss.to_string().splitlines(), f"Names: {text}" if (text := changes_text(names)) else ""]
    root.append(ElementTree.Comment(NOTE + "".join(f"   {line}\n" for line in lines)))
    header = SubElement(root, "fileheader")
    add_text(header, "description", f"{aircraft.name}, learned from flights by skdgp")
    _add_metrics(root, aircraft)
    _add_mass(root, aircraft)
    SubElement(root, "ground_reactions")
    _add_thrust(root, aircraft)
    controls = [r for r in found.regressors if r not in SOURCES and _rate(r) is None and r not in IMPLICIT]
    _add_controls(root, found, controls, has_throttle=root.find("propulsion") is not None)
    aerodynamics = SubElement(root, "aerodynamics")
    for regressor in found.regressors:
        function = SubElement(aerodynamics, "function", name=f"aero/regressor/{regressor}")
        _product(function, *_source(regressor, found.lengths, aircraft, controls))
    functions = {name: part for name, part in parts.items() if isinstance(part, GaussianSum)}
    if functions:
        _add_waves(aerodynamics, next(iter(functions.values())), [COEFFICIENTS.index(name) for name in functions])
    for coefficient, part in parts.items():
        if isinstance(part, GaussianSum):
            _add_gaussians(aerodynamics, part, coefficient)
        else:
            _add_tables(aerodynamics, part, coefficient)
    for coefficient, axis in AXES.items():
        place = SubElement(aerodynamics, "axis", name=axis)
        if coefficient not in LENGTHS:
            place.set("unit", "LBS")
        load = SubElement(place, "function", name=f"aero/{'moment' if coefficient in LENGTHS else 'force'}/{axis}")
        lengths = [LENGTHS[coefficient]] if coefficient in LENGTHS else []
        _product(load, "aero/qbar-psf", "metrics/Sw-sqft", *lengths, f"aero/coefficient/{coefficient}")
    _simplify(root)
    return root


def _simplify(root: Element) -> None:
    """Replace sums and products of one argument by the argument: JSBSim complains of each."""
    for parent in root.iter():
        for place, child in enumerate(parent):
            while child.tag in ("sum", "product") and len(child) == 1:
                parent[place] = child = child[0]


def _add_metrics(root: Element, aircraft: Aircraft) -> None:
    metrics = SubElement(root, "metrics")
    for tag, value, unit in (
        ("wingarea", aircraft.wing_area, "M2"), ("wingspan", aircraft.span, "M"), ("chord", aircraft.chord, "M"),
    ):  # fmt: skip
        add_text(metrics, tag, value, unit=unit)
    for place in ("AERORP", "EYEPOINT", "VRP"):
        _vector(metrics, "location", (0.0, 0.0, 0.0), name=place, unit="M")


def _add_mass(root: Element, aircraft: Aircraft) -> None:
    """Write mass and inertia: JSBSim reads Ixy and Iyz in structural axes (x aft, z up), Ixz as the tensor's entry."""
    J = aircraft.inertia
    mass = SubElement(root, "mass_balance", negated_crossproduct_inertia="true")
    entries = {"ixx": J[0, 0], "iyy": J[1, 1], "izz": J[2, 2], "ixy": -J[0, 1], "ixz": J[0, 2], "iyz": -J[1, 2]}
    for tag, value in entries.items():
        add_text(mass, tag, value, unit="KG*M2")
    add_text(mass, "emptywt", aircraft.mass, unit="KG")
    _vector(mass, "location", (0.0, 0.0, 0.0), name="CG", unit="M")


def _add_thrust(root: Element, aircraft: Aircraft) -> None:
    line, propeller = aircraft.thrust_line, aircraft.propeller
    position, direction = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) if line is None else (line.position, line.direction)
    reactions = SubElement(root, "external_reactions")
    if propeller is not None:
        add_text(reactions, "property", "fcs/propeller_speed")
    force = SubElement(reactions, "force", name="thrust", frame="BODY")
    if propeller is not None:
        function = SubElement(force, "function", name="propulsion/thrust-lbs")
        _propeller(function, propeller, propeller.thrust_coefficients, 4, 1.0 / POUND_FORCE)
    _vector(force, "location", (-position[0], position[1], -position[2]), unit="M")
    _vector(force, "direction", direction)
    if propeller is not None and propeller.torque_coefficients:
        moment = SubElement(reactions, "moment", name="propeller", frame="BODY")
        function = SubElement(moment, "function", name="propulsion/torque-lbsft")
        factor = -propeller.rotation / (POUND_FORCE * FOOT)
        _propeller(function, propeller, propeller.torque_coefficients, 5, factor)
        _vector(moment, "direction", direction)
    if propeller is not None and propeller.speed_range is not None:
        _add_engine(root)


def _add_engine(root: Element) -> None:
    """Write an engine without power: JSBSim's trim moves the throttles of its engines, and no other property."""
    engine = SubElement(SubElement(root, "propulsion"), "engine")
    add_text(SubElement(engine, "electric_engine", name="throttle"), "power", 0.0, unit="WATTS")
    thruster = SubElement(engine, "thruster")
    SubElement(thruster, "direct", name="none")
    _vector(thruster, "location", (0.0, 0.0, 0.0), unit="M")


def _propeller(function: Element, propeller: Any, coefficients: Sequence[float], power: int, factor: float) -> None:
    """Write rho D^power (c0 n^2 + c1 n V / D + c2 V^2 / D^2), n in revolutions per second."""
    product = _product(function, factor * propeller.diameter**power * SLUG / FOOT**3, "atmosphere/rho-slugs_ft3")
    total = SubElement(product, "sum")
    for k, c in enumerate(coefficients):
        term = _product(total, c * (FOOT / propeller.diameter) ** k, *["velocities/vt-fps"] * k)
        for _ in range(2 - k):
            if propeller.speed_range is None:
                _product(term, 0.5 / np.pi, "fcs/propeller_speed")
            else:
                idle, full = (speed / (2 * np.pi) for speed in propeller.speed_range)
                speed = SubElement(term, "sum")
                _values(speed, idle)
                _product(speed, full - idle, THROTTLE)


def _add_controls(root: Element, found: BuildUp | GaussianSum, controls: Iterable[str], *, has_throttle: bool) -> None:
    control = SubElement(root, "flight_control", name="surfaces")
    for name in [*([] if has_throttle else [THROTTLE]), *(f"fcs/{name}" for name in controls)]:
        SubElement(control, "property", value="0").text = name
    channel = SubElement(control, "channel", name="surfaces")
    for name, (command, position) in SURFACES.items():
        if name not in found.regressors:
            continue
        largest = float(np.abs(found.limits[:, found.regressors.index(name)]).max())
        total = SubElement(channel, "summer", name=f"fcs/{name}-sum")  # JSBSim trims by the second
        for place in (command, TRIMS[name]):
            add_text(total, "input", place)
        scale = SubElement(channel, "aerosurface_scale", name=f"fcs/{name}-scale")
        add_text(scale, "input", f"fcs/{name}-sum")
        limits = SubElement(scale, "range")
        add_text(limits, "min", -largest)
        add_text(limits, "max", largest)
        add_text(scale, "output", position)


def _rate(regressor: str) -> str | None:
    """Return the rate of which a regressor is the non-dimensional form."""
    name = regressor.removesuffix(HAT)
    return name if regressor.endswith(HAT) and name in RATE_LENGTHS | ACCELERATION_LENGTHS else None


def _source(regressor: str, lengths: tuple[float, float], aircraft: Aircraft, controls: Sequence[str]) -> list:
    """Return the factors whose product is a regressor: numbers and properties."""
    if regressor in controls:
        return [f"fcs/{regressor}"]
    rate = _rate(regressor)
    if (rate or regressor) in IMPLICIT:
        raise ValueError(
            f"Got a model with the regressor {regressor!r}, an acceleration, which follows from the loads: fit one "
            "with regressors='quasi-steady'."
        )
    name, factor = SOURCES[rate or regressor]
    if rate is None:
        return [name, factor] if factor != 1.0 else [name]
    is_span = RATE_LENGTHS[rate] == "span"
    ratio = lengths[0] / aircraft.span if is_span else lengths[1] / aircraft.chord
    return [name, "aero/bi2vel" if is_span else "aero/ci2vel", ratio]


def _add_tables(aerodynamics: Element, found: BuildUp, coefficient: str) -> None:
    function = SubElement(aerodynamics, "function", name=f"aero/coefficient/{coefficient}")
    std = ", ".join(f"{r} {v:.2g}" for r, v in found.derivatives_std.loc[coefficient].items())
    text = f" standard deviations: constant {found.constants_std[coefficient]:.2g}, {std} "
    function.append(ElementTree.Comment(text))
    slopes = found.derivatives.loc[coefficient].to_numpy()
    total = SubElement(function, "sum")
    _values(total, float(found.constants[coefficient] - slopes @ found.reference))
    for regressor, slope in zip(found.regressors, slopes, strict=True):
        _product(total, float(slope), f"aero/regressor/{regressor}")
    for table in found.tables[coefficient]:
        place = SubElement(total, "table", name=f"aero/table/{coefficient}/{'-'.join(table.regressors)}")
        for axis, regressor in zip(("row", "column"), table.regressors, strict=False):
            add_text(place, "independentVar", f"aero/regressor/{regressor}", lookup=axis)
        cells = table.values if table.values.ndim == 2 else table.values[:, None]
        lines = [" ".join(map(number_text, row)) for row in np.column_stack([table.breakpoints[0], cells])]
        if len(table.breakpoints) == 2:
            lines.insert(0, " ".join(map(number_text, table.breakpoints[1])))
        add_text(place, "tableData", "\n" + "\n".join(lines) + "\n")


def _add_waves(aerodynamics: Element, found: GaussianSum, outputs: Sequence[int]) -> None:
    """Write scaled regressors, and the waves of some coefficients."""
    for regressor, shift, scale in zip(found.regressors, found.shift, found.scale, strict=True):
        scaled = _product(SubElement(aerodynamics, "function", name=_scaled(regressor)), 1.0 / scale)
        _values(SubElement(scaled, "difference"), f"aero/regressor/{regressor}", float(shift))
    frequencies, phases, weights = found.waves
    for k in np.flatnonzero(weights[outputs].any(axis=0)):
        cosine = SubElement(SubElement(aerodynamics, "function", name=f"aero/wave-{k}"), "cos")
        _add_plane(SubElement(cosine, "sum"), float(phases[k]), frequencies[k], found.regressors)


def _add_gaussians(aerodynamics: Element, found: GaussianSum, coefficient: str) -> None:
    i = COEFFICIENTS.index(coefficient)
    names = [_scaled(regressor) for regressor in found.regressors]
    parts = []
    for k, block in enumerate(found.blocks[i]):
        square = SubElement(aerodynamics, "function", name=f"aero/square/{coefficient}-{k}")
        total = SubElement(square, "sum")
        for column in np.flatnonzero(block.used):
            _product(total, float(-0.5 * block.curvature[column]), names[column], names[column])
        part = SubElement(aerodynamics, "function", name=f"aero/part/{coefficient}-{k}")
        parts.append(f"aero/part/{coefficient}-{k}")
        total = SubElement(part, "sum")
        for weight, constant, slope in zip(block.weights, block.constants, block.slopes, strict=True):
            term = _product(total, float(weight))
            exponent = SubElement(SubElement(term, "exp"), "sum")
            _values(exponent, f"aero/square/{coefficient}-{k}")
            _add_plane(exponent, float(constant), slope, found.regressors)
    function = SubElement(aerodynamics, "function", name=f"aero/coefficient/{coefficient}")
    total = SubElement(function, "sum")
    _values(total, *parts)
    _add_plane(total, float(found.constants[i]), found.slopes[i], found.regressors)
    for wave in np.flatnonzero(found.waves.weights[i]):
        _product(total, float(found.waves.weights[i, wave]), f"aero/wave-{wave}")


def _add_plane(total: Element, constant: float, slopes: Vector, regressors: Sequence[str]) -> None:
    _values(total, constant)
    for slope, regressor in zip(slopes, regressors, strict=True):
        if slope != 0.0:
            _product(total, float(slope), _scaled(regressor))


def _scaled(regressor: str) -> str:
    return f"aero/scaled/{regressor}"


def _product(parent: Element, *factors: float | str) -> Element:
    product = SubElement(parent, "product")
    _values(product, *factors)
    return product


def _values(parent: Element, *values: float | str) -> None:
    """Append numbers and properties."""
    for value in values:
        add_text(parent, "p" if isinstance(value, str) else "v", value)


def _vector(parent: Element, tag: str, values: Sequence[float], **attributes: str) -> None:
    element = SubElement(parent, tag, attributes)
    for axis, value in zip("xyz", values, strict=True):
        add_text(element, axis, float(value))
