"""Integration of the motion in time: one step of Runge and Kutta under commands, the loop over time, its record."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, BODY_VELOCITY, EARTH_VELOCITY, EULER
from skdgp._flight.channels import POSITION as POSITION_NAMES
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import (
    air_data,
    body_to_ned,
    by_components,
    ned_to_body,
    quaternion_to_euler,
)
from skdgp._flight.tables import by_name
from skdgp.dynamics._air import AirAt, LocalAir
from skdgp.dynamics._inputs import StepClock
from skdgp.dynamics._motion import Instant, Motion, Tangent
from skdgp.dynamics._rigid_body import ATTITUDE, POSITION, RATES, VELOCITY, rk4_step
from skdgp.dynamics._servos import Ramp, ServoState

FLYING = ""
REASONS = {
    "airspeed": "airspeed under 1 m/s",
    "altitude": "outside of the atmosphere",
    "diverged": "diverged",
    "fixed point": "no fixed point of the regressors that follow from the loads",
}


# Airspeed [m/s] below which there is no angle of attack
LEAST_AIRSPEED = 1.0
# Velocity [m/s], attitude and rates [rad/s] beyond which a trajectory has diverged
FASTEST = np.repeat([1000.0, np.inf, 60.0], [3, 4, 3])
# Largest state within a step: coefficients of any more may not be evaluated
STAGE_LIMIT = 1e9


# Steps from one evaluation of paths to the next, longest time between them, and time for which slopes are kept [s];
# errors: docs/simulation.md, "Bands of a trajectory"
STRIDE = 3
LONGEST_STRIDE = 0.06
SLOPES_KEPT = 0.3
# Largest change of a control in a step, over its training range, that slopes account for, and largest change
# until the paths are evaluated again, over the one in a step
REACH = 0.02
STEADY = 0.5


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
    tangent: Tangent | None  #: Of the paths, None where every stage evaluates the model
    servos: ServoState


class End(NamedTuple):
    """States at the end of a step, and what the next step begins with."""

    state: Array
    servos: ServoState | None = None  #: None: the surfaces are as commanded next
    implicit: Array | None = None  #: Guess of the implicit regressors
    tangent: Tangent | None = None
    now: Instant | None = None  #: At the last stage, which is nearly the end


class Integrator:
    r"""Integration of a motion under commands in some air, step by step.

    Parameters as for `fly_record`. A step has three stages: its beginning, its middle and its end,
    which is the beginning of the next step.

    Paths are evaluated once in some steps, as they take most of the time. The stages of these steps have
    their tangent at the beginning,

    .. math:: C(x) = C_0 + J (x - x_0),

    and at the last stage, :math:`x_1`, its error :math:`e = C(x_1) - C_0 - J (x_1 - x_0)` is known.
    It grows in proportion to time. With B the derivative of d state / dt by the coefficients, the state at
    the end of these steps of h seconds in all is corrected by :math:`h B e / 2`. The next tangent begins at
    :math:`x_1`. Its slopes J are kept for some evaluations. Stages beyond the reach of the tangent evaluate the paths.
    A step that ends there is corrected by the error at its middle. Steps since the last evaluation stay uncorrected.
    """

    def __init__(
        self,
        motion: Motion,
        commands: Callable,
        air: AirAt,
        clock: StepClock,
        drifts: Array | None = None,
    ) -> None:
        self.motion = motion
        self.commands = commands
        self.air = air
        self.dt = clock.dt
        self.drifts = np.zeros(len(clock.stages)) if drifts is None else drifts
        self.servos = motion.aerodynamics.servos
        self._surfaces = motion.surfaces
        self._stride = max(1, min(STRIDE, round(LONGEST_STRIDE / clock.dt)))
        n_kept = min(clock.n_steps, round(SLOPES_KEPT / clock.dt))
        self._renewal = n_kept // self._stride  # in evaluations
        model = motion.aerodynamics
        has_path_slopes = model.n_paths is not None and model.slopes is not None
        # slopes that are kept for one step save nothing
        self._has_tangents = has_path_slopes and n_kept > 1

    def begin(self, step: int, last: End) -> Moment:
        """Return what happens at the beginning of a step, with what the ``last`` one reached."""
        state = last.state
        stage = 2 * step
        air, commands = self._inputs(step, stage, state)
        servos = last.servos
        if servos is None or self.servos.are_ideal:
            servos = self.servos.at_rest(self._of_surfaces(commands))
        controls = {**commands, **servos.deflections}
        drift = self.drifts[stage]
        tangent = last.tangent
        now = self.motion.at(state, controls, air, last.implicit, drift, tangent)
        if self._has_tangents and tangent is None:
            tangent = self._tangent(now.regressors, now.coefficients - drift)
        wind = air.velocity(state[..., ATTITUDE])
        return Moment(state, now, commands, controls, wind, tangent, servos)

    def step(self, step: int, begin: Moment) -> End:
        """Return the end of a step: states, deflections of the surfaces, and the next tangent."""
        before = now = begin.now
        servos, tangent = begin.servos, begin.tangent

        def rate(t: float, state: Array) -> Array:
            nonlocal before, now, servos
            if t > 0.0:
                # what diverges within a step is ended at its end
                within = np.clip(state, -STAGE_LIMIT, STAGE_LIMIT)
                before = now
                now, servos = self._at(step, begin, t, within)
            return now.derivative

        state = rk4_step(rate, 0.0, begin.state, self.dt)
        if tangent is not None:
            change, tangent = self._corrected(before.regressors, now, tangent)
            state = state + change
        return End(state, servos, begin.now.implicit, tangent, now)

    def _at(self, step: int, begin: Moment, t: float, state: Array) -> tuple[Instant, ServoState]:
        """Return what happens at a time ``t`` [s] after a step began, and the servos."""
        stage = 2 * step + round(2 * t / self.dt)
        air, commands = self._inputs(step, stage, state)
        controls, servos = commands, begin.servos
        if not self.servos.are_ideal:
            ramp = Ramp(t, self._of_surfaces(begin.commands), self._of_surfaces(commands))
            servos = self.servos.moved(servos, ramp)
            controls = {**commands, **servos.deflections}
        guess = begin.now.implicit
        drift = self.drifts[stage]
        return self.motion.at(state, controls, air, guess, drift, begin.tangent), servos

    def _of_surfaces(self, commands: Mapping) -> dict[str, Any]:
        return {name: commands[name] for name in self._surfaces & commands.keys()}

    def _corrected(
        self, middle: Array, now: Instant, tangent: Tangent
    ) -> tuple[Array | float, Tangent]:
        """Return the change of the states by the errors of the tangent in a step, and the next tangent."""
        last = now.regressors
        distance = last - tangent.regressors
        n_steps = tangent.steps + 1
        is_near = not (np.abs(distance) > STEADY * tangent.reach).any()
        if is_near and n_steps < self._stride:
            return 0.0, tangent._replace(steps=n_steps)
        coefficients = self.motion.evaluated(last)
        if tangent.is_far(distance):
            # Simpson's rule; the error is zero at the beginning, and at the end, without a tangent
            halfway = self.motion.evaluated(middle) - tangent(middle)
            change = 2.0 / 3.0 * self.dt * self.motion.response(now, halfway)
            return change, self._tangent(last, coefficients)
        error = coefficients - tangent(last)
        change = 0.5 * n_steps * self.dt * self.motion.response(now, error)
        if tangent.age + 1 >= self._renewal:
            return change, self._tangent(last, coefficients)
        return change, tangent.moved(last, coefficients)

    def _tangent(self, X: Array, coefficients: Array) -> Tangent:
        return self.motion.tangent(X, coefficients, REACH)

    def _inputs(self, step: int, stage: int, state: Array) -> tuple[LocalAir, dict]:
        """Return the air and the commands at a stage of a step."""
        air = self.air(stage, state)

        def observe() -> dict[str, Array]:
            return channels(state, air.velocity(state[..., ATTITUDE]))

        commands = self.commands(step, stage, observe)
        return air, self.motion.mixed(commands)


class Trajectories(NamedTuple):
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


def fly_record(
    motion: Motion,
    commands: Callable,
    air: AirAt,
    clock: StepClock,
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
    clock : StepClock
    state : array (..., 13)
        At the start.
    drifts : array (n_stages, ..., 6) or None
        Added to the coefficients.

    Returns
    -------
    Trajectories
    """
    integrator = Integrator(motion, commands, air, clock, drifts)
    state = by_components(state)
    last = End(state)
    ended = np.full(state.shape[:-1], FLYING, dtype=object)
    over: list[Any] = []  # which trajectories have ended, by step
    flown: list[Moment] = []
    with threads_for(ended.size), np.errstate(all="ignore"):  # what diverges is ended
        for k in range(clock.n_steps + 1):
            moment = integrator.begin(k, last)
            flown.append(moment)
            for reason, where in end_reasons(moment.state, moment.now).items():
                ended[where & (ended == FLYING)] = reason
            over.append(ended != FLYING)
            # flights that ended go on without being shown
            if k == clock.n_steps or over[-1].all():
                break
            last = integrator.step(k, moment)
    return _record(motion, clock, flown, np.array(over), ended)


