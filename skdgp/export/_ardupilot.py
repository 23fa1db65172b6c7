"""ArduPilot SITL and Gazebo: the constant derivatives that their aircraft know."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from skdgp._compute.files import text_writer, write_atomically
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.export._build_up import BuildUp
from skdgp.export._text import element, file_name, write_xml

STALL, BLENDING = 0.3, 50.0  # least angle of stall [rad], beyond the flights; sharpness of the change to a flat plate
EFFICIENCY = (0.2, 3.0)  # range of Oswald's factor
SIGNS = {"elevator": -1.0, "aileron": 1.0, "rudder": -1.0}  # ArduPilot: positive raises the nose, rolls and yaws right
LATERAL = {"b": "beta", "p": "p_hat", "r": "r_hat", "deltaa": "aileron", "deltar": "rudder"}
PITCH = {"a": "alpha", "q": "q_hat", "deltae": "elevator"}
TERMS = {"y": (1, LATERAL), "l": (3, LATERAL), "n": (5, LATERAL), "m": (4, PITCH)}
"""By the letter of a coefficient in SITL's file: its column, and the regressor of each derivative."""
GAZEBO = {"CY": "CY", "Cl": "Cell", "Cm": "Cem", "Cn": "Cen", "CL": "CL", "CD": "CD"}
CONSTANT = ("CL", "CD", "Cm")
LINK = "base_link"


def write_ardupilot(path: str | os.PathLike, build: BuildUp) -> pd.DataFrame:
    """Write the JSON file of a plane of ArduPilot's simulator (SITL), and return what it loses.

    The plane of SITL has a lift that is linear in alpha, elevator and q, a drag that is constant plus quadratic in
    lift, and constant derivatives of the other coefficients. They are fitted to the build-up at its samples by least
    squares. Controls of SITL are from -1 to 1; here 1 is the largest deflection of the flights, and positive raises the
    nose, rolls right and yaws right. ``sim_vehicle.py -v ArduPlane -f plane:uav.json`` flies it. Mass and thrust are
    those of SITL (2 kg), which cannot be set by this file: change them in ``SIM_Plane.cpp``.

    The result (6, 3) has "loss", "deviation" (of the posterior) and "spread" of CX ... Cn, root mean square over the
    samples; SITL ignores it in the file, as "mass" and "inertia". Raises ValueError if the build-up lacks alpha.
    """
    X, C = _flown(build)
    values, fitted = _plane(build, X, C)
    loss = _loss(build, C, fitted)
    values |= {"CGOffset": [0.0, 0.0, 0.0], "mass": build.aircraft.mass, "inertia": build.aircraft.inertia.tolist()}
    values |= {"loss": loss.to_dict("index")}
    write_atomically(path, text_writer(json.dumps(values, indent=1) + "\n"))
    return loss


def write_gazebo(path: str | os.PathLike, build: BuildUp) -> pd.DataFrame:
    """Write a block of Gazebo's AdvancedLiftDrag system with mass and inertia, and return what it loses.

    The system has constant derivatives of lift, drag, side force and moments by alpha, beta, rates and surfaces, and a
    drag that is quadratic in lift. They are fitted to the build-up at its samples by least squares. CY, Cl and Cn have
    no constants there. Derivatives by surfaces are per degree, and the signs of this package: elevator > 0 pitches
    down, aileron > 0 rolls right, rudder > 0 yaws left.

    The SDF file at ``path`` has one model: the link "base_link" with its inertial, and the plugin. Add joints named
    after the surfaces. Result and errors are those of :func:`write_ardupilot`.
    """
    X, C = _flown(build)
    plugin, fitted = _advanced_lift_drag(build, X, C)
    loss = _loss(build, C, fitted)
    turned = np.diag([1.0, -1.0, -1.0]) @ build.aircraft.inertia @ np.diag([1.0, -1.0, -1.0])  # x forward, y left, z up
    inertia = (element(f"i{'xyz'[k]}{'xyz'[m]}", turned[k, m]) for k in range(3) for m in range(k, 3))
    inertial = element("inertial", element("mass", build.aircraft.mass), element("inertia", *inertia))
    comment = ElementTree.Comment(" root mean square loss of this reduction:\n" + loss.to_string() + "\n")
    parts = comment, element("link", inertial, name=LINK), plugin
    sdf = element("sdf", element("model", *parts, name=file_name(build.aircraft.name)), version="1.9")
    ElementTree.indent(sdf)
    write_xml(path, sdf)
    return loss


