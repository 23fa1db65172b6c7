"""The aircraft: mass, inertia, geometry and propulsion; sizes estimated from its mass and span, and their errors."""

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
from numpy.typing import ArrayLike

from skdgp._compute.files import read_json, read_toml
from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, LENGTHS, RATE_LENGTHS
from skdgp._flight.checks import as_floats, check_choice, check_number
from skdgp.dynamics._engines import Propeller, ThrustLine

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
        aspect_ratio: float | Sequence[float] | None = None,
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
        and if the kind is unknown, or wing area and aspect ratio are both given.

        Parameters
        ----------
        mass, span : float or pair
            [kg], [m].
        kind : {"conventional", "flying wing", "delta", "motor glider", "twin"}
            "conventional" has one propeller and a tail, "twin" two propellers on the wing; "delta"
            is a long one of small aspect ratio.
        wing_area, aspect_ratio, chord, length : float or pair, optional
            [m^2], span^2 / wing area, mean chord [m], from nose to tail [m].
        inertia : array-like of shape (3, 3), or pair, optional
            Where it was measured.
        **parts
            name, thrust_line, propeller: as of `Aircraft`.

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
            kind, inertia, mass=mass, span=span, wing_area=wing_area, aspect_ratio=aspect_ratio,
            chord=chord, length=length,
        )  # fmt: skip
        return cls(**sizes, **parts)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Aircraft:
        """Read the aircraft from a JSON or TOML file whose keys are the parameters of this class."""
        readers = {".json": read_json, ".toml": read_toml}
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"Got {path} as the aircraft, but there is no such file.")
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
            known = [*signature(cls.estimate).parameters, "name", "thrust_line", "propeller"]
            check_keys(values, known, ["mass", "span"], what)
            return cls.estimate(**values)
        return _build(cls, values, what)

    def to_dict(self) -> dict:
        """Return plain numbers, lists and dictionaries that `from_dict` reads back."""
        return _plain(self)

    def to_json(self, path: str | Path | None = None) -> str:
        """Return the aircraft as JSON text, and write it to ``path`` when one is given."""
        text = json.dumps(self.to_dict(), indent=1) + "\n"
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

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
