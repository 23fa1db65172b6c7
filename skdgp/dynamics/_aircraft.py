"""The aircraft: mass, inertia, geometry, engine; checked, and read from files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from functools import cached_property
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.files import plain, read_json, read_toml, without_nones
from skdgp._compute.messages import report, warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import SURFACES
from skdgp._flight.findings import Finding
from skdgp._flight.physics import question_of_sizes
from skdgp._flight.tables import as_floats, check_distance, check_full_deflections, check_numbers
from skdgp.dynamics._propeller import Propeller, ThrustLine
from skdgp.dynamics._sizes import (
    INERTIAS,
    KINDS,
    MOMENTS,
    QUANTITIES,
    ScaleFactor,
    estimated,
    value_and_std,
)

CENTRED = ThrustLine()


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
    sensor_position : sequence of 3 floats, optional
        Position (x, y, z) of the inertial sensors from the centre of gravity, forward, right, down
        [m], to about 1 cm. None: unknown, and taken for the centre of gravity. Columns
        ``sensor_position_x``, ``_y``, ``_z`` of a flight count in its place.

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
    sensor_position: Sequence[float] | None = None

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.isprintable():
            raise ValueError(f"Got name={self.name!r}, but expected a line of text.")
        checked: dict[str, Any] = {}
        deviations = dict(self.deviations or {})
        for name in QUANTITIES:
            checked[name], std = value_and_std(name, vars(self)[name])
            if std:
                deviations[name.replace("_", " ")] = ScaleFactor(std, {name: 1.0}, "given")
        inertia, of_inertia = _inertia_and_deviations(self.inertia)
        deviations |= of_inertia
        for name, factor in deviations.items():
            deviations[name] = _built(ScaleFactor, factor, f"deviations of {name}")
        full = check_full_deflections(self.full_deflections or {}, SURFACES)
        checked |= {
            "inertia": _inertia(inertia),
            "deviations": deviations or None,
            "propeller": _propeller(self.propeller),
            "thrust_line": _thrust_line(self.thrust_line, checked["span"]),
            "full_deflections": full or None,
            "sensor_position": _sensor_position(self.sensor_position, checked["span"]),
        }
        vars(self).update(checked)

    @cached_property
    def inertia_inverse(self) -> np.ndarray:
        """The inverse of the inertia tensor, (3, 3) [1/(kg m^2)]."""
        return np.linalg.inv(self.inertia)

    @property
    def sizes(self) -> dict[str, float]:
        """Mass, lengths, area and moments of inertia by name."""
        sizes = {name: vars(self)[name] for name in QUANTITIES}
        return sizes | dict(zip(MOMENTS, self.inertia.diagonal().tolist(), strict=True))

    def question_of_sizes(
        self, numbers: Mapping[str, float] | None = None, stds: Mapping[str, float] | None = None
    ) -> Finding | None:
        """Return the question for sizes that no aeroplane has, None if all are plausible.

        ``numbers`` of flights (`numbers_in_flight`) or derivatives of a model, by name, tell the lift that
        carries it, its lift slope and damping, with the standard deviations ``stds``.
        """
        sizes = self.sizes | {"Ixz": -float(self.inertia[0, 2])}
        sizes["thrust_line.direction"] = float(self.engine_line.direction[0])
        if self.propeller is not None:
            sizes["propeller.diameter"] = self.propeller.diameter
        estimates = [each for each in (self.deviations or {}).values() if each.is_estimate]
        estimated = {name for each in estimates for name in each.powers}
        return question_of_sizes(sizes | dict(numbers or {}), stds or {}, estimated)

    def relative_std(self, size: str) -> float:
        """Return the relative standard deviation of a size by errors of all causes."""
        factors = (self.deviations or {}).values()
        return float(
            np.linalg.norm([0.0, *(each.std * each.powers.get(size, 0.0) for each in factors)])
        )

    @property
    def lengths(self) -> dict[str, float]:
        """Span and chord [m] by name."""
        return {"span": self.span, "chord": self.chord}

    @property
    def moment_lengths(self) -> Array:
        """Lengths (b, c, b) [m] that go with Cl, Cm, Cn."""
        return np.array([self.span, self.chord, self.span])

    @property
    def engine_line(self) -> ThrustLine:
        """The thrust line, by default through the centre of gravity and forward."""
        return self.thrust_line or CENTRED

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
            name, thrust_line, propeller, full_deflections, sensor_position: as of `Aircraft`.

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
        return _questioned(cls(**sizes, **parts))

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Aircraft:
        """Read the aircraft from a JSON or TOML file whose keys are the parameters of this class."""
        readers = {".json": read_json, ".toml": read_toml}
        read = readers.get(Path(path).suffix.lower())
        if read is None:
            raise ValueError(
                f"Got {path} as the aircraft, but expected a file that ends in .json or .toml."
            )
        return cls.from_dict(read(path), what=str(path))

    @classmethod
    def from_dict(cls, values: Mapping, *, what: str = "the aircraft") -> Aircraft:
        """Return the aircraft of a mapping of the parameters of this class, or with ``kind`` of `estimate`.

        Raises ValueError if a key is missing or unknown (the nearest known one is named), or a
        value is not valid.
        """
        if isinstance(values, Mapping) and "kind" in values:
            parts = ["name", "thrust_line", "propeller", "full_deflections", "sensor_position"]
            keys = [*signature(cls.estimate).parameters, *parts]
            check_keys(values, keys, ["mass", "span"], what)
            return cls.estimate(**values)
        return _questioned(_built(cls, {} if values is None else values, what))

    def to_dict(self) -> dict:
        """Return plain numbers, lists and dictionaries that `from_dict` reads back."""
        return plain(asdict(self, dict_factory=without_nones))

    def to_json(self) -> str:
        """Return the aircraft as JSON text, the content of a file for `from_file`."""
        return json.dumps(self.to_dict(), indent=1) + "\n"

    def __eq__(self, other: object) -> bool:
        return self.to_dict() == other.to_dict() if isinstance(other, Aircraft) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.to_json())

    def __repr__(self) -> str:
        sizes = f"S {self.wing_area:g} m^2, b {self.span:g} m, c {self.chord:g} m"
        return f"Aircraft({self.name!r}, {self.mass:g} kg, {sizes})"


def _questioned(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft; warn of sizes that no aeroplane has."""
    question = aircraft.question_of_sizes()
    if question is not None:
        report(question)
    return aircraft