def _flown(build: BuildUp) -> tuple[Matrix, Matrix]:
    """Return samples and the coefficients at them."""
    if "alpha" not in build.regressors:
        raise ValueError(f"Got a model of {build.regressors}, but expected alpha among its regressors.")
    return build.samples, build.evaluate(build.samples)


def _loss(build: BuildUp, C: Matrix, fitted: Matrix) -> pd.DataFrame:
    loss, deviation = np.sqrt(np.mean((fitted - C) ** 2, axis=0)), build.loss["deviation"].to_numpy()
    return pd.DataFrame({"loss": loss, "deviation": deviation, "spread": C.std(axis=0)}, index=list(COEFFICIENTS))


def _terms(build: BuildUp, X: Matrix, names: Iterable[str]) -> Matrix:
    """Return columns of regressors, zero where the model lacks one."""
    found = dict(zip(build.regressors, X.T, strict=True))
    return np.stack([found.get(name, np.zeros(len(X))) for name in names], axis=-1)


def _linear(columns: Matrix, y: Array) -> tuple[Array, Array]:
    """Return constant and slopes of a least-squares plane, and its values."""
    A = np.column_stack([np.ones(len(columns)), columns])
    weights = np.linalg.lstsq(A, y, rcond=None)[0]
    return np.asarray(weights, dtype=float), np.asarray(A @ weights, dtype=float)


def _turned(alpha: Vector, x: Array, z: Array) -> tuple[Array, Array]:
    """Return lift and drag of CX and CZ, or CX and CZ of lift and drag: the map is its own inverse."""
    s, c = np.sin(alpha), np.cos(alpha)
    return x * s - z * c, -x * c - z * s


def _plane(build: BuildUp, X: Matrix, C: Matrix) -> tuple[dict[str, Any], Matrix]:
    """Return the entries of SITL's file, and the coefficients (n, 6) of its plane."""
    aircraft, fitted = build.aircraft, np.empty_like(C)
    deflections = dict(zip(build.regressors, np.abs(build.limits).max(axis=0), strict=True))
    largest = {name: float(deflections.get(name, 0.0)) for name in SIGNS}  # [rad]
    alpha = _terms(build, X, ["alpha"])[:, 0]
    lift, drag = _turned(alpha, C[:, 0], C[:, 2])
    aspect = aircraft.span**2 / aircraft.wing_area
    longitudinal = _terms(build, X, ["alpha", "q_hat", "elevator"])
    cl, lift_fit = _linear(longitudinal, lift)
    polar = cl[0] + cl[1] * alpha

    def drag_of(weights: Vector) -> Array:
        return weights[0] + polar**2 / (np.pi * aspect * weights[1]) + weights[2] * longitudinal[:, 1]

    bounds = ([-1.0, EFFICIENCY[0], -1e3], [1.0, EFFICIENCY[1], 1e3])
    cd = least_squares(lambda weights: drag_of(weights) - drag, [max(drag.min(), 0.0), 0.9, 0.0], bounds=bounds).x
    fitted[:, 0], fitted[:, 2] = _turned(alpha, lift_fit, drag_of(cd))
    values: dict[str, Any] = {"s": aircraft.wing_area, "b": aircraft.span, "c": aircraft.chord}
    values |= {"c_lift_0": cl[0], "c_lift_a": cl[1], "c_lift_q": cl[2]}
    values |= {"c_lift_deltae": cl[3] * SIGNS["elevator"] * largest["elevator"]}
    values |= {"mcoeff": BLENDING, "alpha_stall": max(STALL, 1.5 * float(alpha.max())), "oswald": cd[1]}
    values |= {"c_drag_p": cd[0], "c_drag_q": cd[2], "c_drag_deltae": 0.0}
    for letter, (i, terms) in TERMS.items():
        weights, fitted[:, i] = _linear(_terms(build, X, terms.values()), C[:, i])
        units = [SIGNS.get(name, 1.0) * largest.get(name, 1.0) for name in terms.values()]
        names = [f"c_{letter}_{key}" for key in ("0", *terms)]
        values |= dict(zip(names, [weights[0], *(weights[1:] * units)], strict=True))
    values |= {"deltaa_max": largest["aileron"], "deltae_max": largest["elevator"], "deltar_max": largest["rudder"]}
    return {key: float(value) for key, value in values.items()}, fitted


