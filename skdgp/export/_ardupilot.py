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
from skdgp.dynamics import Aircraft
from skdgp.export._build_up import Posterior
from skdgp.export._text import element, file_name, write_xml

STALL, BLENDING = (
    0.3,
    50.0,
)  # least angle of stall [rad], beyond the flights; sharpness of the change to a flat plate
EFFICIENCY = (0.2, 3.0)  # range of Oswald's factor
SIGNS = {
    "elevator": -1.0,
    "aileron": 1.0,
    "rudder": -1.0,
}  # ArduPilot: positive raises the nose, rolls and yaws right
LATERAL = {"b": "beta", "p": "p_hat", "r": "r_hat", "deltaa": "aileron", "deltar": "rudder"}
PITCH = {"a": "alpha", "q": "q_hat", "deltae": "elevator"}
TERMS = {"y": (1, LATERAL), "l": (3, LATERAL), "n": (5, LATERAL), "m": (4, PITCH)}
"""By the letter of a coefficient in SITL's file: its column, and the regressor of each derivative.
"""
GAZEBO = {"CY": "CY", "Cl": "Cell", "Cm": "Cem", "Cn": "Cen", "CL": "CL", "CD": "CD"}
CONSTANT = ("CL", "CD", "Cm")
LINK = "base_link"


def write_ardupilot(
    path: str | os.PathLike, model: Any, aircraft: Aircraft, *, X: Any = None
) -> pd.DataFrame:
    """Write the JSON file of a plane of ArduPilot's simulator (SITL), and return what it loses.

    The plane of SITL has a lift that is linear in alpha, elevator and q, a drag that is constant
    plus quadratic in lift, and constant derivatives of the other coefficients, fitted to the model
    by least squares. Controls of SITL are from -1 to 1; here 1 is the largest deflection of the
    flights, and positive raises the nose, rolls right and yaws right. ``sim_vehicle.py -v ArduPlane
    -f plane:uav.json`` flies it. Mass and thrust are those of SITL (2 kg), which cannot be set by
    this file: change them in ``SIM_Plane.cpp``. Raises ValueError if the model lacks alpha, or is
    compact and X is not given; TypeError if it is another estimator.

    Parameters
    ----------
    path : path-like
    model : DependentGPRegressor or Pipeline
    aircraft : Aircraft
    X : array or DataFrame (n, ...), optional
        Input of the model to fit at; default: its training samples, which a compact model lacks.

    Returns
    -------
    DataFrame (6, 3)
        "loss", "deviation" (of the posterior) and "spread" of CX ... Cn, root mean squares over the
        samples; SITL ignores them in the file, as "mass" and "inertia".
    """
    flown = _Flown(model, aircraft, X)
    values, fitted = _plane(flown)
    loss = flown.loss(fitted)
    values |= {
        "CGOffset": [0.0, 0.0, 0.0],
        "mass": aircraft.mass,
        "inertia": aircraft.inertia.tolist(),
    }
    values |= {"loss": loss.to_dict("index")}
    write_atomically(path, text_writer(json.dumps(values, indent=1) + "\n"))
    return loss


def write_gazebo(
    path: str | os.PathLike, model: Any, aircraft: Aircraft, *, X: Any = None
) -> pd.DataFrame:
    """Write a block of Gazebo's AdvancedLiftDrag system with mass and inertia, and return what it loses.

    The system has constant derivatives of lift, drag, side force and moments by alpha, beta, rates
    and surfaces, and a drag that is quadratic in lift; CY, Cl and Cn have no constants. They are
    fitted as by :func:`write_ardupilot`, with the same result and errors. Derivatives by surfaces
    are per degree, and the signs of this package: elevator > 0 pitches down, aileron > 0 rolls
    right, rudder > 0 yaws left.

    The SDF file at ``path`` has one model: the link "base_link" with its inertial, and the plugin.
    Add joints named after the surfaces.

    Parameters
    ----------
    path : path-like
    model : DependentGPRegressor or Pipeline
    aircraft : Aircraft
    X : array or DataFrame (n, ...), optional
        Input of the model to fit at; default: its training samples, which a compact model lacks.

    Returns
    -------
    DataFrame (6, 3)
    """
    flown = _Flown(model, aircraft, X)
    plugin, fitted = _advanced_lift_drag(flown)
    loss = flown.loss(fitted)
    turned = (
        np.diag([1.0, -1.0, -1.0]) @ aircraft.inertia @ np.diag([1.0, -1.0, -1.0])
    )  # x forward, y left, z up
    inertia = (
        element(f"i{'xyz'[k]}{'xyz'[m]}", turned[k, m]) for k in range(3) for m in range(k, 3)
    )
    inertial = element("inertial", element("mass", aircraft.mass), element("inertia", *inertia))
    comment = ElementTree.Comment(
        " root mean square loss of this reduction:\n" + loss.to_string() + "\n"
    )
    parts = comment, element("link", inertial, name=LINK), plugin
    sdf = element("sdf", element("model", *parts, name=file_name(aircraft.name)), version="1.9")
    ElementTree.indent(sdf)
    write_xml(path, sdf)
    return loss


