"""Simulated flight: the loop over the times of a clock, the states it records, and why a flight ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, BODY_VELOCITY, EARTH_VELOCITY, EULER, POSITION, RATES
from skdgp._flight.checks import check_number
from skdgp._flight.frames import air_data, body_to_ned, ned_to_body, quaternion_to_euler
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._air import AirAt
from skdgp.dynamics._motion import PROPULSION, Instant, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY, rk4_step

SLOWEST = 1.0  # Airspeed [m/s] below which a trajectory ends: no angle of attack is known there
# Velocity [m/s] and rate [rad/s] beyond which a trajectory has diverged
FASTEST, SPINNING = 1000.0, 60.0
FLYING = ""
REASONS = {
    "airspeed": "airspeed under 1 m/s",
    "altitude": "outside of the atmosphere",
    "diverged": "diverged",
    "fixed point": "no fixed point of the regressors that follow from the loads",
}


def channels(states: Array, wind: Array | None = None) -> dict[str, Array]:
    """Return the columns of the vocabulary that follow from states (..., 13) in a ``wind`` (..., 3), each (...)."""
    attitude = states[..., ATTITUDE]
    earth, angles = body_to_ned(attitude, states[..., VELOCITY]), quaternion_to_euler(attitude)
    air = (
        states[..., VELOCITY]
        if wind is None
        else states[..., VELOCITY] - ned_to_body(attitude, wind)
    )
    groups = {
        POSITION: states[..., rigid_body.POSITION],
        EARTH_VELOCITY: earth,
        BODY_VELOCITY: states[..., VELOCITY],
        EULER: angles,
        RATES: states[..., rigid_body.RATES],
    }
    columns = {
        name: values[..., k] for names, values in groups.items() for k, name in enumerate(names)
    }
    return columns | {
        **dict(zip(AIR_DATA, air_data(air), strict=True)),
        "altitude": -states[..., 2],
    }


class Clock(NamedTuple):
    """Times of the steps of a simulation and of their stages: the beginning, middle and end of each step."""

    dt: float
    n_steps: int

    @classmethod
    def of(cls, dt: float, duration: float | None, tables: Iterable[pd.DataFrame]) -> Clock:
        """Return the clock of a ``duration`` [s], by default as long as all of the ``tables`` last."""
        dt = check_number("dt", dt, unit="s")
        spans = [np.ptp(table["time"].to_numpy(float)) for table in tables]
        if duration is None:
            if not spans:
                raise ValueError(
                    "Got no duration and no table of controls, but expected one of them to say "
                    "how long."
                )
            duration = float(min(spans))
        n_steps = int(np.floor(duration / dt + 1e-6)) if np.isfinite(duration) else 0
        if n_steps < 1:
            raise ValueError(
                f"Got a duration of {duration!r} s, but expected at least one step of {dt:g} s."
            )
        if spans and n_steps * dt > min(spans) + 1e-6 * dt:
            raise ValueError(
                f"Got a table that ends after {min(spans):g} s, but the simulation lasts "
                f"{n_steps * dt:g} s: give a "
                "shorter duration, or controls and wind for all of it."
            )
        return cls(dt, n_steps)

    @property
    def stages(self) -> np.ndarray:
        """Times since the start [s], two for each step and the end."""
        return 0.5 * self.dt * np.arange(2 * self.n_steps + 1)


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
    ended: Array  #: Why each trajectory ended, (...), `FLYING` where it did not
    end: Array  #: The step at which it did, (...)

    def rows(self, part: slice) -> Record:
        """Return the record of some of the steps."""
        controls = {name: values[part] for name, values in self.controls.items()}
        arrays = (None if values is None else values[part] for values in self[:8])
        return Record(*arrays, controls, self.ended, self.end - part.start)  # type: ignore[arg-type, call-arg]


class Servos(NamedTuple):
    r"""Servos of the control surfaces with a first-order lag T: :math:`T \dot\delta = c - \delta`, commands c."""

    lag: float  #: T [s]
    surfaces: frozenset[str]  #: The controls that they move

    @classmethod
    def of(cls, motion: Motion) -> Servos:
        """Return the servos of an aircraft; they move nothing where its model has no lag."""
        model = motion.aerodynamics
        moved = {*motion.controls, *(() if model.mixing is None else model.mixing.surfaces)}
        surfaces = moved - {*PROPULSION, "gust"} if model.servo_lag > 0 else ()
        return cls(model.servo_lag, frozenset(surfaces))

    def deflected(
        self, commands: Mapping, elapsed: float, first: Mapping, begun: Mapping
    ) -> dict[str, Array]:
        """Return the controls, with the deflections of the surfaces, ``elapsed`` [s] after a step began.

        Commands were ``first`` then, and are linear since; ``begun`` are the deflections then, by
        default the commands.
        """
        controls = dict(commands)
        decay = np.exp(-elapsed / self.lag) if self.surfaces else 0.0
        for name in self.surfaces & commands.keys():
            change = commands[name] - first[name]
            behind = self.lag / elapsed * change if elapsed > 0 else 0.0
            late = begun.get(name, first[name]) - first[name] + behind
            controls[name] = commands[name] - behind + late * decay
        return controls


def fly_record(
    motion: Motion,
    commands: Callable,
    air: AirAt,
    clock: Clock,
    state: Array,
    drifts: Array | None = None,
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

    Returns
    -------
    Record
    """
    start, n = state, clock.n_steps + 1
    ended, end = np.full(state.shape[:-1], FLYING, dtype=object), np.full(state.shape[:-1], n)
    flown: list[tuple[Array, Instant, dict, Array | None]] = []

    servos = Servos.of(motion)

    def commanded(step, stage, state, wind):
        return motion.mixed(commands(step, stage, lambda: channels(state, wind)))

    def instant(step, part, state, last, begin):
        stage = 2 * step + part
        local = air(stage, state)
        wind = None if local is None else local.wind
        commands_now = commanded(step, stage, state, wind)
        first, begun = begin or (commands_now, reached)
        controls = servos.deflected(commands_now, 0.5 * clock.dt * part, first, begun)
        drift = 0.0 if drifts is None else drifts[stage]
        now = motion.at(state, controls, local, None if last is None else last.implicit, drift)
        return now, controls, wind, commands_now

    def slope(step, now, begin, t, state):
        part = round(2 * t / clock.dt)
        return now.derivative if part == 0 else instant(step, part, state, now, begin)[0].derivative

    now = None
    reached: dict[str, Array] = {}  # deflections at the end of the last step
    with threads_for(ended.size), np.errstate(all="ignore"):  # what diverges is ended
        for k in range(n):
            now, controls, wind, first = instant(k, 0, state, now, None)
            over = end_reasons(state, now)
            for reason, where in over.items():
                just = np.broadcast_to(where, ended.shape) & (ended == FLYING)
                ended[just], end[just] = reason, k
            if not (ended == FLYING).any():
                break
            if over:
                state = np.where(
                    (ended == FLYING)[..., None], state, start
                )  # flown on from there, never shown
                now, controls, wind, first = instant(k, 0, state, None, None)
            flown.append((state, now, controls, wind))
            if k < clock.n_steps:
                begin = first, controls
                state = rk4_step(partial(slope, k, now, begin), 0.0, state, clock.dt)
                if servos.surfaces:
                    local = air(2 * k + 2, state)
                    wind = None if local is None else local.wind
                    last = commanded(k, 2 * k + 2, state, wind)
                    reached = servos.deflected(last, clock.dt, *begin)
    return _record(motion, clock.dt * np.arange(n), flown, ended, end)


