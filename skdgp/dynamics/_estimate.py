"""What is assumed of an aircraft of which mass and span are known, and how errors of it scale the coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, LENGTHS, RATE_LENGTHS
from skdgp._flight.checks import check_choice
from skdgp.dynamics._engines import as_floats

QUANTITIES = {"mass": "kg", "wing_area": "m^2", "span": "m", "chord": "m"}
"""Sizes of an aircraft and their units."""
MOMENTS = ("Ixx", "Iyy", "Izz")
INERTIAS = dict(zip(("roll inertia", "pitch inertia", "yaw inertia"), MOMENTS, strict=True))
PRODUCT = "Ixz"
PRESSURE = "dynamic pressure"
FORCE = {"mass": 1.0, "wing_area": -1.0, PRESSURE: -1.0}
POWERS = dict.fromkeys(COEFFICIENTS[:3], FORCE) | {
    name: {moment: 1.0, "wing_area": -1.0, length: -1.0, PRESSURE: -1.0}
    for name, moment, length in zip(
        COEFFICIENTS[3:], MOMENTS, ("span", "chord", "span"), strict=True
    )
}
"""A measured coefficient is proportional to these powers: m f / (qbar S), and I omega_dot / (qbar S b) but for products
of inertia and gyroscopic moments."""
SPEED_POWERS = dict.fromkeys(RATE_LENGTHS, 0.5) | dict.fromkeys(ACCELERATION_LENGTHS, 1.0)
"""A rate is divided by V, an angular acceleration by V^2: by these powers of the dynamic pressure.
"""


@dataclass(frozen=True)
class ScaleFactor:
    """An error that several quantities of an aircraft share.

    Parameters
    ----------
    std : float
        Relative standard deviation.
    powers : mapping of str to float
        Powers with which quantities follow it: mass, wing_area, span, chord, Ixx, Iyy, Izz, dynamic
        pressure, and full throws of controls. An error of 1 % of the aspect ratio b^2 / S is one of
        -1 % of ``wing_area`` and, as c = S / b, of -1 % of ``chord``. The product Ixz has no size
        to be relative to: its errors are of sqrt(Ixx Izz).
    source : str
        What it was estimated from.
    added : mapping of str to float
        Of an error that adds to coefficients, as that of the thrust does: what one of 100 % adds to
        them and to their slopes by regressors of a model, "CX", "CX_alpha", ...
    """

    std: float
    powers: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    added: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        std = as_floats(self.std)
        if std.shape != () or not 0 <= std < np.inf:
            raise ValueError(
                f"Got std={self.std!r} of a scale factor, but expected a relative deviation, 0 or "
                f"more."
            )
        object.__setattr__(self, "std", float(std))
        for name in ("powers", "added"):
            object.__setattr__(
                self, name, {str(key): float(value) for key, value in getattr(self, name).items()}
            )


class Kind(NamedTuple):
    """A class of aircraft: sizes, radii of gyration, and relative standard deviations of all."""

    aspect_ratio: tuple[float, float]
    """b^2 / S."""
    length: tuple[float, float]
    """Overall length over span."""
    radii: tuple[float, float, float]
    """Radii of gyration over half of: span, length, their mean."""
    inertia_std: tuple[float, float, float]
    """Of the moments that these radii give."""
    words: str
    chord: tuple[float, float] = (1.0, 0.0)
    """Mean aerodynamic chord over the mean one, S / b."""


# Radii: Raymer, Aircraft Design, table 16.1, equations 16.52 to 16.54. Their deviations, and those
# of length and aspect ratio, of the conventional kind: published moments of five aircraft
# (tests/dynamics/test_estimate.py). Radii of the flying wing in pitch: those of the Zagi (Beard &
# McLain 2012, table E.1) and the Skywalker X8 (Gryte 2018), as that of the B-49 gives them a sixth
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
PRODUCT_STD = 0.07
"""Root mean square of Ixz / sqrt(Ixx Izz) of eight published aircraft: Aerosonde .100, Ultra Stick 25e .134, Zagi .011,
Cessna 172 0, Draken .075, F-16 .040, F-4 .037, ADMIRE .054 (tests/dynamics/test_estimate.py)."""
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
"""Measurements of an hour at most, by the scale factor that they narrow."""


def estimated(
    mass: Any,
    span: Any,
    kind: str,
    inertia: Any,
    wing_area: Any,
    aspect_ratio: Any,
    chord: Any,
    length: Any,
) -> dict[str, Any]:
    """Return mass, inertia, wing_area, span, chord and deviations of an aircraft, as of `Aircraft.estimate`."""
    check_choice("kind", kind, KINDS)
    if wing_area is not None and aspect_ratio is not None:
        raise ValueError(
            "Got wing_area and aspect_ratio, but expected one of them: wing_area = span^2 / "
            "aspect_ratio."
        )
    rule, usual = KINDS[kind], f"usual of {kind} aircraft"
    m, mass_std = value_and_std("mass", mass)
    b, span_std = value_and_std("span", span)
    of_mass, of_span, factors = {"mass": 1.0}, {"span": 1.0}, {}
    c, chord_std = (None, 0.0) if chord is None else value_and_std("chord", chord)
    if wing_area is not None:
        area, std = value_and_std("wing_area", wing_area)
        factors["wing area"] = ScaleFactor(
            std, {"wing_area": 1.0} | ({"chord": 1.0} if c is None else {}), "told"
        )
        of_span |= {"chord": -1.0} if c is None else {}
    elif aspect_ratio is None and c is not None:
        area = b * c
        of_span |= {"wing_area": 1.0}
    else:
        ratio, std = (
            rule.aspect_ratio
            if aspect_ratio is None
            else value_and_std("aspect_ratio", aspect_ratio)
        )
        area = b**2 / ratio
        powers = {"wing_area": -1.0} | ({"chord": -1.0} if c is None else {})
        factors["aspect ratio"] = ScaleFactor(
            std, powers, f"{ratio:g}, {usual if aspect_ratio is None else 'told'}"
        )
        of_span |= {"wing_area": 2.0} | ({"chord": 1.0} if c is None else {})
    if c is None:
        share, std = rule.chord
        factors["mean aerodynamic chord"] = ScaleFactor(
            std, {"chord": 1.0}, f"{share:g} S / b, {usual}"
        )
        c = share * area / b
    else:
        by_chord = {"chord": 1.0} | (
            {"wing_area": 1.0} if wing_area is None and aspect_ratio is None else {}
        )
        factors["chord"] = ScaleFactor(chord_std, by_chord, "told")
    values: dict[str, Any] = {"mass": m, "span": b, "wing_area": area, "chord": c}
    if inertia is None:
        l, length_std = (
            (rule.length[0] * b, rule.length[1])
            if length is None
            else value_and_std("length", length)
        )
        share = l / (b + l)
        arms = np.array([b, l, 0.5 * (b + l)])
        moments = m * (0.5 * np.array(rule.radii) * arms) ** 2  # Raymer, equations 16.52 to 16.54
        values["inertia"] = np.diag(moments)
        of_mass |= dict.fromkeys(MOMENTS, 1.0)
        of_span |= {"Ixx": 2.0, "Izz": 2.0 * (1.0 if length is None else 1 - share)}
        of_span |= {"Iyy": 2.0} if length is None else {}
        source = f"{l:.3g} m, {usual}" if length is None else "told"
        factors["length"] = ScaleFactor(length_std, {"Iyy": 2.0, "Izz": 2 * share}, source)
        for (name, moment), std, radius in zip(
            INERTIAS.items(), rule.inertia_std, rule.radii, strict=True
        ):
            factors[name] = ScaleFactor(
                std, {moment: 1.0}, f"radius of gyration {radius:g}, {rule.words}"
            )
        factors["product of inertia"] = ScaleFactor(PRODUCT_STD, {PRODUCT: 1.0}, f"none, {usual}")
    else:
        values["inertia"] = inertia
    factors |= {
        "mass": ScaleFactor(mass_std, of_mass, "told"),
        "span": ScaleFactor(span_std, of_span, "told"),
    }
    values["deviations"] = {name: factor for name, factor in factors.items() if factor.std > 0}
    return values


def value_and_std(name: str, value: Any) -> tuple[float, float]:
    """Return a positive number and its relative standard deviation, of a number or a pair (value, deviation)."""
    pair = as_floats(value)
    number, std = (
        (pair, 0.0) if pair.shape == () else tuple(pair) if pair.shape == (2,) else (np.nan, np.nan)
    )
    if not (0 < number < np.inf and 0 <= std < np.inf):
        unit = QUANTITIES.get(name, "")
        raise ValueError(
            f"Got {name}={value!r}, but expected a number > 0, "
            f"finite{f' [{unit}]' if unit else ''}, or a pair of it "
            "and its standard deviation."
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
    relative = relative_errors(deviations, regressors)
    errors = values * relative.reshape(
        len(relative), *(1,) * (values.ndim - 2), *relative.shape[1:]
    )
    ratio = np.sqrt(inertia[0, 0] / inertia[2, 2])
    for error, factor in zip(errors, deviations.values(), strict=True):
        product = factor.std * factor.powers.get(PRODUCT, 0.0)
        error[..., 3, :] -= product * ratio * values[..., 5, :]
        error[..., 5, :] -= product / ratio * values[..., 3, :]
        names = [
            [f"{row}_{column}".rstrip("_") for column in ("", *regressors)] for row in COEFFICIENTS
        ]
        error += factor.std * np.array(
            [[factor.added.get(name, 0.0) for name in row] for row in names]
        )
    return errors


def relative_errors(deviations: Mapping[str, ScaleFactor], regressors: tuple[str, ...]) -> Array:
    """Return relative errors of the coefficients and of their slopes, (factors, 6, 1 + regressors).

    Slopes are by the non-dimensional rates, p b / 2V, and by controls in the unit of the log, so
    that a full throw which is wrong by 1 % makes the effect of the control wrong by -1 %.
    """
    errors = np.zeros((len(deviations), len(COEFFICIENTS), 1 + len(regressors)))
    for k, factor in enumerate(deviations.values()):
        of_coefficient = [
            sum(p * factor.powers.get(name, 0.0) for name, p in POWERS[c].items())
            for c in COEFFICIENTS
        ]
        of_length = [factor.powers.get(LENGTHS.get(name, name), 0.0) for name in regressors]
        of_speed = [
            factor.powers.get(PRESSURE, 0.0) * SPEED_POWERS.get(name, 0.0) for name in regressors
        ]
        of_regressor = np.array([0.0, *np.subtract(of_speed, of_length)])
        errors[k] = factor.std * np.add.outer(of_coefficient, of_regressor)
    return errors