class _Flown:
    """Samples of the flights and the coefficients of the model at them."""

    def __init__(self, model: Any, aircraft: Aircraft, X: Any) -> None:
        posterior = Posterior(model, X)
        if "alpha" not in posterior.names:
            raise ValueError(
                f"Got a model of {tuple(posterior.names)}, but expected alpha among its regressors."
            )
        self.aircraft, self.regressors, self.limits = aircraft, posterior.names, posterior.limits
        self.X, self.C = posterior.tested, posterior.mean(posterior.tested)
        self.deviation = np.sqrt(np.mean(posterior.deviation(self.X) ** 2, axis=0))
        self.alpha = self.terms(["alpha"])[:, 0]
        self.lift, self.drag = _turned(self.alpha, self.C[:, 0], self.C[:, 2])
        self.aspect = aircraft.span**2 / aircraft.wing_area
        self.stall = max(STALL, 1.5 * float(self.alpha.max()))

    def terms(self, names: Iterable[str]) -> Matrix:
        """Return columns of regressors, zero where the model lacks one."""
        found = dict(zip(self.regressors, self.X.T, strict=True))
        return np.stack([found.get(name, np.zeros(len(self.X))) for name in names], axis=-1)

    def loss(self, fitted: Matrix) -> pd.DataFrame:
        """Return how far coefficients (n, 6) are from those of the model."""
        off = np.sqrt(np.mean((fitted - self.C) ** 2, axis=0))
        columns = {"loss": off, "deviation": self.deviation, "spread": self.C.std(axis=0)}
        return pd.DataFrame(columns, index=list(COEFFICIENTS))


def _linear(columns: Matrix, y: Array) -> tuple[Array, Array]:
    """Return constant and slopes of a least-squares plane, and its values."""
    A = np.column_stack([np.ones(len(columns)), columns])
    weights = np.linalg.lstsq(A, y, rcond=None)[0]
    return np.asarray(weights, dtype=float), np.asarray(A @ weights, dtype=float)


def _turned(alpha: Vector, x: Array, z: Array) -> tuple[Array, Array]:
    """Return lift and drag of CX and CZ, or CX and CZ of lift and drag: the map is its own inverse."""
    s, c = np.sin(alpha), np.cos(alpha)
    return x * s - z * c, -x * c - z * s


def _plane(flown: _Flown) -> tuple[dict[str, Any], Matrix]:
    """Return the entries of SITL's file, and the coefficients (n, 6) of its plane."""
    aircraft, drag, fitted = flown.aircraft, flown.drag, np.empty_like(flown.C)
    deflections = dict(zip(flown.regressors, np.abs(flown.limits).max(axis=0), strict=True))
    largest = {name: float(deflections.get(name, 0.0)) for name in SIGNS}  # [rad]
    longitudinal = flown.terms(["alpha", "q_hat", "elevator"])
    cl, lift_fit = _linear(longitudinal, flown.lift)
    polar = cl[0] + cl[1] * flown.alpha

    def drag_of(weights: Vector) -> Array:
        return (
            weights[0]
            + polar**2 / (np.pi * flown.aspect * weights[1])
            + weights[2] * longitudinal[:, 1]
        )

    def errors(weights: Vector) -> Array:
        return drag_of(weights) - drag

    bounds = ([-1.0, EFFICIENCY[0], -1e3], [1.0, EFFICIENCY[1], 1e3])
    cd = least_squares(errors, [max(drag.min(), 0.0), 0.9, 0.0], bounds=bounds).x
    fitted[:, 0], fitted[:, 2] = _turned(flown.alpha, lift_fit, drag_of(cd))
    values: dict[str, Any] = {"s": aircraft.wing_area, "b": aircraft.span, "c": aircraft.chord}
    values |= {"c_lift_0": cl[0], "c_lift_a": cl[1], "c_lift_q": cl[2]}
    values |= {"c_lift_deltae": cl[3] * SIGNS["elevator"] * largest["elevator"]}
    values |= {"mcoeff": BLENDING, "alpha_stall": flown.stall, "oswald": cd[1]}
    values |= {"c_drag_p": cd[0], "c_drag_q": cd[2], "c_drag_deltae": 0.0}
    for letter, (i, terms) in TERMS.items():
        weights, fitted[:, i] = _linear(flown.terms(terms.values()), flown.C[:, i])
        units = [SIGNS.get(name, 1.0) * largest.get(name, 1.0) for name in terms.values()]
        names = [f"c_{letter}_{key}" for key in ("0", *terms)]
        values |= dict(zip(names, [weights[0], *(weights[1:] * units)], strict=True))
    values |= {
        "deltaa_max": largest["aileron"],
        "deltae_max": largest["elevator"],
        "deltar_max": largest["rudder"],
    }
    return {key: float(value) for key, value in values.items()}, fitted


