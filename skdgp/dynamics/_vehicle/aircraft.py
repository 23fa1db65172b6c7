"""The aircraft: mass, inertia, geometry and propulsion."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.files import parse_json, read_json, read_toml
from skdgp._compute.typing import Array
from skdgp.dynamics._vehicle.engines import Propeller, ThrustLine, as_floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Aircraft:
    """Mass, inertia, reference lengths and thrust line of an aircraft.

    Raises ValueError if a number is not positive and finite, or the inertia is not symmetric and positive definite.
    Warns if one principal moment of inertia exceeds the sum of the other two, which no real body's does.

    Parameters
    ----------
    name : str
        For titles and tables.
    mass : float
        [kg].
    inertia : array-like of shape (3, 3)
        Inertia tensor about the centre of gravity in body axes (x forward, y right, z down) [kg m^2]. Off the
        diagonal stand MINUS the products of inertia: ``inertia[0][2] = -Ixz``.
    wing_area, span, chord : float
        Reference area S [m^2], span b and chord c [m] of the coefficients.
    thrust_line : ThrustLine or mapping, optional
        Position and direction of the engine's force; without it, through the centre of gravity and forward.
    propeller : Propeller or mapping, optional
        Thrust as a function of propeller speed and airspeed, for flights without thrust columns.

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

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.isprintable():
            raise ValueError(f"Got name={self.name!r}, but expected a line of text.")
        for name, unit in (("mass", "kg"), ("wing_area", "m^2"), ("span", "m"), ("chord", "m")):
            value = as_floats(getattr(self, name))
            if value.shape != () or not 0 < value < np.inf:
                raise ValueError(f"Got {name}={getattr(self, name)!r}, but expected a number > 0, finite [{unit}].")
            object.__setattr__(self, name, float(value))
        object.__setattr__(self, "inertia", _inertia(self.inertia))
        for name, kind in (("thrust_line", ThrustLine), ("propeller", Propeller)):
            value = getattr(self, name)
            if isinstance(value, Mapping):
                value = _build(kind, value, name)
            elif value is not None and not isinstance(value, kind):
                raise TypeError(f"Got {type(value).__name__} for {name}, but expected {kind.__name__} or a mapping.")
            object.__setattr__(self, name, value)

    @cached_property
    def inertia_inverse(self) -> np.ndarray:
        """The inverse of the inertia tensor, (3, 3) [1/(kg m^2)]."""
        return np.linalg.inv(self.inertia)

    @property
    def moment_lengths(self) -> Array:
        """Lengths (b, c, b) [m] that go with Cl, Cm, Cn."""
        return np.array([self.span, self.chord, self.span])

    @classmethod
    def from_json(cls, path: str | Path) -> Aircraft:
        """Read the aircraft from a JSON file, or the text of one, whose keys are the parameters of this class."""
        if isinstance(path, str) and path.lstrip().startswith("{"):
            return cls.from_dict(parse_json(path, "the JSON text is not valid"), what="the JSON text")
        return cls.from_dict(read_json(path), what=str(path))

    @classmethod
    def from_toml(cls, path: str | Path) -> Aircraft:
        """Read the aircraft from a TOML file whose keys are the parameters of this class."""
        return cls.from_dict(read_toml(path), what=str(path))

    @classmethod
    def from_dict(cls, values: Mapping, *, what: str = "the aircraft") -> Aircraft:
        """Build the aircraft from a mapping whose keys are the parameters of this class.

        Raises ValueError if a key is missing or unknown (the nearest known one is named), or a value is not valid.
        """
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
            f"Aircraft({self.name!r}, {self.mass:g} kg, S {self.wing_area:g} m^2, b {self.span:g} m, "
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
            f"Got inertia {inertia.tolist()} which is not symmetric: write each product of inertia in both "
            "places, inertia[i][j] = inertia[j][i]."
        )
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0:
        raise ValueError(
            f"Got inertia {inertia.tolist()} which is not positive definite (principal moments "
            f"{moments.round(6).tolist()} kg m^2): the moments on the diagonal must be positive and outweigh "
            "the products off it. Check units (kg m^2) and signs (inertia[0][2] = -Ixz)."
        )
    if moments[2] > (1 + 1e-9) * (moments[0] + moments[1]):
        warnings.warn(
            f"Principal moments of inertia {moments.round(6).tolist()} kg m^2: the largest exceeds the "
            "sum of the others, which no distribution of mass can do. Check the measurement and the signs.",
            stacklevel=4,
        )
    inertia.setflags(write=False)
    return inertia


def _build(kind: type, values: Mapping, what: str) -> Any:
    """Return ``kind(**values)``, with errors that name missing keys and the nearest to unknown ones."""
    if not isinstance(values, Mapping):
        raise ValueError(f"Got {type(values).__name__} in {what}, but expected named values (key: value).")
    known = [field.name for field in fields(kind)]
    for key in values:
        if key not in known:
            near = get_close_matches(str(key), known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys are {known}."
            raise ValueError(f"Got unknown key {key!r} in {what}: {hint}")
    required = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    missing = [name for name in required if name not in values]
    if missing:
        raise ValueError(f"{what} lacks {missing}: got only {sorted(map(str, values))}.")
    return kind(**values)


def _plain(value: Any) -> Any:
    """Return dataclasses as dictionaries without their Nones, arrays and tuples as lists."""
    if hasattr(value, "__dataclass_fields__"):
        items = {field.name: getattr(value, field.name) for field in fields(value)}
        return {key: _plain(item) for key, item in items.items() if item is not None}
    return np.asarray(value).tolist() if isinstance(value, (np.ndarray, tuple)) else value
