"""The aircraft: mass, inertia, geometry, propeller, thrust line; sizes estimated from mass and span, and errors."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from difflib import get_close_matches
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.files import read_json, read_toml
from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    ACCELERATION_LENGTHS,
    COEFFICIENTS,
    LENGTHS,
    RATE_LENGTHS,
    SURFACES,
)
from skdgp._flight.checks import (
    as_floats,
    check_choice,
    check_columns,
    check_number,
    check_numbers,
    check_table,
)
from skdgp._flight.frames import SEA_LEVEL_DENSITY

USUAL_THRUST = ((0.0479, 0.0923), (-0.136, 0.1233), (-0.1036, 0.0))
# c_0, c_1, c_2 of C_T and C_Q, each of 1 and pitch / diameter: least squares of the wind-tunnel
# data of 178 propellers of two blades (UIUC Propeller Data Site, volumes 1 to 3; Brandt & Selig,
# AIAA 2011-1255), 20,098 points, each propeller with the same weight, in the ranges below.
USUAL_TORQUE = ((-0.0017, 0.0158), (-0.0016, 0.0057), (-0.0118, 0.0))
# Relative error of the thrust of propellers whose family is not in the fit, root mean square, at
# advance ratios of 0.4 to 0.9 times pitch / diameter; of the torque 0.13. Towards zero thrust it
# grows.
USUAL_STD = 0.23
# Of these propellers: diameter [m], pitch / diameter
MEASURED_DIAMETERS, MEASURED_PITCHES = (0.17, 0.49), (0.35, 1.1)
# Speed at full throttle over the speed of the motor without load, and the deviation of the thrust
# by its 0.1, which goes with its third power or so in flight; guesses
LOADED_SPEED, LOADED_THRUST_STD = 0.75, 0.35


@dataclass(frozen=True)
class Propeller:
    r"""A fixed-pitch propeller: thrust and torque from its advance ratio.

    With n = Omega / 2 pi the revolutions per second, D the diameter and J = V / (n D) the advance
    ratio,

        T = rho n^2 D^4 C_T(J),   Q = rho n^2 D^5 C_Q(J),   C(J) = c_0 + c_1 J + c_2 J^2.

    Both are finite when the propeller does not turn.

    Parameters
    ----------
    diameter : float
        D [m].
    thrust_coefficients : sequence of 1 to 3 floats
        c_0, c_1, c_2 of C_T. A single c_0 is the static thrust, whatever the airspeed.
    torque_coefficients : sequence of at most 3 floats
        c_0, c_1, c_2 of C_Q; empty: no torque.
    rotation : {1, -1}
        1 turns clockwise seen from behind, and its torque rolls the aircraft left; -1 the other
        way.
    max_advance_ratio : float, optional
        Largest advance ratio that was measured; flights beyond it get a warning.
    speed_range : pair of float, optional
        Propeller speeds [rad/s] at throttle 0 and 1, in proportion between them: with it throttle
        is a control, and gives the thrust of flights without propeller_speed.
    load_std : float, default=0.0
        Relative standard deviation of thrust and torque.

    Examples
    --------
    >>> from skdgp.dynamics import Propeller
    >>> propeller = Propeller(diameter=0.5, thrust_coefficients=(0.1, -0.05, -0.08))
    >>> propeller.thrust(propeller_speed=600.0, airspeed=[0.0, 20.0, 40.0]).round(2)
    array([69.82, 45.39,  1.37])
    """

    diameter: float
    thrust_coefficients: Sequence[float]
    torque_coefficients: Sequence[float] = ()
    rotation: int = 1
    max_advance_ratio: float | None = None
    speed_range: Sequence[float] | None = None
    load_std: float = 0.0

    def __post_init__(self):
        checked: dict[str, Any] = {
            "diameter": check_number("diameter", self.diameter, unit="m"),
            "load_std": check_number("load_std", self.load_std, is_open=False),
        }
        check_choice("rotation", self.rotation, (1, -1))
        if self.max_advance_ratio is not None:
            checked["max_advance_ratio"] = check_number("max_advance_ratio", self.max_advance_ratio)
        for name, sizes in (("thrust_coefficients", (1, 2, 3)), ("torque_coefficients", range(4))):
            checked[name] = tuple(check_numbers(name, getattr(self, name), *sizes).tolist())
        if self.speed_range is not None:
            idle, full = check_numbers("speed_range", self.speed_range, 2).tolist()
            if not 0 <= idle < full:
                raise ValueError(
                    f"Got speed_range={self.speed_range!r}, but expected 0 <= idle < full [rad/s]."
                )
            checked["speed_range"] = idle, full
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def speed_at(self, throttle: ArrayLike) -> Array:
        """Return the propeller speed [rad/s] at ``throttle``, 0 to 1; ``speed_range`` must be known."""
        idle, full = check_numbers("speed_range", self.speed_range, 2)
        return idle + (full - idle) * np.asarray(throttle, dtype=float)

    def thrust(
        self,
        propeller_speed: ArrayLike,
        airspeed: ArrayLike,
        density: ArrayLike = SEA_LEVEL_DENSITY,
    ) -> Array:
        """Return the thrust [N] at propeller speed [rad/s], airspeed [m/s], density [kg/m^3]."""
        return self._load(self.thrust_coefficients, 4, propeller_speed, airspeed, density)

    def torque(
        self,
        propeller_speed: ArrayLike,
        airspeed: ArrayLike,
        density: ArrayLike = SEA_LEVEL_DENSITY,
    ) -> Array:
        """Return the torque [N m] ON THE AIRCRAFT about the thrust direction (opposite to the rotation)."""
        return -self.rotation * self._load(
            self.torque_coefficients, 5, propeller_speed, airspeed, density
        )

    def advance_ratio(self, propeller_speed: ArrayLike, airspeed: ArrayLike) -> np.ndarray:
        """Return J = V / (n D) = 2 pi V / (Omega D), infinite where the propeller stands still."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return (
                2.0
                * np.pi
                * np.asarray(airspeed, float)
                / (np.asarray(propeller_speed, float) * self.diameter)
            )

    @classmethod
    def from_table(
        cls,
        table: pd.DataFrame,
        diameter: float,
        *,
        pitch: float | None = None,
        rotation: int = 1,
    ) -> Propeller:
        """Fit the propeller to a bench table by least squares in newtons.

        Warns if the table is static and no pitch is given: thrust in flight is then overstated.

        Parameters
        ----------
        table : pandas.DataFrame
            Columns ``propeller_speed`` [rad/s] and ``thrust`` [N]; where measured also ``airspeed``
            [m/s], ``density`` [kg/m^3] (else 1.225) and ``torque`` [N m].
        diameter : float
            D [m].
        pitch : float, optional
            Geometric pitch [m] (a "20 x 10" propeller: 10 inches). For a static table C_T = c_0 (1
            - J D / pitch), zero where the blades do not slip: a rule of thumb, true zero-thrust
            advance ratios are often higher.
        rotation : {1, -1}
            1 turns clockwise seen from behind.

        Examples
        --------
        >>> import pandas as pd
        >>> from skdgp.dynamics import Propeller
        >>> bench = pd.DataFrame({"propeller_speed": [200.0, 400.0, 600.0], "thrust": [7.76, 31.02, 69.81]})
        >>> propeller = Propeller.from_table(bench, diameter=0.5, pitch=0.4)
        >>> [round(c, 3) for c in propeller.thrust_coefficients]
        [0.1, -0.125]
        """
        loads = ["thrust", *(["torque"] if "torque" in table else [])]
        check_columns(check_table(table), ["propeller_speed", *loads], what="bench table")
        defaults = {"airspeed": 0.0, "density": SEA_LEVEL_DENSITY}
        table = table.assign(**{name: x for name, x in defaults.items() if name not in table})
        speed, airspeed, density = (
            table[name].to_numpy(float) for name in ("propeller_speed", "airspeed", "density")
        )
        is_finite = np.isfinite(speed + airspeed + density + table[loads].sum(axis=1, skipna=False))
        if not (is_finite & (speed > 0) & (airspeed >= 0) & (density > 0)).all():
            raise ValueError(
                "Got a bench table with NaN, or with propeller_speed <= 0, airspeed < 0 or density "
                "<= 0: drop those rows or fix the units [rad/s, m/s, kg/m^3]."
            )
        is_static = not airspeed.any()
        if is_static and pitch is None:
            warn(
                "The bench table holds no airspeed > 0, so thrust in flight is overstated. Add rows "
                "measured in a wind tunnel, or give pitch=... [m]: the thrust then falls to zero at "
                "the advance ratio pitch / diameter.",
                stacklevel=2,
            )
        n = speed / (2.0 * np.pi)
        powers = range(1 if is_static else 3)
        basis = np.stack([density * n ** (2 - k) * (airspeed / diameter) ** k for k in powers], -1)
        targets = table[loads].to_numpy(float) / [diameter**4, diameter**5][: len(loads)]
        coefficients, _, rank, _ = np.linalg.lstsq(basis, targets, rcond=None)
        if rank < len(powers):
            raise ValueError(
                f"The bench table's {len(table)} rows do not determine c_0, c_1 and c_2: measure at 3 "
                "or more advance ratios."
            )
        fitted = dict(zip(loads, coefficients.T.tolist(), strict=True))
        if is_static and pitch is not None:
            fitted["thrust"].append(-fitted["thrust"][0] * diameter / pitch)
        largest = None if is_static else float(np.max(airspeed / (n * diameter)))
        return cls(
            diameter,
            fitted["thrust"],
            fitted.get("torque", ()),
            rotation,
            max_advance_ratio=largest,
        )

    @classmethod
    def from_size(
        cls,
        diameter: float,
        pitch: float,
        *,
        motor_constant: float | None = None,
        voltage: float | None = None,
        rotation: int = 1,
    ) -> Propeller:
        r"""Return the usual propeller of two blades of a size, with the deviation of its thrust.

        With x = pitch / D, fitted to 178 propellers in the wind tunnel (UIUC Propeller Data Site;
        Brandt & Selig 2011),

        .. math:: C_T = 0.048 + 0.092 x - (0.136 - 0.123 x) J - 0.104 J^2,

        and C_Q likewise; the thrust of others is 23 % off, root mean square. Raises ValueError if a
        size is not positive, or of the motor's constant and the voltage there is one alone; warns
        beyond the sizes measured.

        Parameters
        ----------
        diameter, pitch : float
            [m]; a "10x5" has 0.254 and 0.127.
        motor_constant, voltage : float, optional
            Speed of the electric motor per volt without load [rad/s/V], 0.1047 times the rpm per
            volt; voltage of the battery in flight [V]. The thrust at a throttle is then some 40 %
            off. Without them flights need propeller_speed.
        rotation : {1, -1}
            1 turns clockwise seen from behind.

        Examples
        --------
        >>> from skdgp.dynamics import Propeller
        >>> propeller = Propeller.from_size(0.254, 0.127)
        >>> propeller.thrust(propeller_speed=800.0, airspeed=[0.0, 10.0]).round(1), propeller.load_std
        (array([7.8, 5.1]), 0.23)
        """
        ratio = check_number("pitch", pitch) / check_number("diameter", diameter)
        for name, value, (low, high) in (
            ("diameter", diameter, MEASURED_DIAMETERS),
            ("pitch / diameter", ratio, MEASURED_PITCHES),
        ):
            if not low <= value <= high:
                warn(
                    f"Got a propeller with {name} {value:.2g}, but its thrust is estimated from "
                    f"others with {low:g} to {high:g}: its error may be larger than stated.",
                    stacklevel=2,
                )
        speed_range = None
        std = USUAL_STD
        if motor_constant is not None or voltage is not None:
            constant = check_number("motor_constant", motor_constant, unit="rad/s/V")
            speed_range = (
                0.0,
                LOADED_SPEED * constant * check_number("voltage", voltage, unit="V"),
            )
            std = round(float(np.hypot(std, LOADED_THRUST_STD)), 2)
        thrust, torque = np.array([USUAL_THRUST, USUAL_TORQUE]) @ [1.0, ratio]
        return cls(
            diameter, thrust, torque, rotation=rotation, speed_range=speed_range, load_std=std
        )

    def _load(
        self,
        coefficients: Sequence[float],
        power: int,
        propeller_speed: Any,
        airspeed: Any,
        density: Any,
    ) -> Array:
        # n^2 C(V / n D) multiplied out, which stays finite at n = 0.
        n = np.asarray(propeller_speed, dtype=float) / (2.0 * np.pi)
        advance = np.asarray(airspeed, dtype=float) / self.diameter
        c0, c1, c2 = (*coefficients, 0.0, 0.0, 0.0)[:3]
        return (
            np.asarray(density, float)
            * self.diameter**power
            * ((c0 * n + c1 * advance) * n + c2 * advance**2)
        )