def _advanced_lift_drag(flown: _Flown) -> tuple[Element, Matrix]:
    """Return the plugin, and the coefficients (n, 6) of the system within stall."""
    C, drag, aircraft = flown.C, flown.drag, flown.aircraft
    surfaces = [name for name in SIGNS if name in flown.regressors]
    columns = flown.terms(["alpha", "beta", "p_hat", "q_hat", "r_hat", *surfaces])
    with_constant = np.column_stack([np.ones(len(C)), columns])
    weights, values = {}, {}
    for name, y in {
        "CY": C[:, 1],
        "CL": flown.lift,
        "Cl": C[:, 3],
        "Cm": C[:, 4],
        "Cn": C[:, 5],
    }.items():
        basis = (
            with_constant if name in CONSTANT else columns
        )  # the system has no constant of the others
        found = np.linalg.lstsq(basis, y, rcond=None)[0]
        values[name], weights[name] = (
            basis @ found,
            found if name in CONSTANT else np.append(0.0, found),
        )
    steady = np.delete(with_constant, slice(3, 6), axis=1) @ np.delete(weights["CL"], slice(3, 6))
    polar = steady**2 / (np.pi * flown.aspect)
    basis = np.delete(with_constant, [1, 2], axis=1)
    slope = np.linalg.lstsq(np.column_stack([polar, basis]), drag, rcond=None)[0][0]
    efficiency = float(np.clip(1.0 / slope if slope > 0 else EFFICIENCY[1], *EFFICIENCY))
    rest = np.linalg.lstsq(basis, drag - polar / efficiency, rcond=None)[0]
    weights["CD"] = np.concatenate([rest[:1], [0.0, 0.0], rest[1:]])
    fitted = np.empty_like(C)
    fitted[:, 0], fitted[:, 2] = _turned(
        flown.alpha, values["CL"], polar / efficiency + basis @ rest
    )
    for name, i in (("CY", 1), ("Cl", 3), ("Cm", 4), ("Cn", 5)):
        fitted[:, i] = values[name]
    parts: list[Element] = []
    for name, key in GAZEBO.items():
        if name in CONSTANT:
            parts.append(element(f"{key}0", weights[name][0]))
        if name != "CD":
            parts += [element(f"{key}a", weights[name][1]), element(f"{key}b", weights[name][2])]
        parts += [
            element(f"{key}{rate}", value)
            for rate, value in zip("pqr", weights[name][3:6], strict=True)
        ]
    settings: dict[str, Any] = {"AR": flown.aspect, "mac": aircraft.chord, "eff": efficiency}
    settings |= {
        "area": aircraft.wing_area,
        "alpha_stall": flown.stall,
        "Cema_stall": weights["Cm"][1],
    }
    settings |= {"forward": "1 0 0", "upward": "0 0 1", "cp": "0 0 0", "link_name": LINK}
    settings |= {"num_ctrl_surfaces": str(len(surfaces))}
    parts += [element(tag, value) for tag, value in settings.items()]
    for k, surface in enumerate(surfaces):
        slopes = (
            element(f"{key}_ctrl", weights[name][6 + k] * np.pi / 180.0)
            for name, key in GAZEBO.items()
        )
        parts.append(
            element("control_surface", element("name", surface), element("direction", "1"), *slopes)
        )
    files = {
        "filename": "gz-sim-advanced-lift-drag-system",
        "name": "gz::sim::systems::AdvancedLiftDrag",
    }
    return element("plugin", *parts, **files), fitted
