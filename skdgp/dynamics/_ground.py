"""Flat ground: contact points of an aircraft, their springs and friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Vector
from skdgp._flight.frames import STANDARD_GRAVITY, cross, rotation_rows
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._rigid_body import ATTITUDE, RATES, VELOCITY


@dataclass(frozen=True)
class GroundSettings:
    """Settings of contact points; places in spans, as no aircraft file has them (guesses)."""

    # Height of the centre of gravity above the ends of the wheels
    height: float = 0.1
    # Main wheels behind the centre of gravity and to either side, nose wheel ahead
    behind: float = 0.04
    aside: float = 0.15
    ahead: float = 0.2
    # Tail behind the centre of gravity
    tail: float = 0.4
    # Compression at rest of wheels, and of the body on one point [m]
    wheel_sink: float = 0.02
    body_sink: float = 0.1
    # Damping ratio of the springs with the mass that rests on them
    damping: float = 0.7
    # Friction coefficients: tyres on a dry runway (Raymer 2018, table 17.1), tyres across and the
    # body (guesses)
    rolling: float = 0.03
    across: float = 0.6
    sliding: float = 0.4
    # Speed [m/s] below which friction is proportional to speed
    creep: float = 0.1


GROUND = GroundSettings()


class Contact(NamedTuple):
    """A point of an aircraft that may touch the ground."""

    name: str
    position: tuple[float, float, float]  #: From the centre of gravity, body axes [m]
    stiffness: float  #: [N/m]
    damping: float  #: [N s/m]
    along: float  #: Friction coefficient along the aircraft
    across: float  #: Friction coefficient across it
    is_wheel: bool


def contact_points(aircraft: Aircraft, settings: GroundSettings = GROUND) -> list[Contact]:
    """Return three wheels, on which an aircraft stands level, and nose, tail and wing tips of its body.

    A nose wheel that turns freely has no friction across. Wheels have the same compression at rest.
    """
    b = aircraft.span
    weight = aircraft.mass * STANDARD_GRAVITY
    nose_share = settings.behind / (settings.behind + settings.ahead)
    main_share = 0.5 * (1.0 - nose_share)
    depth = settings.height * b
    wheels = {
        "nose wheel": (settings.ahead, 0.0, nose_share, settings.rolling),
        "left wheel": (-settings.behind, -settings.aside, main_share, settings.across),
        "right wheel": (-settings.behind, settings.aside, main_share, settings.across),
    }
    body = {
        "nose": (settings.ahead, 0.0),
        "tail": (-settings.tail, 0.0),
        "left tip": (0.0, -0.5),
        "right tip": (0.0, 0.5),
    }
    points = []
    for name, (x, y, share, across) in wheels.items():
        stiffness = share * weight / settings.wheel_sink
        damping = 2.0 * settings.damping * np.sqrt(stiffness * share * aircraft.mass)
        place = (x * b, y * b, depth)
        points.append(Contact(name, place, stiffness, damping, settings.rolling, across, True))
    stiffness = weight / settings.body_sink
    damping = 2.0 * settings.damping * np.sqrt(stiffness * aircraft.mass)
    for name, (x, y) in body.items():
        place = (x * b, y * b, 0.0)
        friction = settings.sliding
        points.append(Contact(name, place, stiffness, damping, friction, friction, False))
    return points


class Ground:
    """Flat ground at an ``altitude`` [m] under an aircraft.

    Attributes
    ----------
    rest : float
        Altitude of the centre of gravity of an aircraft that stands on its wheels [m].
    """

    def __init__(
        self, aircraft: Aircraft, altitude: float, settings: GroundSettings = GROUND
    ) -> None:
        self.altitude = altitude
        self.creep = settings.creep
        _, positions, *numbers, _ = zip(*contact_points(aircraft, settings), strict=True)
        self.positions = np.array(positions)
        self.stiffness, self.damping, self.along, self.across = np.array(numbers)
        self.reach = np.linalg.norm(self.positions, axis=1).max()
        self.rest = altitude + settings.height * aircraft.span - settings.wheel_sink

    def loads(self, state: Vector) -> tuple[Array, Array] | None:
        """Return force and moment (3,) of the ground in body axes [N], [N m], at a state (13,), None in the air."""
        height = -state[2] - self.altitude
        if not height < self.reach:
            return None
        R = np.array(rotation_rows(*state[ATTITUDE].tolist()))
        depth = self.positions @ R[2] - height
        touches = depth > 0.0
        if not touches.any():
            return None
        # velocity of the points, north, east, down
        velocity = (state[VELOCITY] + cross(state[RATES], self.positions)) @ R.T
        pressed = self.stiffness * depth + self.damping * velocity[:, 2]
        normal = np.where(touches, np.maximum(pressed, 0.0), 0.0)
        heading = math.atan2(R[1, 0], R[0, 0])
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        right = np.array([-forward[1], forward[0], 0.0])
        along = -self.along * normal * self._slip(velocity @ forward)
        across = -self.across * normal * self._slip(velocity @ right)
        forces = along[:, None] * forward + across[:, None] * right
        forces[:, 2] -= normal
        in_body = forces @ R
        return in_body.sum(axis=0), cross(self.positions, in_body).sum(axis=0)

    def _slip(self, speed: Vector) -> Vector:
        """Return the fraction (n,) of the largest friction at speeds over the ground (n,)."""
        return np.minimum(np.maximum(speed / self.creep, -1.0), 1.0)