@dataclass(frozen=True, eq=False)
class ThrustLine:
    """Position and direction of the thrust, in body axes relative to the centre of gravity.

    Parameters
    ----------
    position : array-like of shape (3,)
        A point of the line: forward, right, down of the centre of gravity [m].
    direction : array-like of shape (3,)
        Where the force points; any length, stored as a unit vector. (1, 0, 0) is straight forward.

    Examples
    --------
    An engine 0.2 m above the centre of gravity pitches the nose down:

    >>> from skdgp.dynamics import ThrustLine
    >>> force, moment = ThrustLine(position=(-0.5, 0.0, -0.2), direction=(1, 0, 0)).loads(100.0)
    >>> force.tolist(), moment.tolist()
    ([100.0, 0.0, 0.0], [0.0, -20.0, 0.0])
    """

    position: Any = (0.0, 0.0, 0.0)
    direction: Any = (1.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("position", "direction"):
            vector = check_numbers(f"thrust-line {name}", getattr(self, name), 3)
            object.__setattr__(self, name, vector)
        length = np.linalg.norm(self.direction)
        if length == 0:
            raise ValueError(
                "Got a thrust direction of length zero, but expected one such as (1, 0, 0)."
            )
        object.__setattr__(self, "direction", self.direction / length)
        for vector in (self.position, self.direction):
            vector.setflags(write=False)

    def loads(self, thrust: ArrayLike, torque: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return force (..., 3) [N] and moment (..., 3) [N m] about the centre of gravity.

        F_T = T d and M_T = r_T x F_T + Q d, with ``thrust`` T [N] and ``torque`` Q [N m] on the
        aircraft about the line's direction d (a propeller turning clockwise seen from behind gives
        Q < 0).
        """
        T, Q = (np.asarray(load, dtype=float)[..., None] for load in (thrust, torque))
        return T * self.direction, T * np.cross(self.position, self.direction) + Q * self.direction


# Sizes of an aircraft and their units
QUANTITIES = {"mass": "kg", "wing_area": "m^2", "span": "m", "chord": "m"}
MOMENTS = ("Ixx", "Iyy", "Izz")
INERTIAS = dict(zip(("roll inertia", "pitch inertia", "yaw inertia"), MOMENTS, strict=True))
PRODUCT = "Ixz"
PRESSURE = "dynamic pressure"
# A measured coefficient is proportional to these powers: m f / (qbar S), and I omega_dot / (qbar S
# b) but for products of inertia and gyroscopic moments
POWERS = {name: {"mass": 1.0, "wing_area": -1.0, PRESSURE: -1.0} for name in COEFFICIENTS[:3]} | {
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


def estimated(kind: str, inertia: Any, **sizes: Any) -> dict[str, Any]:
    """Return mass, inertia, wing_area, span, chord and deviations of an aircraft, as of `Aircraft.estimate`.

    ``sizes`` are mass, span, wing_area, chord, length, None where not given. The
    powers of a factor x are d log(size) / d log(x), by a complex step.
    """
    check_choice("kind", kind, KINDS)
    rule = KINDS[kind]
    given = {name.replace("_", " "): x for name, x in sizes.items() if x is not None}
    usual = f"usual of {kind} aircraft"
    length = value_and_std("span", sizes["span"])[0] * rule.length[0]
    rules = {
        "aspect ratio": (*rule.aspect_ratio, f"{rule.aspect_ratio[0]:g}, {usual}"),
        "mean aerodynamic chord": (*rule.chord, f"{rule.chord[0]:g} S / b, {usual}"),
        "length": (*rule.length, f"{length:.3g} m, {usual}"),
    }
    for (name, _), std, radius in zip(INERTIAS.items(), rule.inertia_std, rule.radii, strict=True):
        rules[name] = (radius**2, std, f"radius of gyration {radius:g}, {rule.words}")
    if {"wing area", "chord"} & given.keys():
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
    b = values["span"]
    if "wing area" in values:
        S = values["wing area"]
    elif "aspect ratio" in values:
        S = b**2 / values["aspect ratio"]
    else:
        S = b * values["chord"]
    c = values["chord"] if "chord" in values else values["mean aerodynamic chord"] * S / b
    sizes = {"mass": values["mass"], "wing_area": S, "span": b, "chord": c}
    if "length" in values:
        l = values["length"] * (1.0 if is_length_given else b)
        arms = (b, l, 0.5 * (b + l))
        for (name, moment), arm in zip(INERTIAS.items(), arms, strict=True):
            # Raymer, equations 16.52 to 16.54; the factor is the squared radius of gyration
            sizes[moment] = values["mass"] * (0.5 * arm) ** 2 * values[name]
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
    columns: list[dict[str, float]] = [
        {},
        *({PRESSURE: SPEED_POWERS.get(n, 0.0), LENGTHS.get(n, n): -1.0} for n in regressors),
    ]
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Aircraft:
    """Mass, inertia, reference lengths and thrust line of an aircraft.

    Raises ValueError if a size is not positive and finite, or the inertia is not symmetric and
    positive definite. Warns if one principal moment of inertia exceeds the sum of the other two,
    which no real body's does.

    Parameters
    ----------
    name : str
        For titles and tables.
    mass : float
        [kg].
    inertia : array-like of shape (3, 3)
        Inertia tensor about the centre of gravity in body axes (x forward, y right, z down) [kg
        m^2]. Off the diagonal stand MINUS the products of inertia: ``inertia[0][2] = -Ixz``.
    wing_area, span, chord : float
        Reference area S [m^2], span b and chord c [m] of the coefficients.
    thrust_line : ThrustLine or mapping, optional
        Position and direction of the engine's force; without it, through the centre of gravity and
        forward.
    propeller : Propeller or mapping, optional
        Thrust as a function of propeller speed and airspeed, for flights without thrust columns; or
        a mapping of the parameters of `Propeller.from_size`, such as diameter and pitch.
    deviations : mapping of str to ScaleFactor or mapping, optional
        Errors of the sizes, by their cause: :func:`skdgp.dynamics.stability_derivatives` says what
        they do. A pair (value, standard deviation) for mass, wing_area, span or chord, or (matrix,
        three standard deviations of Ixx, Iyy, Izz) for inertia, adds its own.
    full_deflections : mapping of str to float, optional
        Largest deflections [rad] of elevator, aileron and rudder, at the ends of their commands.

    Examples
    --------
    >>> from skdgp.dynamics import Aircraft
    >>> glider = Aircraft(name="glider", mass=2.0, inertia=[[0.2, 0, -0.01], [0, 0.3, 0], [-0.01, 0, 0.4]],
    ...                   wing_area=0.5, span=2.0, chord=0.25)
    >>> glider
    Aircraft('glider', 2 kg, S 0.5 m^2, b 2 m, c 0.25 m)
    >>> Aircraft.from_dict(glider.to_dict()) == glider
    True
    """

    name: str = "aircraft"
    mass: float
    inertia: Array
    wing_area: float
    span: float
    chord: float
    thrust_line: ThrustLine | None = None
    propeller: Propeller | None = None
    deviations: Mapping[str, ScaleFactor] | None = None
    full_deflections: Mapping[str, float] | None = None

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.isprintable():
            raise ValueError(f"Got name={self.name!r}, but expected a line of text.")
        factors = dict(self.deviations or {})
        for name in QUANTITIES:
            value, std = value_and_std(name, getattr(self, name))
            object.__setattr__(self, name, value)
            if std:
                factors[name.replace("_", " ")] = ScaleFactor(std, {name: 1.0}, "given")
        inertia: Any = self.inertia
        if isinstance(inertia, list | tuple) and len(inertia) == 2 and np.shape(inertia[1]) == (3,):
            inertia, stds = inertia
            relative = (as_floats(stds) / np.diag(inertia)).tolist()
            for (name, moment), std in zip(INERTIAS.items(), relative, strict=True):
                factors[name] = ScaleFactor(std, {moment: 1.0}, "given")
        for name, factor in factors.items():
            factors[name] = _part(ScaleFactor, factor, f"deviations of {name}")
        object.__setattr__(self, "inertia", _inertia(inertia))
        object.__setattr__(self, "deviations", factors or None)
        propeller: Any = self.propeller
        if isinstance(propeller, Mapping) and "pitch" in propeller:
            names = list(signature(Propeller.from_size).parameters)
            check_keys(propeller, names, ["diameter"], "propeller")
            propeller = Propeller.from_size(**propeller)
        object.__setattr__(self, "propeller", _part(Propeller, propeller, "propeller"))
        object.__setattr__(self, "thrust_line", _part(ThrustLine, self.thrust_line, "thrust_line"))
        full = _full_deflections(self.full_deflections)
        object.__setattr__(self, "full_deflections", full)

    @cached_property
    def inertia_inverse(self) -> np.ndarray:
        """The inverse of the inertia tensor, (3, 3) [1/(kg m^2)]."""
        return np.linalg.inv(self.inertia)

    @property
    def moment_lengths(self) -> Array:
        """Lengths (b, c, b) [m] that go with Cl, Cm, Cn."""
        return np.array([self.span, self.chord, self.span])

    @classmethod
    def estimate(
        cls,
        mass: float | Sequence[float],
        span: float | Sequence[float],
        *,
        kind: str = "conventional",
        wing_area: float | Sequence[float] | None = None,
        chord: float | Sequence[float] | None = None,
        length: float | Sequence[float] | None = None,
        inertia: Any = None,
        **parts: Any,
    ) -> Aircraft:
        """Return an aircraft from a scale and a tape measure; its ``deviations`` say how wrong the other sizes may be.

        Moments of inertia follow from radii of gyration of its kind (Raymer, Aircraft Design,
        equations 16.52 to 16.54), Ixx = m (R_x b / 2)^2, Iyy = m (R_y l / 2)^2, Izz = m (R_z (b +
        l) / 4)^2. Wing area, chord and length, where missing, follow from usual ratios of the
        kind. A pair is a value and its standard deviation. Raises ValueError as `Aircraft` does,
        and if the kind is unknown.

        Parameters
        ----------
        mass, span : float or pair
            [kg], [m].
        kind : {"conventional", "flying wing", "delta", "motor glider", "twin"}
            "conventional" has one propeller and a tail, "twin" two propellers on the wing; "delta"
            is a long one of small aspect ratio.
        wing_area, chord, length : float or pair, optional
            [m^2], span^2 / wing area, mean chord [m], from nose to tail [m].
        inertia : array-like of shape (3, 3), or pair, optional
            Where it was measured.
        **parts
            name, thrust_line, propeller, full_deflections: as of `Aircraft`.

        Examples
        --------
        >>> from skdgp.dynamics import Aircraft
        >>> uav = Aircraft.estimate(mass=(3.2, 0.05), span=1.6, chord=0.22)
        >>> uav, uav.inertia.diagonal().round(3).tolist()
        (Aircraft('aircraft', 3.2 kg, S 0.352 m^2, b 1.6 m, c 0.22 m), [0.128, 0.175, 0.244])
        >>> [f"{cause} {each.std:.2g}" for cause, each in uav.deviations.items()]
        ['length 0.15', 'roll inertia 0.45', 'pitch inertia 0.25', 'yaw inertia 0.35', 'mass 0.016',
         'product of inertia 0.07']
        """
        sizes = estimated(
            kind, inertia, mass=mass, span=span, wing_area=wing_area, chord=chord, length=length
        )
        return cls(**sizes, **parts)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Aircraft:
        """Read the aircraft from a JSON or TOML file whose keys are the parameters of this class."""
        readers = {".json": read_json, ".toml": read_toml}
        path = Path(path)
        if path.suffix.lower() not in readers:
            raise ValueError(
                f"Got {path} as the aircraft, but expected a file that ends in .json or .toml."
            )
        return cls.from_dict(readers[path.suffix.lower()](path), what=str(path))

    @classmethod
    def from_dict(cls, values: Mapping, *, what: str = "the aircraft") -> Aircraft:
        """Return the aircraft of a mapping of the parameters of this class, or with ``kind`` of `estimate`.

        Raises ValueError if a key is missing or unknown (the nearest known one is named), or a
        value is not valid.
        """
        if isinstance(values, Mapping) and "kind" in values:
            parts = ["name", "thrust_line", "propeller", "full_deflections"]
            known = [*signature(cls.estimate).parameters, *parts]
            check_keys(values, known, ["mass", "span"], what)
            return cls.estimate(**values)
        return _build(cls, values, what)

    def to_dict(self) -> dict:
        """Return plain numbers, lists and dictionaries that `from_dict` reads back."""
        return _plain(self)

    def to_json(self) -> str:
        """Return the aircraft as JSON text, the content of a file for `from_file`."""
        return json.dumps(self.to_dict(), indent=1) + "\n"

    def __eq__(self, other: object) -> bool:
        return self.to_dict() == other.to_dict() if isinstance(other, Aircraft) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.to_json())

    def __repr__(self) -> str:
        return (
            f"Aircraft({self.name!r}, {self.mass:g} kg, S {self.wing_area:g} m^2, b {self.span:g} "
            f"m, "
            f"c {self.chord:g} m)"
        )


def _full_deflections(values: Any) -> dict[str, float] | None:
    """Return checked deflections by control, None without any."""
    if not values:
        return None
    if not isinstance(values, Mapping):
        raise TypeError(
            f"Got {type(values).__name__} for full_deflections, but expected a mapping of controls "
            f"to angles [rad]."
        )
    check_keys(values, SURFACES, [], "full_deflections")
    return {
        name: check_number(f"full deflection of the {name}", value, unit="rad")
        for name, value in values.items()
    }


def _inertia(value: ArrayLike) -> Array:
    inertia = as_floats(value)
    if inertia.shape != (3, 3) or not np.isfinite(inertia).all():
        raise ValueError(
            f"Got inertia {value!r}, but expected 3 x 3 numbers, finite [kg m^2]: "
            "[[Ixx, -Ixy, -Ixz], [-Ixy, Iyy, -Iyz], [-Ixz, -Iyz, Izz]]."
        )
    if not np.allclose(inertia, inertia.T, rtol=0, atol=1e-6 * abs(inertia).max()):
        raise ValueError(
            f"Got inertia {inertia.tolist()} which is not symmetric: write each product of "
            f"inertia in both "
            "places, inertia[i][j] = inertia[j][i]."
        )
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0:
        raise ValueError(
            f"Got inertia {inertia.tolist()} which is not positive definite (principal moments "
            f"{moments.round(6).tolist()} kg m^2): check units (kg m^2) and signs (inertia[0][2] "
            f"= -Ixz)."
        )
    if moments[2] > (1 + 1e-9) * (moments[0] + moments[1]):
        warn(
            f"Principal moments of inertia {moments.round(6).tolist()} kg m^2: the largest "
            f"exceeds the "
            "sum of the others, which no distribution of mass can do. Check the measurement and "
            "the signs.",
            stacklevel=4,
        )
    inertia.setflags(write=False)
    return inertia


def _part(kind: type, part: Any, what: str) -> Any:
    """Return an object of a kind, built if it is a mapping, or None."""
    if isinstance(part, Mapping):
        return _build(kind, part, what)
    if part is not None and not isinstance(part, kind):
        raise TypeError(
            f"Got {type(part).__name__} for {what}, but expected {kind.__name__} or a mapping."
        )
    return part


def _build(kind: type, values: Mapping, what: str) -> Any:
    """Return ``kind(**values)``, with errors that name missing keys and the nearest to unknown ones."""
    if not isinstance(values, Mapping):
        raise ValueError(
            f"Got {type(values).__name__} in {what}, but expected named values (key: value)."
        )
    names = [field.name for field in fields(kind)]
    required = [
        f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING
    ]
    check_keys(values, names, required, what)
    return kind(**values)


def check_keys(values: Mapping, known: Sequence[str], required: Sequence[str], what: str) -> None:
    """Raise ValueError if a key is unknown, with the nearest known one, or a required one is missing."""
    for key in values:
        if key not in known:
            near = get_close_matches(str(key), known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys are {known}."
            raise ValueError(f"Got unknown key {key!r} in {what}: {hint}")
    missing = [name for name in required if name not in values]
    if missing:
        remedy = (
            f" Give them, or kind = one of {list(KINDS)} to estimate them."
            if "inertia" in required
            else ""
        )
        raise ValueError(f"{what} lacks {missing}: got only {sorted(map(str, values))}.{remedy}")


def _plain(value: Any) -> Any:
    """Return dataclasses as dictionaries without their Nones, arrays and tuples as lists."""
    if hasattr(value, "__dataclass_fields__"):
        items = {field.name: getattr(value, field.name) for field in fields(value)}
        return {key: _plain(item) for key, item in items.items() if item is not None}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return np.asarray(value).tolist() if isinstance(value, (np.ndarray, tuple)) else value


def check_aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, or raise TypeError."""
    if not isinstance(aircraft, Aircraft):
        raise TypeError(
            f"Got {type(aircraft).__name__} for aircraft, but expected a skdgp.dynamics.Aircraft: "
            f"read one with "
            "Aircraft.from_file(path)."
        )
    return aircraft
