"""Sizes of an aircraft: estimated from mass and span where they are not given, and their errors.

Errors are factors that sizes share; they act on the learned coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, RATE_LENGTHS
from skdgp._flight.tables import check_choice, check_number

MOMENTS = ("Ixx", "Iyy", "Izz")
PRODUCT = "Ixz"
# A measured force coefficient is m f / (qbar S), a moment coefficient I omega_dot / (qbar S b) but
# for products of inertia and gyroscopic moments: powers of the quantities in each
FORCE_POWERS = {"mass": 1.0, "wing_area": -1.0}
POWERS = {
    **dict.fromkeys(COEFFICIENTS[:3], FORCE_POWERS),
    "Cl": {"Ixx": 1.0, "span": -1.0, "wing_area": -1.0},
    "Cm": {"Iyy": 1.0, "chord": -1.0, "wing_area": -1.0},
    "Cn": {"Izz": 1.0, "span": -1.0, "wing_area": -1.0},
}
# Sizes of an aircraft and their units
QUANTITIES = {"mass": "kg", "wing_area": "m^2", "span": "m", "chord": "m"}
# Errors of the moments of inertia
INERTIAS = dict(zip(("roll inertia", "pitch inertia", "yaw inertia"), MOMENTS, strict=True))


@dataclass(frozen=True)
class ScaleFactor:
    """An error that several quantities of an aircraft share.

    Parameters
    ----------
    std : float
        Relative standard deviation.
    powers : mapping of str to float
        Powers of the factor in each quantity: mass, wing_area, span, chord, Ixx, Iyy, Izz, and full
        throws of controls. An error of 1 % of the aspect ratio b^2 / S is one of
        -1 % of ``wing_area`` and, as c = S / b, of -1 % of ``chord``. The product Ixz has no size
        to be relative to: its errors are of sqrt(Ixx Izz).
    source : str
        Source of the estimate.
    added : mapping of str to float
        Of a learned model, an error that adds to its coefficients, such as an error of the thrust:
        the change by an error of 100 %, of coefficients and their slopes by regressors, "CX",
        "CX_alpha", ...
    is_estimate : bool
        Whether the quantities follow from usual ratios of a kind of aircraft, not from a measurement.
    """

    std: float
    powers: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    added: Mapping[str, float] = field(default_factory=dict)
    is_estimate: bool = False

    def __post_init__(self):
        std = check_number("std of a scale factor", self.std, is_open=False)
        vars(self).update(std=std, powers=_floats(self.powers), added=_floats(self.added))


def _floats(values: Mapping) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def errors_of_sizes(
    deviations: Mapping[str, ScaleFactor],
    inertia: Array,
    regressors: tuple[str, ...],
    values: Array,
) -> Array:
    """Return errors of coefficients and slopes, ``values`` (6, 1 + regressors), by each factor, (factors, ...).

    A relative error scales them. Slopes are by the non-dimensional rates, p b / 2V, and by controls in the unit
    of the log, so that a full throw which is wrong by 1 % makes the effect of the control wrong by -1 %. One of
    Ixz by e sqrt(Ixx Izz) leaves N / Izz in the moment L, and L / Ixx in N: dCl = -e sqrt(Ixx / Izz) Cn and
    dCn = -e sqrt(Izz / Ixx) Cl, from L = Ixx p_dot - Ixz r_dot + ... One of the thrust is ``added``.
    """
    # powers in the slopes by p b / 2V and p_dot (b / 2V)^2, those by controls have -1
    of_regressors = {name: {length: -1.0} for name, length in RATE_LENGTHS.items()}
    of_regressors |= {name: {length: -2.0} for name, length in ACCELERATION_LENGTHS.items()}
    ratio = np.sqrt(inertia[0, 0] / inertia[2, 2])
    endings = ["", *(f"_{name}" for name in regressors)]
    errors = []
    for factor in deviations.values():
        of_coefficients = [_power(POWERS[name], factor) for name in COEFFICIENTS]
        of_slopes = [_power(of_regressors.get(name, {name: -1.0}), factor) for name in regressors]
        error = values * np.add.outer(of_coefficients, [0.0, *of_slopes])
        product = factor.powers.get(PRODUCT, 0.0)
        error[3] -= product * ratio * values[5]
        error[5] -= product / ratio * values[3]
        for row, name in zip(error, COEFFICIENTS, strict=True):
            row += [factor.added.get(name + ending, 0.0) for ending in endings]
        errors.append(factor.std * error)
    return np.array(errors)


def _power(powers: Mapping[str, float], factor: ScaleFactor) -> float:
    """Return the power of a factor in a product of powers of quantities."""
    return sum(power * factor.powers.get(name, 0.0) for name, power in powers.items())


# Usual ratios of kinds of aircraft, each with its relative standard deviation: aspect ratio b^2 / S, length over span,
# radii of gyration over half of span, length and their mean (with the deviations of the moments that they give), and
# mean aerodynamic chord over the mean one, S / b, where they differ.
# Radii: Raymer, Aircraft Design, table 16.1, equations 16.52 to 16.54. Their deviations, and those
# of length and aspect ratio, of the conventional kind: published moments of five aircraft
# (tests/dynamics/test_estimate.py). Radii of the flying wing in pitch: the Zagi (Beard &
# McLain 2012, table E.1) and the Skywalker X8 (Gryte 2018), as the B-49's gives them a sixth
# of their moment. Deltas: radii of four published aircraft and planforms of ten (the same file), as
# Raymer's of jet fighters give Izz > Ixx + Iyy. Deviations of moments as of the conventional kind:
# the four have smaller ones, but are crewed. Ratio of the chord between F-16 (1.13), ADMIRE (1.16),
# F-106 (1.31) and a triangle (4/3). Sizes of other kinds and their deviations: guesses, wider for
# gliders.
KINDS: dict[str, dict[str, tuple[float, float]]] = {
    "conventional": {
        "aspect ratio": (7.5, 0.35),
        "length": (0.77, 0.15),
        "roll inertia": (0.25, 0.45),
        "pitch inertia": (0.38, 0.25),
        "yaw inertia": (0.39, 0.35),
    },
    "flying wing": {
        "aspect ratio": (6.5, 0.2),
        "length": (0.4, 0.2),
        "roll inertia": (0.32, 0.5),
        "pitch inertia": (0.55, 0.5),
        "yaw inertia": (0.51, 0.5),
    },
    "delta": {
        "aspect ratio": (2.2, 0.2),
        "mean aerodynamic chord": (1.25, 0.15),
        "length": (1.55, 0.2),
        "roll inertia": (0.26, 0.45),
        "pitch inertia": (0.375, 0.25),
        "yaw inertia": (0.48, 0.35),
    },
    "motor glider": {
        "aspect ratio": (16.0, 0.25),
        "length": (0.5, 0.2),
        "roll inertia": (0.25, 0.6),
        "pitch inertia": (0.38, 0.6),
        "yaw inertia": (0.39, 0.6),
    },
    "twin": {
        "aspect ratio": (8.0, 0.3),
        "length": (0.75, 0.15),
        "roll inertia": (0.34, 0.45),
        "pitch inertia": (0.29, 0.3),
        "yaw inertia": (0.44, 0.35),
    },
}
# Root mean square of Ixz / sqrt(Ixx Izz) of eight published aircraft: Aerosonde 0.100, Ultra Stick
# 25e 0.134, Zagi 0.011, Cessna 172 0, Draken 0.075, F-16 0.040, F-4 0.037, ADMIRE 0.054
# (tests/dynamics/test_estimate.py).
PRODUCT_STD = 0.07


# Usual ratios that a given size takes the place of
REPLACED = {
    "chord": ("aspect ratio", "mean aerodynamic chord"),
    "wing area": ("aspect ratio",),
    "length": ("length",),
    "inertia": ("length", *INERTIAS),
}


def estimated(kind: str, inertia: Any, **sizes: Any) -> dict[str, Any]:
    """Return mass, inertia, wing_area, span, chord and deviations of an aircraft, as of `Aircraft.estimate`.

    ``sizes`` are mass, span, wing_area, chord, length, None where not given.
    """
    check_choice("kind", kind, KINDS)
    given = {}
    for name, value in sizes.items():
        if value is not None:
            given[name.replace("_", " ")] = value_and_std(name, value)
    factors = dict(KINDS[kind])
    for name in (*given, *(["inertia"] if inertia is not None else [])):
        for ratio in REPLACED.get(name, ()):
            factors.pop(ratio, None)
    # all sizes are products of these factors, moments of inertia of squared radii of gyration
    factors |= given
    values = {name: value**2 if name in INERTIAS else value for name, (value, _) in factors.items()}
    source = f"usual of {kind} aircraft"
    deviations = {}
    for name, (_, std) in factors.items():
        is_estimate = name not in given
        powers = _powers(values, name, "length" in given)
        if std > 0 and powers:
            deviations[name] = ScaleFactor(
                std, powers, source if is_estimate else "given", is_estimate=is_estimate
            )
    derived = _sizes(values, "length" in given)
    if inertia is None:
        inertia = np.diag([derived.pop(moment) for moment in MOMENTS])
        deviations["product of inertia"] = ScaleFactor(
            PRODUCT_STD, {PRODUCT: 1.0}, source, is_estimate=True
        )
    return derived | {"inertia": inertia, "deviations": deviations}


def _powers(values: Mapping[str, Any], name: str, is_length_given: bool) -> dict[str, float]:
    """Return the powers of a factor in each size, d log(size) / d log(factor), by a complex step.

    A complex step has no error of cancellation, so it can be tiny.
    """
    step = 1e-20
    stepped = {**values, name: values[name] * (1.0 + step * 1j)}
    powers = {}
    for size, value in _sizes(stepped, is_length_given).items():
        power = float(np.imag(value) / np.real(value)) / step
        if power:
            powers[size] = round(power, 12)
    return powers


def _sizes(values: Mapping[str, Any], is_length_given: bool) -> dict[str, Any]:
    """Return the sizes of an aircraft by values of its factors; moments of inertia if they have radii of gyration."""
    b = values["span"]
    if "wing area" in values:
        S = values["wing area"]
    elif "aspect ratio" in values:
        S = b**2 / values["aspect ratio"]
    else:
        S = b * values["chord"]
    ratio = values.get("mean aerodynamic chord", 1.0)
    c = values["chord"] if "chord" in values else ratio * S / b
    sizes = {"mass": values["mass"], "wing_area": S, "span": b, "chord": c}
    if "roll inertia" in values:
        l = values["length"] if is_length_given else values["length"] * b
        # Raymer, equations 16.52 to 16.54; the factors are the squared radii of gyration
        sizes["Ixx"] = values["mass"] * (0.5 * b) ** 2 * values["roll inertia"]
        sizes["Iyy"] = values["mass"] * (0.5 * l) ** 2 * values["pitch inertia"]
        sizes["Izz"] = values["mass"] * (0.25 * (b + l)) ** 2 * values["yaw inertia"]
    return sizes


def value_and_std(name: str, value: Any) -> tuple[float, float]:
    """Return a positive number and its relative standard deviation, of a number or a pair (value, deviation)."""
    std = 0.0
    if np.shape(value) == (2,):
        value, std = value
    if np.ndim(value):
        raise ValueError(
            f"Got {name}={value!r}, but expected a number, or a pair of it and its standard deviation."
        )
    number = check_number(name, value, unit=QUANTITIES.get(name, "m"))
    std = check_number(f"standard deviation of {name}", std, is_open=False)
    return number, std / number
