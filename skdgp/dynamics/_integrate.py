"""Integration of the motion in time: one step of Runge and Kutta under commands, the loop over time, its record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, BODY_VELOCITY, EARTH_VELOCITY, EULER
from skdgp._flight.channels import POSITION as POSITION_NAMES
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.faults import POSSIBLE
from skdgp._flight.frames import (
    air_data,
    body_to_ned,
    by_components,
    ned_to_body,
    quaternion_to_euler,
)
from skdgp._flight.tables import by_name
from skdgp.dynamics._air import AirAt, LocalAir
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._rigid_body import (
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    rk4_step,
)
from skdgp.dynamics._servos import Ramp

# From a stage of a step, 0, 1 or 2, and states to the air, the commands and the drift there
Inputs: TypeAlias = "Callable[[int, Array], tuple[LocalAir, dict, Any]]"
FLYING = ""
REASONS = {
    "airspeed": "airspeed under 1 m/s",
    "altitude": "outside of the atmosphere",
    "diverged": "diverged",
}


# Airspeed [m/s] below which there is no angle of attack
LEAST_AIRSPEED = 1.0
# Velocity [m/s], attitude and rates [rad/s] beyond which a trajectory has diverged
FASTEST = np.repeat([POSSIBLE["u"][1], np.inf, POSSIBLE["p"][1]], [3, 4, 3])
# Largest state within a step: coefficients of any more may not be evaluated
STAGE_LIMIT = 1e9


def channels(states: Array, wind: Array | None = None) -> dict[str, Array]:
    """Return the columns of the vocabulary that follow from states (..., 13) in a ``wind`` (..., 3), each (...)."""
    attitude = states[..., ATTITUDE]
    velocity = states[..., VELOCITY]
    through_air = velocity if wind is None else velocity - ned_to_body(attitude, wind)
    return {
        **by_name(POSITION_NAMES, states[..., POSITION]),
        **by_name(EARTH_VELOCITY, body_to_ned(attitude, velocity)),
        **by_name(BODY_VELOCITY, velocity),
        **by_name(EULER, quaternion_to_euler(attitude)),
        **by_name(RATE_NAMES, states[..., RATES]),
        **dict(zip(AIR_DATA, air_data(through_air), strict=True)),
        "altitude": -states[..., 2],
    }


class Integrator:
    """Integration of a motion in time, step by step.

    A step has three stages: its beginning, its middle and its end, which is the beginning of the next step.

    Parameters
    ----------
    motion : Motion
    state : array (..., 13)
        At the start.
    dt : float
        Time step [s].

    Attributes
    ----------
    state : array (..., 13)
    now : Instant
        At the last stage, which is nearly the end of the last step.
    controls : dict
        At the beginning of the last step, with the deflections of the surfaces.
    wind : array (..., 3) or None
        At the beginning of the last step.
    """

    def __init__(self, motion: Motion, state: Array, dt: float) -> None:
        self.motion = motion
        self.state = by_components(state)
        self.dt = dt
        self.now: Any = None
        self.servos = motion.aerodynamics.servos
        self._surfaces = motion.surfaces
        self._servo_state: Any = None
        self._implicit: Array | None = None  # guess of the implicit regressors

    def begin(self, inputs: Inputs) -> None:
        """Evaluate the beginning of a step."""
        air, commands, drift = inputs(0, self.state)
        if self._servo_state is None or self.servos.are_ideal:
            self._servo_state = self.servos.at_rest(self._of_surfaces(commands))
        self._commands = commands
        self.wind = air.velocity(self.state[..., ATTITUDE])
        self.controls = {**commands, **self._servo_state.deflections}
        self.now = self._at(self.state, self.controls, air, drift)
        self._implicit = self.now.implicit

    def step(self, inputs: Inputs) -> None:
        """Fly the step that has begun."""
        begun = self._servo_state

        def rate(t: float, state: Array) -> Array:
            if t > 0.0:
                # what diverges within a step is ended at its end
                within = np.clip(state, -STAGE_LIMIT, STAGE_LIMIT)
                air, commands, drift = inputs(round(2 * t / self.dt), within)
                controls = commands
                if not self.servos.are_ideal:
                    first = self._of_surfaces(self._commands)
                    ramp = Ramp(t, first, self._of_surfaces(commands))
                    self._servo_state = self.servos.moved(begun, ramp)
                    controls = {**commands, **self._servo_state.deflections}
                self.now = self._at(within, controls, air, drift)
            return self.now.derivative

        self.state = rk4_step(rate, 0.0, self.state, self.dt)

    def _at(self, state: Array, controls: Mapping, air: LocalAir, drift: Array | float) -> Instant:
        return self.motion.at(state, controls, air, self._implicit, drift)

    def _of_surfaces(self, commands: Mapping) -> dict[str, Any]:
        return {name: commands[name] for name in self._surfaces & commands.keys()}


class Trajectories(NamedTuple):
    """Simulated trajectories: arrays (n_steps + 1, ...) over time, NaN after the end of a trajectory."""

    time: np.ndarray  #: Since the start, (n_steps + 1,)
    states: Array
    instants: Instant  #: At each time
    wind: Array | None
    controls: dict[str, Array]
    ended: np.ndarray  #: Why each trajectory ended, (...), `FLYING` where it did not


def fly_record(
    motion: Motion,
    commands: Callable,
    air: AirAt,
    stages: Array,
    state: Array,
    drifts: Array | None = None,
) -> Trajectories:
    """Return the flight from states: the loop of RK4 over time.

    Parameters
    ----------
    motion : Motion
    commands : callable
        (step, stage, observe) -> controls by name; ``observe()`` gives the channels of the present
        states. A step has two stages.
    air : callable
        (stage, state) -> LocalAir.
    stages : array (2 n_steps + 1,)
        Times since the start [s]: beginning and middle of each step, and the end.
    state : array (..., 13)
        At the start.
    drifts : array (2 n_steps + 1, ..., 6) or None
        Added to the coefficients.

    Returns
    -------
    Trajectories
    """
    time = stages[::2]
    n_steps = len(time) - 1
    drifts = np.zeros(len(stages)) if drifts is None else drifts

    def inputs(step: int, part: int, state: Array) -> tuple[LocalAir, dict, Any]:
        stage = 2 * step + part
        local = air(stage, state)

        def observe() -> dict[str, Array]:
            return channels(state, local.velocity(state[..., ATTITUDE]))

        return local, motion.mixed(commands(step, stage, observe)), drifts[stage]

    flight = Integrator(motion, state, float(time[1]))
    ended = np.full(state.shape[:-1], FLYING, dtype=object)
    over: list[Any] = []  # which trajectories have ended, by step
    flown: list[Any] = []
    with threads_for(ended.size), np.errstate(all="ignore"):  # what diverges is ended
        for k in range(n_steps + 1):
            of_step = partial(inputs, k)
            flight.begin(of_step)
            flown.append((flight.state, flight.now, flight.wind, flight.controls))
            for reason, where in end_reasons(flight.state, flight.now).items():
                ended[where & (ended == FLYING)] = reason
            over.append(ended != FLYING)
            # flights that ended go on without being shown
            if k == n_steps or over[-1].all():
                break
            flight.step(of_step)
    return _record(time, flown, np.array(over), ended)


def _record(time: Array, flown: list, over: Array, ended: Array) -> Trajectories:
    """Return the record of the steps ``flown``: states, instant, wind and controls at the beginning of each."""

    def over_time(values: Sequence, *size: int) -> Array:
        array = np.full((*time.shape, *ended.shape, *size), np.nan)
        for k, value in enumerate(values):
            array[k] = value
        array[: len(over)][over] = np.nan
        return array

    states, instants, winds, controls = zip(*flown, strict=True)
    fields: list[Any] = []
    for values in zip(*instants, strict=True):
        size = np.shape(values[0])[ended.ndim :]
        fields.append(None if values[0] is None else over_time(values, *size))
    deflected = {}
    for name in controls[0]:
        deflected[name] = over_time([moment[name] for moment in controls])
    wind = None if winds[0] is None else over_time(winds, 3)
    return Trajectories(time, over_time(states, 13), Instant(*fields), wind, deflected, ended)


def end_reasons(state: Array, now: Instant) -> dict[str, Array]:
    """Return which trajectories cannot go on, (...) by reason; only reasons that apply."""
    is_finite = np.isfinite(now.derivative).all(axis=-1)
    # comparisons with NaN are false
    is_slow = (np.abs(state[..., 3:]) < FASTEST).all(axis=-1)
    reasons: dict[str, Any] = {
        "airspeed": now.airspeed < LEAST_AIRSPEED,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~(is_finite & is_slow),
    }
    return {reason: where for reason, where in reasons.items() if where.any()}