def _record(
    motion: Motion, time: np.ndarray, flown: list[tuple], ended: Array, end: Array
) -> Record:
    """Return the record of the steps ``flown``: state, instant, controls and wind of each."""
    is_over = np.arange(len(time)).reshape(-1, *[1] * ended.ndim) >= end

    def over_time(values: Sequence, *size: int) -> Array:
        array = np.full((len(time), *ended.shape, *size), np.nan)
        for k, value in enumerate(values):
            array[k] = value
        array[is_over] = np.nan
        return array

    states, instants, controls, winds = (
        zip(*flown, strict=True) if flown else ((), (), ({},), (None,))
    )
    return Record(
        time=time,
        states=over_time(states, 13),
        regressors=over_time([now.regressors for now in instants], len(motion.regressors)),
        coefficients=over_time([now.coefficients for now in instants], 6),
        specific_force=over_time([now.force for now in instants], 3) / motion.aircraft.mass,
        derivative=over_time([now.derivative for now in instants], 13),
        density=over_time([now.density for now in instants]),
        wind=None if winds[0] is None else over_time(winds, 3),
        controls={
            name: over_time([values_by_name[name] for values_by_name in controls])
            for name in controls[0]
        },
        ended=ended,
        end=end,
    )


def end_reasons(state: Array, now: Instant) -> dict[str, Array]:
    """Return which trajectories cannot go on, by reason."""
    fine = np.isfinite(now.derivative).all(axis=-1)
    fine = fine & (np.abs(state[..., VELOCITY]) < FASTEST).all(axis=-1)
    fine = fine & (np.abs(state[..., rigid_body.RATES]) < SPINNING).all(axis=-1)
    reasons: dict[str, Any] = {
        "airspeed": now.airspeed < SLOWEST,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~fine,
        "fixed point": np.logical_not(now.settled),
    }
    return {reason: where for reason, where in reasons.items() if np.any(where)}
