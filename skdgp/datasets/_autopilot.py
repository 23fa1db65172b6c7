"""Plans, autopilot and actuators of the example flights, of several flights at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.files import read_toml
from skdgp._compute.typing import Array
from skdgp._flight.excitation import Steps, Wavetrain, doublet, multisine, three_two_one_one
from skdgp._flight.frames import STANDARD_GRAVITY, wrapped
from skdgp.datasets._brumby import PROPELLER

COMMANDS = ("elevator", "aileron", "rudder", "throttle")


# Trim and limits of the Brumby [rad], chosen: alpha, and elevator, aileron, rudder and throttle, in
# straight level flight
ALPHA = 0.085
TRIM = (-0.04, -0.007, 0.0, 0.63)
BANK_LIMIT = 0.70
ELEVON_LIMIT = 0.42
RUDDER_LIMIT = 0.35
# lags of left and right elevon, rudder and propeller [s]
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])
# distance [m] from the orbit at which the wanted course still cuts it at 45 degrees
CAPTURE_DISTANCE = 170.0


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    steps = np.asarray(steps)
    last = np.searchsorted(steps[:, 0], time, side="right") - 1
    return steps[np.maximum(last, 0), 1:]


class FlightControls:
    """Controls of several flights as a function of step, stage and measured values, for `fly_record`.

    At the beginning of each step the commands of proportional-integral loops for attitude, altitude
    and airspeed, and the manoeuvres, are added to targets, which the actuators approach as exact
    first-order lags.
    """

    def __init__(self, plans: tuple[FlightPlan, ...], time: np.ndarray, step: float):
        goals = np.stack([_goals(plan, time) for plan in plans], axis=1)
        self.orbit = goals[..., :3]
        self.altitude = goals[..., 3]
        self.airspeed = goals[..., 4]
        manoeuvres = [_manoeuvres(plan, time) for plan in plans]
        self.manoeuvres = np.stack(manoeuvres, axis=1)
        self.integrals: dict[str, Array] = {}
        self.step = step
        self.now = -1
        trim = np.tile(TRIM, (len(plans), 1))
        self.end, _ = _targets(trim)

    def __call__(
        self, k: int, stage: int, observe: Callable[[], Mapping[str, Array]]
    ) -> dict[str, Array]:
        """Return the controls (n_flights,) by name at a stage, two to a step."""
        if k != self.now:
            self.now = k
            self.begin = self.end
            command = self._command(observe(), k)
            self.target, self.throttle = _targets(self.manoeuvres[k] + command)
        half_steps = stage - 2 * k
        positions = self.begin
        if half_steps:
            seconds = 0.5 * half_steps * self.step
            lag = np.exp(-seconds / TIME_CONSTANTS)
            positions = self.target + lag * (self.begin - self.target)
        if half_steps == 2:
            self.end = positions
        left, right, rudder, propeller_speed = positions.T
        return {
            "throttle": self.throttle,
            "elevator": 0.5 * (left + right),
            "aileron": 0.5 * (left - right),
            "rudder": rudder,
            "elevon_left": left,
            "elevon_right": right,
            "propeller_speed": propeller_speed,
        }

    def _integral(self, name: str, rate: Array, limit: float) -> Array:
        """Return the limited integral of a loop after this step."""
        total = self.integrals.get(name, 0.0) + rate * self.step
        self.integrals[name] = np.clip(total, -limit, limit)
        return self.integrals[name]

    def _command(self, sensed: Mapping[str, Array], k: int) -> Array:
        """Return elevator, aileron, rudder and throttle (n_flights, 4) of a step for ``sensed`` channels by name.

        Orbits (n_flights, 3) hold the centre's north, east and the radius [m], negative to turn left.
        """
        speed = sensed["airspeed"]
        climb = np.clip(0.35 * (self.altitude[k] - sensed["altitude"]), -3.0, 4.0)
        elevator = self._elevator(sensed, climb)
        aileron = self._aileron(sensed, self.orbit[k])
        rudder = _rudder(sensed)
        error = self.airspeed[k] - speed
        integral = self._integral("speed", 0.02 * error, 0.3)
        throttle = 0.08 * error + 0.06 * climb + integral
        return TRIM + np.stack((elevator, aileron, rudder, throttle), axis=-1)

    def _elevator(self, sensed: Mapping[str, Array], climb: Array) -> Array:
        """Return the addition to the elevator for a rate of climb [m/s]: > 0 pitches down."""
        speed = sensed["airspeed"]
        phi = sensed["phi"]
        level = np.cos(phi)
        error = climb + sensed["v_down"]
        integral = self._integral("climb", 0.010 * error, 0.10)
        steady = ALPHA / level + climb / speed
        pitch = steady + 0.012 * error + integral
        pitch_rate = STANDARD_GRAVITY * np.sin(phi) ** 2 / (level * speed)
        damping = 0.12 * (sensed["q"] - pitch_rate)
        in_turn = 0.03 * (1.0 / level - 1.0)
        return -0.30 * (pitch - sensed["theta"]) + damping - in_turn

    def _aileron(self, sensed: Mapping[str, Array], orbit: Array) -> Array:
        """Return the addition to the aileron that follows the orbit."""
        error = _bank(sensed, orbit) - sensed["phi"]
        integral = self._integral("roll", 0.01 * error, 0.05)
        aileron = 0.085 * error - 0.022 * sensed["p"] + integral
        return np.clip(aileron, -0.12, 0.12)


def _goals(plan: FlightPlan, time: Array) -> Array:
    """Return the orbit, the altitude and the airspeed of a plan at each time, (n, 5)."""
    schedules = (plan.orbits, plan.altitudes, plan.airspeeds)
    return np.column_stack([scheduled(steps, time) for steps in schedules])


def _manoeuvres(plan: FlightPlan, time: Array) -> Array:
    """Return the additions to the commands (n, 4)."""
    return np.column_stack([plan.manoeuvres(axis, time) for axis in COMMANDS])


def _targets(command: Array) -> tuple[Array, Array]:
    """Return where the actuators go (n, 4), elevons, rudder, propeller, and the throttle (n,), mixed and limited."""
    elevator, aileron, rudder, throttle = command.T
    throttle = np.clip(throttle, 0.0, 1.0)
    most = ELEVON_LIMIT
    left = np.clip(elevator + aileron, -most, most)
    right = np.clip(elevator - aileron, -most, most)
    most = RUDDER_LIMIT
    rudder = np.clip(rudder, -most, most)
    propeller_speed = PROPELLER.speed_at(throttle)
    return np.stack([left, right, rudder, propeller_speed], axis=-1), throttle


def _rudder(sensed: Mapping[str, Array]) -> Array:
    """Return the addition to the rudder that coordinates a turn."""
    across = np.sin(sensed["phi"]) * np.cos(sensed["theta"])
    turn_rate = STANDARD_GRAVITY * across / sensed["airspeed"]
    return 0.22 * (sensed["r"] - turn_rate) - 0.10 * sensed["beta"]


def _bank(sensed: Mapping[str, Array], orbit: Array) -> Array:
    """Return the bank that follows the vector field around the orbit (Beard & McLain 2012, section 10.2)."""
    center_north, center_east, signed_radius = orbit.T
    north = sensed["north"] - center_north
    east = sensed["east"] - center_east
    radius = np.abs(signed_radius)
    turn = np.sign(signed_radius)
    distance = np.hypot(north, east) - radius
    off = distance / CAPTURE_DISTANCE
    bearing = np.arctan2(east, north)
    wanted = bearing + turn * (0.5 * np.pi + np.arctan(off))
    v_north = sensed["v_north"]
    v_east = sensed["v_east"]
    course = np.arctan2(v_east, v_north)
    error = wrapped(wanted - course)
    # of a steady turn on the orbit
    centripetal = (v_north**2 + v_east**2) / radius
    steady = np.arctan(centripetal / STANDARD_GRAVITY)
    ahead = turn * steady * np.exp(-0.5 * off**2)
    limit = BANK_LIMIT
    return np.clip(ahead + 1.2 * error, -limit, limit)


WAVES: dict[str, Callable[..., Any]] = {
    "doublet": doublet,
    "3-2-1-1": three_two_one_one,
    "multisine": multisine,
    "steps": Steps,
}


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    # (from time [s], centre north, centre east, radius [m]); a negative radius turns left
    orbits: list[list[float]]
    # (from time [s], altitude [m])
    altitudes: list[list[float]]
    # (from time [s], airspeed [m/s])
    airspeeds: list[list[float]]
    # mean velocity of the air, NED [m/s]
    wind: list[float]
    # wind near the ground [m/s], which sets the turbulence
    wind_at_6m: float
    # additions to elevator, aileron, rudder [rad] and throttle
    manoeuvres: Wavetrain

    @classmethod
    def of(cls, plan: Mapping[str, Any]) -> FlightPlan:
        """Return the plan of a table of the file."""
        inputs = {}
        for axis, entries in plan["manoeuvres"].items():
            inputs[axis] = {entry["start"]: _wave(**entry) for entry in entries}
        return cls(**{**plan, "manoeuvres": Wavetrain(inputs)})


def _wave(wave: str, start: float, **parameters: Any) -> Any:
    """Return an input by its kind and parameters."""
    if wave == "multisine":
        parameters["harmonics"] = range(*parameters["harmonics"])
    return WAVES[wave](**parameters)


PLANS = read_toml(Path(__file__).with_name("example_flights.toml"))["flights"]
FLIGHT_PLANS = tuple(FlightPlan.of(plan) for plan in PLANS)
