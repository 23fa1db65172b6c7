"""Propeller and thrust line: thrust and torque of the engine, given or usual of a size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.frames import SEA_LEVEL_DENSITY, cross
from skdgp._flight.tables import check_choice, check_number, check_numbers

# Fit of thrust and torque of propellers of two blades to diameter and pitch: least squares of the wind-tunnel
# data of 178 propellers (UIUC Propeller Data Site, volumes 1 to 3; Brandt & Selig, AIAA 2011-1255), 20,098
# points, each propeller with the same weight. c_0, c_1, c_2 of C_T and C_Q, each of 1 and pitch / diameter
USUAL_THRUST = np.array([(0.0479, 0.0923), (-0.136, 0.1233), (-0.1036, 0.0)])
USUAL_TORQUE = np.array([(-0.0017, 0.0158), (-0.0016, 0.0057), (-0.0118, 0.0)])
# Relative error of the thrust of propellers whose family is not in the fit, root mean square, at advance
# ratios of 0.4 to 0.9 times pitch / diameter; of the torque 0.13. Towards zero thrust it grows.
USUAL_STD = 0.23
# Ranges of the data: diameter [m], pitch / diameter
DIAMETERS = (0.17, 0.49)
PITCH_RATIOS = (0.35, 1.1)
# Speed at full throttle over the speed of the motor without load, and the standard deviation of the thrust by
# its 0.1, which goes with about its third power in flight; guesses
LOADED_SPEED = 0.75
LOADED_STD = 0.35


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
    speed_range: Sequence[float] | None = None
    load_std: float = 0.0

    def __post_init__(self):
        check_choice("rotation", self.rotation, (1, -1))
        thrust = check_numbers("thrust_coefficients", self.thrust_coefficients, 1, 2, 3)
        torque = check_numbers("torque_coefficients", self.torque_coefficients, 0, 1, 2, 3)
        checked: dict[str, Any] = {
            "diameter": check_number("diameter", self.diameter, unit="m"),
            "load_std": check_number("load_std", self.load_std, is_open=False),
            "thrust_coefficients": tuple(thrust.tolist()),
            "torque_coefficients": tuple(torque.tolist()),
        }
        if self.speed_range is not None:
            idle, full = check_numbers("speed_range", self.speed_range, 2).tolist()
            if not 0 <= idle < full:
                raise ValueError(
                    f"Got speed_range={self.speed_range!r}, but expected 0 <= idle < full [rad/s]."
                )
            checked["speed_range"] = (idle, full)
        vars(self).update(checked)

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
        load = self._load(self.torque_coefficients, 5, propeller_speed, airspeed, density)
        return -self.rotation * load

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

        .. math:: C_T = 0.048 + 0.092 x - (0.136 - 0.123 x) J - 0.104 J^2, \quad
            C_Q = -0.0017 + 0.0158 x - (0.0016 - 0.0057 x) J - 0.0118 J^2;

        the thrust of others is 23 % off, root mean square. Raises ValueError if a
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
        _warn_beyond("diameter [m]", diameter, DIAMETERS)
        _warn_beyond("pitch / diameter", ratio, PITCH_RATIOS)
        speed_range = None
        std = USUAL_STD
        if motor_constant is not None or voltage is not None:
            constant = check_number("motor_constant", motor_constant, unit="rad/s/V")
            unloaded = constant * check_number("voltage", voltage, unit="V")
            speed_range = (0.0, LOADED_SPEED * unloaded)
            std = round(float(np.hypot(USUAL_STD, LOADED_STD)), 2)
        thrust = (USUAL_THRUST @ [1.0, ratio]).tolist()
        torque = (USUAL_TORQUE @ [1.0, ratio]).tolist()
        return cls(
            diameter, thrust, torque, rotation=rotation, speed_range=speed_range, load_std=std
        )

    def _load(
        self,
        coefficients: Sequence[float],
        power: int,
        propeller_speed: ArrayLike,
        airspeed: ArrayLike,
        density: ArrayLike,
    ) -> Array:
        # n^2 C(V / n D) multiplied out, which stays finite at n = 0
        n = np.asarray(propeller_speed, dtype=float) / (2.0 * np.pi)
        advance = np.asarray(airspeed, dtype=float) / self.diameter
        c0, c1, c2 = (*coefficients, 0.0, 0.0, 0.0)[:3]
        load = (c0 * n + c1 * advance) * n + c2 * advance * advance
        return np.asarray(density, dtype=float) * self.diameter**power * load


def _warn_beyond(name: str, value: float, measured: tuple[float, float]) -> None:
    """Warn of a size outside the range of the propellers that were measured."""
    low, high = measured
    if not low <= value <= high:
        warn(
            f"Got a propeller with {name} {value:.2g}, but its thrust is estimated from others with "
            f"{low:g} to {high:g}: its error may be larger than stated."
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
        position = check_numbers("thrust-line position", self.position, 3)
        direction = check_numbers("thrust-line direction", self.direction, 3)
        length = np.linalg.norm(direction)
        if length == 0:
            raise ValueError(
                "Got a thrust direction of length zero, but expected one such as (1, 0, 0)."
            )
        direction = direction / length
        position.setflags(write=False)
        direction.setflags(write=False)
        vars(self).update(position=position, direction=direction)

    @cached_property
    def lever(self) -> Array:
        """The moment of a unit force, r_T x d, (3,) [m]."""
        return cross(self.position, self.direction)

    def loads(self, thrust: ArrayLike, torque: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return force (..., 3) [N] and moment (..., 3) [N m] about the centre of gravity.

        F_T = T d and M_T = r_T x F_T + Q d, with ``thrust`` T [N] and ``torque`` Q [N m] on the
        aircraft about the line's direction d (a propeller turning clockwise seen from behind gives
        Q < 0).
        """
        T = np.asarray(thrust, dtype=float)[..., None]
        Q = np.asarray(torque, dtype=float)[..., None]
        force = T * self.direction
        moment = T * self.lever + Q * self.direction
        return force, moment
