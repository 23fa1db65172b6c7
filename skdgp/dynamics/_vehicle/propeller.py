"""Propeller thrust and torque as functions of propeller speed, airspeed and density."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._flight.checks import check_columns, check_table

__all__ = ["Propeller"]

SEA_LEVEL_DENSITY = 1.225


@dataclass(frozen=True)
class Propeller:
    r"""A fixed-pitch propeller: thrust and torque from its advance ratio.

    With n = Omega / 2 pi the revolutions per second, D the diameter and J = V / (n D) the advance ratio,

        T = rho n^2 D^4 C_T(J),   Q = rho n^2 D^5 C_Q(J),   C(J) = c_0 + c_1 J + c_2 J^2.

    Polynomials of degree 2 at most keep both finite when the propeller stands still in the wind.

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
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _numbers([getattr(self, name)], name)[0])
        if self.diameter is None or not 0 < self.diameter < np.inf:
            raise ValueError(f"Got propeller diameter {self.diameter!r}, but expected a number > 0 [m].")
        if self.rotation not in (1, -1):
            raise ValueError(f"Got rotation={self.rotation!r}, but expected 1 (clockwise seen from behind) or -1.")
        for name, least in (("thrust_coefficients", 1), ("torque_coefficients", 0)):
            values = _numbers(getattr(self, name), name)
            if not (least <= len(values) <= 3 and np.isfinite(values).all()):
                raise ValueError(
                    f"Got {name}={values}, but expected {least} to 3 finite numbers c_0, c_1, c_2 of "
                    "C(J) = c_0 + c_1 J + c_2 J^2."
                )
            object.__setattr__(self, name, values)
        if self.max_advance_ratio is not None and not 0 < self.max_advance_ratio < np.inf:
            raise ValueError(f"Got max_advance_ratio={self.max_advance_ratio!r}, but expected a finite number > 0.")
        if self.speed_range is not None:
            speeds = _numbers(self.speed_range, "speed_range")
            if not (len(speeds) == 2 and 0 <= speeds[0] < speeds[1] < np.inf):
                raise ValueError(f"Got speed_range={speeds}, but expected 0 <= idle < full [rad/s].")
            object.__setattr__(self, "speed_range", speeds)

    def speed_at(self, throttle: ArrayLike) -> np.ndarray:
        """Return the propeller speed [rad/s] at ``throttle``, 0 to 1; ``speed_range`` must be known."""
        if self.speed_range is None:
            raise ValueError("Got a propeller without speed_range: give (idle, full) [rad/s], or propeller_speed.")
        idle, full = self.speed_range
        return idle + (full - idle) * np.asarray(throttle, dtype=float)

    def thrust(
        self, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike = SEA_LEVEL_DENSITY
    ) -> np.ndarray:
        """Return the thrust [N] at propeller speed [rad/s], airspeed [m/s], density [kg/m^3]."""
        return self._load(self.thrust_coefficients, 4, propeller_speed, airspeed, density)

    def torque(
        self, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike = SEA_LEVEL_DENSITY
    ) -> np.ndarray:
        """Return the torque [N m] ON THE AIRCRAFT about the thrust direction (opposite to the rotation)."""
        return -self.rotation * self._load(self.torque_coefficients, 5, propeller_speed, airspeed, density)

    def advance_ratio(self, propeller_speed: ArrayLike, airspeed: ArrayLike) -> np.ndarray:
        """Return J = V / (n D) = 2 pi V / (Omega D), infinite where the propeller stands still."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 2.0 * np.pi * np.asarray(airspeed, float) / (np.asarray(propeller_speed, float) * self.diameter)

    @classmethod
    def from_table(
        cls,
        table: pd.DataFrame,
        diameter: float,
        *,
        degree: int = 2,
        pitch: float | None = None,
        rotation: int = 1,
    ) -> Propeller:
        """Fit the propeller to a bench table by least squares in newtons.

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
            Geometric pitch [m] (a "20 x 10" propeller: 10 inches). For a static table it stands in for the
            missing airspeeds: C_T = c_0 (1 - J D / pitch), zero where the blades screw through the air
            without slip. A rule of thumb: true zero-thrust advance ratios often lie somewhat higher.
        rotation : {1, -1}
            1 turns clockwise seen from behind.

        Warns
        -----
        UserWarning
            If the table is static and no pitch is given: thrust in flight is then overstated.

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
                UserWarning,
                stacklevel=2,
            )
        basis = _basis(speed, airspeed, density, diameter, 0 if static else degree)

        def fit(load: str, power: int) -> np.ndarray:
            target = table[load].to_numpy(float) / diameter**power
            coefficients = np.linalg.lstsq(basis, target, rcond=None)[0]
            if static and pitch is not None and load == "thrust":
                coefficients = np.append(coefficients, -coefficients * diameter / pitch)
            return coefficients

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

    def _load(self, coefficients, power, propeller_speed, airspeed, density) -> np.ndarray:
        # n^2 C(V / n D) multiplied out, which stays finite at n = 0.
        n = np.asarray(propeller_speed, dtype=float) / (2.0 * np.pi)
        advance = np.asarray(airspeed, dtype=float) / self.diameter
        c0, c1, c2 = (*coefficients, 0.0, 0.0, 0.0)[:3]
        return np.asarray(density, float) * self.diameter**power * ((c0 * n + c1 * advance) * n + c2 * advance**2)


def _numbers(values, name: str) -> tuple[float, ...]:
    try:
        return tuple(np.nan if isinstance(value, bool) else float(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"Got {name}={values!r} of a propeller, but expected numbers.") from None


def _basis(speed, airspeed, density, diameter, degree) -> np.ndarray:
    n, advance = speed / (2.0 * np.pi), airspeed / diameter
    return np.stack([density * n ** (2 - k) * advance**k for k in range(degree + 1)], axis=-1)


def _check_bench(speed, airspeed, density, thrust) -> None:
    if not (np.isfinite(speed) & np.isfinite(airspeed) & np.isfinite(density) & np.isfinite(thrust)).all():
        raise ValueError("Got NaN or infinite values in the bench table: drop those rows.")
    if (speed <= 0).any() or (airspeed < 0).any() or (density <= 0).any():
        raise ValueError(
            "Got a bench table with propeller_speed <= 0, airspeed < 0 or density <= 0, but expected "
            "rad/s > 0, m/s >= 0 and kg/m^3 > 0: drop those rows or fix the units."
        )