def _advanced_lift_drag(build: BuildUp, X: Matrix, C: Matrix) -> tuple[Element, Matrix]:
    """Return the plugin, and the coefficients (n, 6) of the system within stall."""
    aircraft, alpha = build.aircraft, _terms(build, X, ["alpha"])[:, 0]
    surfaces = [name for name in SIGNS if name in build.regressors]
    lift, drag = _turned(alpha, C[:, 0], C[:, 2])
    columns = _terms(build, X, ["alpha", "beta", "p_hat", "q_hat", "r_hat", *surfaces])
    with_constant = np.column_stack([np.ones(len(X)), columns])
    weights, values = {}, {}
    for name, y in {"CY": C[:, 1], "CL": lift, "Cl": C[:, 3], "Cm": C[:, 4], "Cn": C[:, 5]}.items():
        basis = with_constant if name in CONSTANT else columns  # the system has no constant of the others
        found = np.linalg.lstsq(basis, y, rcond=None)[0]
        values[name], weights[name] = basis @ found, found if name in CONSTANT else np.append(0.0, found)
    aspect = aircraft.span**2 / aircraft.wing_area
    steady = np.delete(with_constant, slice(3, 6), axis=1) @ np.delete(weights["CL"], slice(3, 6))
    polar = steady**2 / (np.pi * aspect)
    basis = np.column_stack([np.ones(len(X)), columns[:, 2:]])
    slope = np.linalg.lstsq(np.column_stack([polar, basis]), drag, rcond=None)[0][0]
    efficiency = float(np.clip(1.0 / slope if slope > 0 else EFFICIENCY[1], *EFFICIENCY))
    rest = np.linalg.lstsq(basis, drag - polar / efficiency, rcond=None)[0]
    weights["CD"] = np.concatenate([rest[:1], [0.0, 0.0], rest[1:]])
    fitted = np.empty_like(C)
    fitted[:, 0], fitted[:, 2] = _turned(alpha, values["CL"], polar / efficiency + basis @ rest)
    for name, i in (("CY", 1), ("Cl", 3), ("Cm", 4), ("Cn", 5)):
        fitted[:, i] = values[name]
    parts: list[Element] = []
    for name, key in GAZEBO.items():
        if name in CONSTANT:
            parts.append(element(f"{key}0", weights[name][0]))
        if name != "CD":
            parts += [element(f"{key}a", weights[name][1]), element(f"{key}b", weights[name][2])]
        parts += [element(f"{key}{rate}", value) for rate, value in zip("pqr", weights[name][3:6], strict=True)]
    settings: dict[str, Any] = {"AR": aspect, "mac": aircraft.chord, "eff": efficiency, "area": aircraft.wing_area}
    settings |= {"alpha_stall": max(STALL, 1.5 * float(alpha.max())), "Cema_stall": weights["Cm"][1]}
    settings |= {"forward": "1 0 0", "upward": "0 0 1", "cp": "0 0 0", "link_name": LINK}
    settings |= {"num_ctrl_surfaces": str(len(surfaces))}
    parts += [element(tag, value) for tag, value in settings.items()]
    for k, surface in enumerate(surfaces):
        slopes = (element(f"{key}_ctrl", weights[name][6 + k] * np.pi / 180.0) for name, key in GAZEBO.items())
        parts.append(element("control_surface", element("name", surface), element("direction", "1"), *slopes))
    files = {"filename": "gz-sim-advanced-lift-drag-system", "name": "gz::sim::systems::AdvancedLiftDrag"}
    return element("plugin", *parts, **files), fitted