def _record(
    motion: Motion, clock: StepClock, flown: list[Moment], over: Array, ended: Array
) -> Trajectories:
    """Return the record of the steps ``flown``."""
    time = clock.dt * np.arange(clock.n_steps + 1)

    def over_time(values: Iterable, *size: int) -> Array:
        array = np.full((*time.shape, *ended.shape, *size), np.nan)
        for k, value in enumerate(values):
            array[k] = value
        array[: len(over)][over] = np.nan
        return array

    states, instants, _, controls, winds, *_ = zip(*flown, strict=True)
    force = over_time((now.force for now in instants), 3)
    deflected = {}
    for name in controls[0]:
        deflected[name] = over_time(moment[name] for moment in controls)
    return Trajectories(
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
    )


def end_reasons(state: Array, now: Instant) -> dict[str, Array]:
    """Return which trajectories cannot go on, (...) by reason; only reasons that apply."""
    is_finite = np.isfinite(now.derivative).all(axis=-1)
    # comparisons with NaN are false
    is_slow = (np.abs(state[..., 3:]) < FASTEST).all(axis=-1)
    reasons: dict[str, Any] = {
        "airspeed": now.airspeed < LEAST_AIRSPEED,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~(is_finite & is_slow),
        "fixed point": ~np.broadcast_to(now.settled, state.shape[:-1]),
    }
    return {reason: where for reason, where in reasons.items() if where.any()}
