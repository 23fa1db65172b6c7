"""Sizes of an aircraft estimated from its mass and span, and the errors of coefficients that errors of sizes cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, LENGTHS, RATE_LENGTHS
from skdgp._flight.checks import as_floats, check_choice, check_number

# Sizes of an aircraft and their units
QUANTITIES = {"mass": "kg", "wing_area": "m^2", "span": "m", "chord": "m"}
MOMENTS = ("Ixx", "Iyy", "Izz")
INERTIAS = dict(zip(("roll inertia", "pitch inertia", "yaw inertia"), MOMENTS, strict=True))
PRODUCT = "Ixz"
PRESSURE = "dynamic pressure"
FORCE = {"mass": 1.0, "wing_area": -1.0, PRESSURE: -1.0}
# A measured coefficient is proportional to these powers: m f / (qbar S), and I omega_dot / (qbar S
# b) but for products of inertia and gyroscopic moments
POWERS = dict.fromkeys(COEFFICIENTS[:3], FORCE) | {
    name: {moment: 1.0, "wing_area": -1.0, length: -1.0, PRESSURE: -1.0}
    for name, moment, length in zip(
        COEFFICIENTS[3:], MOMENTS, ("span", "chord", "span"), strict=True
    )
}
# A rate is divided by V, an angular acceleration by V^2: by these powers of the dynamic pressure
SPEED_POWERS = dict.fromkeys(RATE_LENGTHS, 0.5) | dict.fromkeys(ACCELERATION_LENGTHS, 1.0)


@dataclass(frozen=True)
class ScaleFactor:
    """An error that several quantities of an aircraft share.

    Parameters
    ----------
    std : float
        Relative standard deviation.
    powers : mapping of str to float
        Powers of the factor in each quantity: mass, wing_area, span, chord, Ixx, Iyy, Izz, dynamic
        pressure, and full throws of controls. An error of 1 % of the aspect ratio b^2 / S is one of
        -1 % of ``wing_area`` and, as c = S / b, of -1 % of ``chord``. The product Ixz has no size
        to be relative to: its errors are of sqrt(Ixx Izz).
    source : str
        Source of the estimate.
    added : mapping of str to float
        Of an error that adds to coefficients, such as an error of the thrust: the change by an
        error of 100 %, of coefficients and their slopes by regressors of a model, "CX",
        "CX_alpha", ...
    """

    std: float
    powers: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    added: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        std = check_number("std of a scale factor", self.std, is_open=False)
        object.__setattr__(self, "std", std)
        for name in ("powers", "added"):
            numbers = {str(key): float(value) for key, value in getattr(self, name).items()}
            object.__setattr__(self, name, numbers)


class Kind(NamedTuple):
    """A class of aircraft: sizes, radii of gyration, and relative standard deviations of all."""

    aspect_ratio: tuple[float, float]  # b^2 / S
    length: tuple[float, float]  # Overall length over span
    radii: tuple[float, float, float]  # Radii of gyration over half of: span, length, their mean
    inertia_std: tuple[float, float, float]  # Of the moments that these radii give
    words: str
    chord: tuple[float, float] = (1.0, 0.0)  # Mean aerodynamic chord over the mean one, S / b


# Radii: Raymer, Aircraft Design, table 16.1, equations 16.52 to 16.54. Their deviations, and those
# of length and aspect ratio, of the conventional kind: published moments of five aircraft
# (tests/dynamics/test_estimate.py). Radii of the flying wing in pitch: the Zagi (Beard &
# McLain 2012, table E.1) and the Skywalker X8 (Gryte 2018), as the B-49's gives them a sixth
# of their moment. Deltas: radii of four published aircraft and planforms of ten (the same file), as
# Raymer's of jet fighters give Izz > Ixx + Iyy; deviations of moments of the conventional kind, as
# those of the four are less, but of crewed ones; the chord is between those of F-16 (1.13), ADMIRE
# (1.16), F-106 (1.31) and a triangle (4/3). Sizes of other kinds and their deviations: guesses,
# wider for gliders.
KINDS = {
    "conventional": Kind(
        (7.5, 0.35),
        (0.77, 0.15),
        (0.25, 0.38, 0.39),
        (0.45, 0.25, 0.35),
        "of a single propeller, Raymer",
    ),
    "flying wing": Kind(
        (6.5, 0.2),
        (0.4, 0.2),
        (0.32, 0.55, 0.51),
        (0.5, 0.5, 0.5),
        "of a flying wing, Raymer and two UAVs",
    ),
    "delta": Kind(
        (2.2, 0.2),
        (1.55, 0.2),
        (0.26, 0.375, 0.48),
        (0.45, 0.25, 0.35),
        "of four deltas",
        (1.25, 0.15),
    ),
    "motor glider": Kind(
        (16.0, 0.25),
        (0.5, 0.2),
        (0.25, 0.38, 0.39),
        (0.6, 0.6, 0.6),
        "of a single propeller, Raymer",
    ),
    "twin": Kind(
        (8.0, 0.3),
        (0.75, 0.15),
        (0.34, 0.29, 0.44),
        (0.45, 0.3, 0.35),
        "of twin propellers, Raymer",
    ),
}
# Root mean square of Ixz / sqrt(Ixx Izz) of eight published aircraft: Aerosonde 0.100, Ultra Stick
# 25e 0.134, Zagi 0.011, Cessna 172 0, Draken 0.075, F-16 0.040, F-4 0.037, ADMIRE 0.054
# (tests/dynamics/test_estimate.py).
PRODUCT_STD = 0.07
# Measurements of an hour at most, by the scale factor that they narrow
REMEDIES = {
    "mass": "weigh it",
    "span": "measure the span",
    "aspect ratio": "measure the chord of the wing (area = span x mean chord)",
    "wing area": "measure the chord of the wing (area = span x mean chord)",
    "chord": "measure the chord of the wing along the span",
    "mean aerodynamic chord": "measure the chord of the wing along the span",
    "length": "measure the length from nose to tail",
    "airspeed": "fit an airspeed sensor",
    **dict.fromkeys(INERTIAS, "swing it about each axis on two cords (bifilar pendulum)"),
}


def estimated(kind: str, inertia: Any, **sizes: Any) -> dict[str, Any]:
    """Return mass, inertia, wing_area, span, chord and deviations of an aircraft, as of `Aircraft.estimate`.

    ``sizes`` are mass, span, wing_area, aspect_ratio, chord, length, None where not given. The
    powers of a factor x are d log(size) / d log(x), by a complex step.
    """
    check_choice("kind", kind, KINDS)
    rule = KINDS[kind]
    given = {name.replace("_", " "): x for name, x in sizes.items() if x is not None}
    if {"wing area", "aspect ratio"} <= given.keys():
        raise ValueError(
            "Got wing_area and aspect_ratio, but expected one of them: wing_area = span^2 / "
            "aspect_ratio."
        )
    usual = f"usual of {kind} aircraft"
    length = value_and_std("span", sizes["span"])[0] * rule.length[0]
    rules = {
        "aspect ratio": (*rule.aspect_ratio, f"{rule.aspect_ratio[0]:g}, {usual}"),
        "mean aerodynamic chord": (*rule.chord, f"{rule.chord[0]:g} S / b, {usual}"),
        "length": (*rule.length, f"{length:.3g} m, {usual}"),
    }
    for (name, _), std, radius in zip(INERTIAS.items(), rule.inertia_std, rule.radii, strict=True):
        rules[name] = (radius**2, std, f"radius of gyration {radius:g}, {rule.words}")
    if {"wing area", "aspect ratio", "chord"} & given.keys():
        del rules["aspect ratio"]
    if "chord" in given:
        del rules["mean aerodynamic chord"]
    rules |= {name: (*value_and_std(name, x), "given") for name, x in given.items()}
    values = {name: value for name, (value, _, _) in rules.items()}
    if inertia is not None:
        values = {name: x for name, x in values.items() if name not in ("length", *INERTIAS)}
    derived = _sizes(values, "length" in given)
    factors = {}
    for name, value in values.items():
        step = _sizes(values | {name: value * (1.0 + 1e-20j)}, "length" in given)
        powers = {size: float(np.imag(x) / np.real(x)) / 1e-20 for size, x in step.items()}
        powers = {size: round(power, 12) for size, power in powers.items() if power}
        factors[name] = ScaleFactor(rules[name][1], powers, rules[name][2])
    if inertia is None:
        inertia = np.diag([derived[moment] for moment in MOMENTS])
        factors["product of inertia"] = ScaleFactor(PRODUCT_STD, {PRODUCT: 1.0}, f"none, {usual}")
    deviations = {name: factor for name, factor in factors.items() if factor.std > 0}
    sizes = {name: derived[name] for name in QUANTITIES}
    return sizes | {"inertia": inertia, "deviations": deviations}


def _sizes(values: Mapping[str, Any], is_length_given: bool) -> dict[str, Any]:
    """Return the sizes of an aircraft by values of its factors; moments of inertia if they have radii of gyration."""
    m = values["mass"]
    b = values["span"]
    if "wing area" in values:
        S = values["wing area"]
    elif "aspect ratio" in values:
        S = b**2 / values["aspect ratio"]
    else:
        S = b * values["chord"]
    c = values["chord"] if "chord" in values else values["mean aerodynamic chord"] * S / b
    sizes = {"mass": m, "wing_area": S, "span": b, "chord": c}
    if "length" in values:
        l = values["length"] * (1.0 if is_length_given else b)
        arms = (b, l, 0.5 * (b + l))
        for (name, moment), arm in zip(INERTIAS.items(), arms, strict=True):
            # Raymer, equations 16.52 to 16.54; the factor is the squared radius of gyration
            sizes[moment] = m * (0.5 * arm) ** 2 * values[name]
    return sizes


def value_and_std(name: str, value: Any) -> tuple[float, float]:
    """Return a positive number and its relative standard deviation, of a number or a pair (value, deviation)."""
    pair = as_floats(value)
    number, std = pair if pair.shape == (2,) else (pair, 0.0)
    if not (np.shape(number) == () and 0 < number < np.inf and 0 <= std < np.inf):
        unit = f" [{QUANTITIES[name]}]" if name in QUANTITIES else ""
        raise ValueError(
            f"Got {name}={value!r}, but expected a number > 0, finite{unit}, or a pair of it and "
            f"its standard deviation."
        )
    return float(number), float(std / number)


def errors_of_sizes(
    deviations: Mapping[str, ScaleFactor],
    inertia: Array,
    regressors: tuple[str, ...],
    values: Array,
) -> Array:
    """Return errors of coefficients and slopes by each factor, (factors, ..., 6, 1 + regressors), as ``values`` are.

    A relative error scales them (`relative_errors`). One of Ixz by e sqrt(Ixx Izz) leaves N / Izz
    in the moment L, and L / Ixx in N: dCl = -e sqrt(Ixx / Izz) Cn and dCn = -e sqrt(Izz / Ixx) Cl,
    from L = Ixx p_dot - Ixz r_dot + ... One of the thrust is ``added``.
    """
    shape = (len(deviations), *(1,) * (values.ndim - 2), len(COEFFICIENTS), 1 + len(regressors))
    errors = values * relative_errors(deviations, regressors).reshape(shape)
    ratio = np.sqrt(inertia[0, 0] / inertia[2, 2])
    columns = ["", *(f"_{name}" for name in regressors)]
    for error, factor in zip(errors, deviations.values(), strict=True):
        product = factor.std * factor.powers.get(PRODUCT, 0.0)
        error[..., 3, :] -= product * ratio * values[..., 5, :]
        error[..., 5, :] -= product / ratio * values[..., 3, :]
        added = [[factor.added.get(row + name, 0.0) for name in columns] for row in COEFFICIENTS]
        error += factor.std * np.array(added)
    return errors


def relative_errors(deviations: Mapping[str, ScaleFactor], regressors: tuple[str, ...]) -> Array:
    """Return relative errors of the coefficients and of their slopes, (factors, 6, 1 + regressors).

    Slopes are by the non-dimensional rates, p b / 2V, and by controls in the unit of the log, so
    that a full throw which is wrong by 1 % makes the effect of the control wrong by -1 %.
    """
    rows = [POWERS[name] for name in COEFFICIENTS]
    columns: list[dict[str, float]] = [{}]
    for name in regressors:
        columns.append({PRESSURE: SPEED_POWERS.get(name, 0.0), LENGTHS.get(name, name): -1.0})
    errors = np.zeros((len(deviations), len(rows), len(columns)))
    for error, factor in zip(errors, deviations.values(), strict=True):
        by_row, by_column = (
            [
                sum(p * factor.powers.get(name, 0.0) for name, p in powers.items())
                for powers in table
            ]
            for table in (rows, columns)
        )
        error[:] = factor.std * np.add.outer(by_row, by_column)
    return errors