def _sensor_position(value: Any, span: float) -> tuple[float, ...] | None:
    """Return the checked position of the inertial sensors [m], None if it is not given."""
    if value is None:
        return None
    position = check_numbers(
        "sensor_position", value, 3, unit="m forward, right, down of the centre of gravity"
    )
    check_distance("sensor_position", position[None], span)
    return tuple(position.tolist())


def _thrust_line(value: Any, span: float) -> ThrustLine | None:
    """Return the checked thrust line, None if it is not given."""
    line = _built(ThrustLine, value, "thrust_line")
    if line is not None:
        check_distance("thrust_line.position", line.position[None], span)
    return line


def _inertia_and_deviations(value: Any) -> tuple[Any, dict[str, ScaleFactor]]:
    """Return an inertia, and the errors of its moments if they are given with it."""
    deviations = {}
    if isinstance(value, list | tuple) and len(value) == 2 and np.shape(value[1]) == (3,):
        value, stds = value
        relative = (as_floats(stds) / np.diag(value)).tolist()
        for (name, moment), std in zip(INERTIAS.items(), relative, strict=True):
            deviations[name] = ScaleFactor(std, {moment: 1.0}, "given")
    return value, deviations


def _inertia(value: ArrayLike) -> Array:
    inertia = as_floats(value)
    if inertia.shape != (3, 3) or not np.isfinite(inertia).all():
        raise ValueError(
            f"Got inertia {value!r}, but expected 3 x 3 numbers, finite [kg m^2]: "
            "[[Ixx, -Ixy, -Ixz], [-Ixy, Iyy, -Iyz], [-Ixz, -Iyz, Izz]]."
        )
    if not np.allclose(inertia, inertia.T, rtol=0, atol=1e-6 * abs(inertia).max()):
        raise ValueError(
            f"Got inertia {inertia.tolist()} which is not symmetric: write each product of inertia "
            "in both places, inertia[i][j] = inertia[j][i]."
        )
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    rounded = moments.round(6).tolist()
    if moments[0] <= 0:
        raise ValueError(
            f"Got inertia {inertia.tolist()} which is not positive definite (principal moments "
            f"{rounded} kg m^2): check units (kg m^2) and signs (inertia[0][2] = -Ixz)."
        )
    if moments[2] > (1 + 1e-9) * (moments[0] + moments[1]):
        warn(
            f"Principal moments of inertia {rounded} kg m^2: the largest exceeds the sum of the "
            "others, which no distribution of mass can do. Check the measurement and the signs."
        )
    inertia.setflags(write=False)
    return inertia


def _propeller(value: Any) -> Propeller | None:
    """Return a propeller, the usual one of a mapping with a pitch, or None."""
    if not (isinstance(value, Mapping) and "pitch" in value):
        return _built(Propeller, value, "propeller")
    names = list(signature(Propeller.from_size).parameters)
    check_keys(value, names, ["diameter"], "propeller")
    return Propeller.from_size(**value)


def _built(kind: type, value: Any, what: str) -> Any:
    """Return an object of a kind, built if it is a mapping, or None; raise ValueError at other values and keys."""
    if value is None or isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(
            f"Got {type(value).__name__} for {what}, but expected {kind.__name__} or a mapping."
        )
    parameters = signature(kind).parameters.values()
    names = [parameter.name for parameter in parameters]
    required = [parameter.name for parameter in parameters if parameter.default is Parameter.empty]
    check_keys(value, names, required, what)
    return kind(**value)


def check_keys(values: Mapping, known: Sequence[str], required: Sequence[str], what: str) -> None:
    """Raise ValueError if a key is unknown, with the nearest known one, or a required one is missing."""
    for key in values:
        if key not in known:
            near = get_close_matches(str(key), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys are {known}."
            raise ValueError(f"Got unknown key {key!r} in {what}: {hint}")
    missing = [name for name in required if name not in values]
    if missing:
        remedy = ""
        if "inertia" in required:
            remedy = f" Give them, or kind = one of {list(KINDS)} to estimate them."
        raise ValueError(f"{what} lacks {missing}: got only {sorted(map(str, values))}.{remedy}")


def check_aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, or raise TypeError."""
    if not isinstance(aircraft, Aircraft):
        raise TypeError(
            f"Got {type(aircraft).__name__} for aircraft, but expected a skdgp.dynamics.Aircraft: "
            "read one with Aircraft.from_file(path)."
        )
    return aircraft
