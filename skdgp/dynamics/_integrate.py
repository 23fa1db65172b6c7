"""Integration of the motion in time: one step of Runge and Kutta under commands, the loop over time, its record."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, BODY_VELOCITY, EARTH_VELOCITY, EULER
from skdgp._flight.channels import POSITION as POSITION_NAMES
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import air_data, body_to_ned, ned_to_body, quaternion_to_euler
from skdgp.dynamics._air import AirAt, LocalAir
from skdgp.dynamics._inputs import Clock
from skdgp.dynamics._motion import Instant, Motion, by_name
from skdgp.dynamics._rigid_body import ATTITUDE, POSITION, RATES, VELOCITY, rk4_step
from skdgp.dynamics._servos import Servos

FLYING = ""
REASONS = {
    "airspeed": "airspeed under 1 m/s",
    "altitude": "outside of the atmosphere",
    "diverged": "diverged",
    "fixed point": "no fixed point of the regressors that follow from the loads",
}


@dataclass(frozen=True)
class FlightLimits:
    """Limits at which a trajectory ends."""

    # Airspeed [m/s] below which there is no angle of attack
    airspeed: float = 1.0
    # Velocity [m/s] and rate [rad/s] beyond which a trajectory has diverged
    velocity: float = 1000.0
    rate: float = 60.0


FLIGHT_LIMITS = FlightLimits()


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


class Moment(NamedTuple):
    """States at the beginning of a step, and what happens there."""

    state: Array
    now: Instant
    commands: dict[str, Any]
    controls: dict[str, Any]  #: With the deflections of the surfaces
    wind: Array | None


class Integrator:
    """Integration of a motion under commands in some air, step by step.

    Parameters as for `fly_record`. A step has three stages: its beginning, its middle and its end,
    which is the beginning of the next step.
    """

    def __init__(
        self,
        motion: Motion,
        commands: Callable,
        air: AirAt,
        clock: Clock,
        drifts: Array | None = None,
    ) -> None:
        self.motion = motion
        self.commands = commands
        self.air = air
        self.dt = clock.dt
        self.drifts = drifts
        self.servos = Servos.of(motion)

    def begin(
        self, step: int, state: Array, deflections: Mapping[str, Array], guess: Array | None
    ) -> Moment:
        """Return what happens at the beginning of a step, with the deflections that the last one reached."""
        stage = 2 * step
        air, commands = self._inputs(step, stage, state)
        controls = self.servos.deflected(commands, 0.0, commands, deflections)
        now = self.motion.at(state, controls, air, guess, self._drift(stage))
        return Moment(state, now, commands, controls, None if air is None else air.wind)

    def step(self, step: int, begin: Moment) -> tuple[Array, dict[str, Array]]:
        """Return the states and the deflections of the surfaces at the end of a step."""
        state = rk4_step(partial(self._rate, step, begin), 0.0, begin.state, self.dt)
        if not self.servos.surfaces:
            return state, {}
        _, commands = self._inputs(step, 2 * step + 2, state)
        return state, self.servos.deflected(commands, self.dt, begin.commands, begin.controls)

    def _rate(self, step: int, begin: Moment, t: float, state: Array) -> Array:
        """Return d state / dt at a time ``t`` [s] after a step began."""
        part = round(2 * t / self.dt)
        if part == 0:
            return begin.now.derivative
        stage = 2 * step + part
        air, commands = self._inputs(step, stage, state)
        controls = self.servos.deflected(commands, t, begin.commands, begin.controls)
        guess = begin.now.implicit
        return self.motion.at(state, controls, air, guess, self._drift(stage)).derivative

    def _inputs(self, step: int, stage: int, state: Array) -> tuple[LocalAir | None, dict]:
        """Return the air and the commands at a stage of a step."""
        air = self.air(stage, state)
        wind = None if air is None else air.wind
        commands = self.commands(step, stage, partial(channels, state, wind))
        return air, self.motion.mixed(commands)

    def _drift(self, stage: int) -> Array | float:
        return 0.0 if self.drifts is None else self.drifts[stage]


class Record(NamedTuple):
    """Simulated trajectories: arrays (n_steps + 1, ...) over time, NaN after the end of a trajectory."""

    time: np.ndarray  #: Since the start, (n_steps + 1,)
    states: Array
    regressors: Array
    coefficients: Array
    specific_force: Array
    derivative: Array
    density: Array
    wind: Array | None
    controls: dict[str, Array]
    ended: np.ndarray  #: Why each trajectory ended, (...), `FLYING` where it did not
    end: Array  #: The step at which it did, (...)

    def rows(self, part: slice) -> Record:
        """Return the record of some of the steps."""
        controls = {name: values[part] for name, values in self.controls.items()}
        arrays = (None if values is None else values[part] for values in self[:8])
        return Record(*arrays, controls, self.ended, self.end - part.start)  # type: ignore[arg-type, call-arg]


def fly_record(
    motion: Motion,
    commands: Callable,
    air: AirAt,
    clock: Clock,
    state: Array,
    drifts: Array | None = None,
    deflections: Mapping[str, Array] | None = None,
    limits: FlightLimits = FLIGHT_LIMITS,
) -> Record:
    """Return the flight from states: the loop of RK4 over time.

    Parameters
    ----------
    motion : Motion
    commands : callable
        (step, stage, observe) -> controls by name; ``observe()`` gives the channels of the present
        states. A step has two stages.
    air : callable
        (stage, state) -> LocalAir or None.
    clock : Clock
    state : array (..., 13)
        At the start.
    drifts : array (n_stages, ..., 6) or None
        Added to the coefficients.
    deflections : mapping of str to array (...), optional
        Of the surfaces at the start, by default as commanded.
    limits : FlightLimits
        Where a trajectory ends.

    Returns
    -------
    Record
    """
    integrator = Integrator(motion, commands, air, clock, drifts)
    start = state
    reached = deflections or {}
    guess = None
    ended = np.full(state.shape[:-1], FLYING, dtype=object)
    end = np.full(state.shape[:-1], clock.n_steps + 1)
    flown: list[Moment] = []
    with threads_for(ended.size), np.errstate(all="ignore"):  # what diverges is ended
        for k in range(clock.n_steps + 1):
            moment = integrator.begin(k, state, reached, guess)
            over = end_reasons(state, moment.now, limits)
            for reason, where in over.items():
                just = where & (ended == FLYING)
                ended[just] = reason
                end[just] = k
            is_flying = ended == FLYING
            flies_on = is_flying.any()
            if over and flies_on:
                # flights that ended continue from their start, without being shown
                state = np.where(is_flying[..., None], state, start)
                moment = integrator.begin(k, state, reached, None)
            flown.append(moment)
            if k == clock.n_steps or not flies_on:
                break
            state, reached = integrator.step(k, moment)
            guess = moment.now.implicit
    return _record(motion, clock, flown, ended, end)


def _record(motion: Motion, clock: Clock, flown: list[Moment], ended: Array, end: Array) -> Record:
    """Return the record of the steps ``flown``."""
    time = clock.dt * np.arange(clock.n_steps + 1)
    is_over = np.moveaxis(np.less_equal.outer(end, np.arange(clock.n_steps + 1)), -1, 0)

    def over_time(values: Iterable, *size: int) -> Array:
        array = np.full((*is_over.shape, *size), np.nan)
        for k, value in enumerate(values):
            array[k] = value
        array[is_over] = np.nan
        return array

    states, instants, _, controls, winds = zip(*flown, strict=True)
    force = over_time((now.force for now in instants), 3)
    deflected = {}
    for name in controls[0]:
        deflected[name] = over_time(moment[name] for moment in controls)
    return Record(
        time=time,
        states=over_time(states, 13),
        regressors=over_time((now.regressors for now in instants), len(motion.regressors)),
        coefficients=over_time((now.coefficients for now in instants), 6),
        specific_force=force / motion.aircraft.mass,
        derivative=over_time((now.derivative for now in instants), 13),
        density=over_time(now.density for now in instants),
        wind=None if winds[0] is None else over_time(winds, 3),
        controls=deflected,
        ended=ended,
        end=end,
    )


def end_reasons(state: Array, now: Instant, limits: FlightLimits) -> dict[str, Array]:
    """Return which trajectories cannot go on, (...) by reason; only reasons that apply."""
    is_finite = np.isfinite(now.derivative).all(axis=-1)
    is_slow = (np.abs(state[..., VELOCITY]) < limits.velocity).all(axis=-1)
    is_turning_slowly = (np.abs(state[..., RATES]) < limits.rate).all(axis=-1)
    reasons: dict[str, Any] = {
        "airspeed": now.airspeed < limits.airspeed,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~(is_finite & is_slow & is_turning_slowly),
        "fixed point": ~np.broadcast_to(now.settled, state.shape[:-1]),
    }
    return {reason: where for reason, where in reasons.items() if np.any(where)}
