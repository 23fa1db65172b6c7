"""Engines: propeller, thrust line, measured thrust."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator

from skdgp._compute.typing import Array
from skdgp._flight.atmosphere import SEA_LEVEL_DENSITY, standard_density
from skdgp._flight.checks import check_columns, check_names, check_table


def as_floats(values: Any) -> Array:
    """Return values as floats; a single NaN if one is a truth value or no number."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.array(np.nan)
    is_bool = any(isinstance(value, bool) for value in np.ravel(np.array(values, dtype=object)))
    return np.array(np.nan) if is_bool else array


@dataclass(frozen=True)
class Propeller:
    r"""A fixed-pitch propeller: thrust and torque from its advance ratio.

    With n = Omega / 2 pi the revolutions per second, D the diameter and J = V / (n D) the advance ratio,

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
        1 turns clockwise seen from behind, and its torque rolls the aircraft left; -1 the other way.
    max_advance_ratio : float, optional
        Largest advance ratio that was measured; flights beyond it get a warning.
    speed_range : pair of float, optional
        Propeller speeds [rad/s] at throttle 0 and 1, in proportion between them: with it throttle is a control.

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

    def __post_init__(self):
        for name in ("diameter", "max_advance_ratio"):
            value = getattr(self, name)
            if value is None and name == "max_advance_ratio":
                continue
            number = as_floats(value)
            if number.shape != () or not 0 < number < np.inf:
                raise ValueError(f"Got {name}={value!r} of a propeller, but expected a finite number > 0.")
            object.__setattr__(self, name, float(number))
        if self.rotation not in (1, -1):
            raise ValueError(f"Got rotation={self.rotation!r}, but expected 1 (clockwise seen from behind) or -1.")
        for name, least in (("thrust_coefficients", 1), ("torque_coefficients", 0)):
            values = as_floats(getattr(self, name))
            if values.ndim != 1 or not (least <= len(values) <= 3 and np.isfinite(values).all()):
                raise ValueError(
                    f"Got {name}={getattr(self, name)!r} of a propeller, but expected {least} to 3 finite numbers c_0, "
                    "c_1, c_2 of C(J) = c_0 + c_1 J + c_2 J^2."
                )
            object.__setattr__(self, name, tuple(values.tolist()))
        if self.speed_range is not None:
            speeds = as_floats(self.speed_range)
            if speeds.shape != (2,) or not 0 <= speeds[0] < speeds[1] < np.inf:
                raise ValueError(f"Got speed_range={self.speed_range!r}, but expected 0 <= idle < full [rad/s].")
            object.__setattr__(self, "speed_range", tuple(speeds.tolist()))

    def speed_at(self, throttle: ArrayLike) -> Array:
        """Return the propeller speed [rad/s] at ``throttle``, 0 to 1; ``speed_range`` must be known."""
        if self.speed_range is None:
            raise ValueError("Got a propeller without speed_range: give (idle, full) [rad/s], or propeller_speed.")
        idle, full = self.speed_range
        return idle + (full - idle) * np.asarray(throttle, dtype=float)

    def thrust(self, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike = SEA_LEVEL_DENSITY) -> Array:
        """Return the thrust [N] at propeller speed [rad/s], airspeed [m/s], density [kg/m^3]."""
        return self._load(self.thrust_coefficients, 4, propeller_speed, airspeed, density)

    def torque(self, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike = SEA_LEVEL_DENSITY) -> Array:
        """Return the torque [N m] ON THE AIRCRAFT about the thrust direction (opposite to the rotation)."""
        return -self.rotation * self._load(self.torque_coefficients, 5, propeller_speed, airspeed, density)

    def advance_ratio(self, propeller_speed: ArrayLike, airspeed: ArrayLike) -> np.ndarray:
        """Return J = V / (n D) = 2 pi V / (Omega D), infinite where the propeller stands still."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 2.0 * np.pi * np.asarray(airspeed, float) / (np.asarray(propeller_speed, float) * self.diameter)

    @classmethod
    def from_table(
        cls, table: pd.DataFrame, diameter: float, *, degree: int = 2, pitch: float | None = None, rotation: int = 1
    ) -> Propeller:
        """Fit the propeller to a bench table by least squares in newtons.

        Warns if the table is static and no pitch is given: thrust in flight is then overstated.

        Parameters
        ----------
        table : pandas.DataFrame
            Columns ``propeller_speed`` [rad/s] and ``thrust`` [N]; where measured also ``airspeed`` [m/s]
            (a static bench has none), ``density`` [kg/m^3] (else 1.225) and ``torque`` [N m].
        diameter : float
            D [m].
        degree : {0, 1, 2}
            Degree of C_T(J) and C_Q(J). A static table determines degree 0 only.
        pitch : float, optional
            Geometric pitch [m] (a "20 x 10" propeller: 10 inches). For a static table it replaces the missing
            airspeeds: C_T = c_0 (1 - J D / pitch), zero where the blades do not slip. This is a rule of thumb:
            true zero-thrust advance ratios are often somewhat higher.
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
        check_columns(check_table(table, what="bench table"), ["propeller_speed", "thrust"], what="bench table")
        if degree not in (0, 1, 2):
            raise ValueError(f"Got degree={degree!r}, but expected 0, 1 or 2.")
        speed = table["propeller_speed"].to_numpy(float)
        airspeed = table["airspeed"].to_numpy(float) if "airspeed" in table else np.zeros_like(speed)
        density = table["density"].to_numpy(float) if "density" in table else np.full_like(speed, SEA_LEVEL_DENSITY)
        _check_bench(speed, airspeed, density, table["thrust"].to_numpy(float))
        static = not (airspeed > 0).any()
        if static and pitch is None:
            warnings.warn(
                "The bench table holds no airspeed > 0, so it determines the static thrust only, and thrust "
                "in flight would be overstated. Add rows measured in a wind tunnel, or give pitch=... [m] to "
                "let the thrust fall to zero at the advance ratio pitch / diameter.",
                stacklevel=2,
            )
        basis = _basis(speed, airspeed, density, diameter, 0 if static else degree)

        def fit(load: str, power: int) -> list[float]:
            target = table[load].to_numpy(float) / diameter**power
            coefficients = np.linalg.lstsq(basis, target, rcond=None)[0]
            if static and pitch is not None and load == "thrust":
                coefficients = np.append(coefficients, -coefficients * diameter / pitch)
            return coefficients.tolist()

        if np.linalg.matrix_rank(basis) < basis.shape[1]:
            raise ValueError(
                f"The bench table's {len(table)} rows do not determine a C_T(J) of degree {degree}: measure "
                f"at {degree + 1} or more advance ratios, or lower degree."
            )
        return cls(
            diameter=diameter,
            thrust_coefficients=fit("thrust", 4),
            torque_coefficients=fit("torque", 5) if "torque" in table else (),
            rotation=rotation,
            max_advance_ratio=None if static else float(np.max(2 * np.pi * airspeed / (speed * diameter))),
        )

    def _load(
        self,
        coefficients: Sequence[float],
        power: int,
        propeller_speed: ArrayLike,
        airspeed: ArrayLike,
        density: ArrayLike,
    ) -> Array:
        # n^2 C(V / n D) multiplied out, which stays finite at n = 0.
        n = np.asarray(propeller_speed, dtype=float) / (2.0 * np.pi)
        advance = np.asarray(airspeed, dtype=float) / self.diameter
        c0, c1, c2 = (*coefficients, 0.0, 0.0, 0.0)[:3]
        return np.asarray(density, float) * self.diameter**power * ((c0 * n + c1 * advance) * n + c2 * advance**2)


def _basis(speed: Array, airspeed: Array, density: Array, diameter: float, degree: int) -> Array:
    n, advance = speed / (2.0 * np.pi), airspeed / diameter
    return np.stack([density * n ** (2 - k) * advance**k for k in range(degree + 1)], axis=-1)


def _check_bench(speed: Array, airspeed: Array, density: Array, thrust: Array) -> None:
    if not (np.isfinite(speed) & np.isfinite(airspeed) & np.isfinite(density) & np.isfinite(thrust)).all():
        raise ValueError("Got NaN or infinite values in the bench table: drop those rows.")
    if (speed <= 0).any() or (airspeed < 0).any() or (density <= 0).any():
        raise ValueError(
            "Got a bench table with propeller_speed <= 0, airspeed < 0 or density <= 0, but expected "
            "rad/s > 0, m/s >= 0 and kg/m^3 > 0: drop those rows or fix the units."
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
    An engine .2 m above the centre of gravity pitches the nose down:

    >>> from skdgp.dynamics import ThrustLine
    >>> force, moment = ThrustLine(position=(-0.5, 0.0, -0.2), direction=(1, 0, 0)).loads(100.0)
    >>> force.tolist(), moment.tolist()
    ([100.0, 0.0, 0.0], [0.0, -20.0, 0.0])
    """

    position: Any = (0.0, 0.0, 0.0)
    direction: Any = (1.0, 0.0, 0.0)

    _arm: ClassVar[Any]
    """Moment of one newton [m]."""

    def __post_init__(self):
        for name in ("position", "direction"):
            vector = as_floats(getattr(self, name))
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise ValueError(
                    f"Got thrust-line {name} {getattr(self, name)!r}, but expected three finite numbers (x, y, z)."
                )
            object.__setattr__(self, name, vector)
        length = np.linalg.norm(self.direction)
        if length == 0:
            raise ValueError("Got a thrust direction of length zero, but expected one such as (1, 0, 0).")
        object.__setattr__(self, "direction", self.direction / length)
        object.__setattr__(self, "_arm", np.cross(self.position, self.direction))
        for vector in (self.position, self.direction):
            vector.setflags(write=False)

    def loads(self, thrust: ArrayLike, torque: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return force (..., 3) [N] and moment (..., 3) [N m] about the centre of gravity.

        F_T = T d and M_T = r_T x F_T + Q d, with ``thrust`` T [N] and ``torque`` Q [N m] on the aircraft
        about the line's direction d (a propeller turning clockwise seen from behind gives Q < 0).
        """
        T, Q = (np.asarray(load, dtype=float)[..., None] for load in (thrust, torque))
        return T * self.direction, T * self._arm + Q * self.direction


class ThrustTable:
    """Thrust of an engine, interpolated linearly in a table: for ``simulate(thrust=...)``.

    T = T(throttle, V) rho / rho_0, constant beyond the edges of the table, with rho_0 the density at the bench.

    Parameters
    ----------
    throttle : array-like of shape (n,)
        Increasing, 0 to 1.
    airspeed : array-like of shape (m,)
        Increasing [m/s]; one alone: thrust does not depend on it.
    thrust : array-like of shape (n, m)
        [N].
    density : float or None, default=None
        Of the bench [kg/m^3]; None: the standard one at sea level.
    follows_density : bool, default=True
        Whether thrust goes with the density, as that of propellers and jets does.

    Examples
    --------
    >>> from skdgp.dynamics import ThrustTable
    >>> engine = ThrustTable(throttle=[0.0, 0.5, 1.0], airspeed=[0.0, 30.0], thrust=[[0, -5], [60, 25], [140, 80]])
    >>> engine({"throttle": 0.75}, airspeed=15.0, density=1.225).round(2)
    np.float64(76.25)
    """

    def __init__(
        self,
        throttle: ArrayLike,
        airspeed: ArrayLike,
        thrust: ArrayLike,
        *,
        density: float | None = None,
        follows_density: bool = True,
    ) -> None:
        self.throttle, self.airspeed, self.thrust = (np.asarray(x, dtype=float) for x in (throttle, airspeed, thrust))
        for name, grid in (("throttle", self.throttle), ("airspeed", self.airspeed)):
            if grid.ndim != 1 or not len(grid) or not np.isfinite(grid).all() or not (np.diff(grid) > 0).all():
                raise ValueError(f"Got {name}={grid.tolist()}, but expected finite numbers that increase.")
        expected = (len(self.throttle), len(self.airspeed))
        if self.thrust.shape != expected or not np.isfinite(self.thrust).all():
            raise ValueError(
                f"Got thrust of shape {self.thrust.shape}, but expected finite numbers, {expected}: a row for each "
                "throttle, a column for each airspeed [N]."
            )
        self.density = float(standard_density(0.0)) if density is None else float(density)
        self.follows_density = follows_density
        axes = [
            axis if len(axis) > 1 else np.array([axis[0], axis[0] + 1.0]) for axis in (self.throttle, self.airspeed)
        ]
        values = np.tile(self.thrust, [1 if len(axis) > 1 else 2 for axis in (self.throttle, self.airspeed)])
        self._low, self._high = (np.array([axis[k] for axis in axes]) for k in (0, -1))
        self._interpolated = RegularGridInterpolator(axes, values)

    @classmethod
    def from_table(cls, table: pd.DataFrame, **options: Any) -> ThrustTable:
        """Return the engine of a bench table with the columns throttle, airspeed and thrust, a row for each point.

        Raises ValueError if the points are not a full grid: every throttle at every airspeed, once.
        """
        check_columns(check_table(table, what="bench table"), ["throttle", "airspeed", "thrust"], what="bench table")
        if table.duplicated(["throttle", "airspeed"]).any():
            raise ValueError("Got a bench table with a point twice, but expected each throttle and airspeed once.")
        grid = table.pivot(index="throttle", columns="airspeed", values="thrust").sort_index().sort_index(axis=1)
        if grid.isna().any(axis=None):
            raise ValueError(
                f"Got a bench table of {len(table)} points, but expected a full grid of {grid.shape[0]} throttles times"
                f" {grid.shape[1]} airspeeds."
            )
        return cls(grid.index, grid.columns, grid.to_numpy(), **options)

    def __call__(self, controls: Mapping, airspeed: ArrayLike, density: ArrayLike) -> Array:
        """Return the thrust [N] at ``controls["throttle"]``, airspeed [m/s] and density [kg/m^3]."""
        check_names(["throttle"], controls, "controls")
        points = np.stack(np.broadcast_arrays(np.asarray(controls["throttle"], float), airspeed), axis=-1)
        fine = np.isfinite(points).all(axis=-1, keepdims=True)
        clipped = np.clip(np.where(fine, points, self._low), self._low, self._high)
        thrust = self._interpolated(clipped.reshape(-1, 2)).reshape(clipped.shape[:-1])
        thrust = np.where(fine[..., 0], thrust, np.nan)
        return thrust * (np.asarray(density) / self.density) if self.follows_density else thrust
