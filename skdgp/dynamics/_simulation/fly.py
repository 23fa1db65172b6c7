"""The time loop of a simulation: all trajectories step by step, and where each ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from skdgp.dynamics._equations.integrate import rk4_step
from skdgp.dynamics._equations.motion import Instant, Motion
from skdgp.dynamics._equations.rigid_body import RATES, VELOCITY
from skdgp.dynamics._simulation.schedules import Clock
from skdgp.dynamics._simulation.trajectory import channels

__all__ = ["FLYING", "Record", "fly", "lost"]

SLOWEST = 1.0
"""Airspeed [m/s] below which a trajectory ends: no angle of attack is known there."""
FASTEST, SPINNING = 1000.0, 60.0
"""Velocity [m/s] and rate [rad/s] beyond which a trajectory has diverged."""
FLYING = ""


class Record(NamedTuple):
    """What was flown: arrays (n_steps + 1, ...) over time, NaN where a trajectory had ended."""

    time: np.ndarray
    """Since the start, (n_steps + 1,)."""
    states: np.ndarray
    regressors: np.ndarray
    coefficients: np.ndarray
    specific_force: np.ndarray
    derivative: np.ndarray
    density: np.ndarray
    wind: np.ndarray | None
    controls: dict[str, np.ndarray]
    ended: np.ndarray
    """Why each trajectory ended, (...), `FLYING` where it did not."""
    end: np.ndarray
    """The step at which it did, (...)."""

    @classmethod
    def empty(cls, clock: Clock, shape, n_regressors: int) -> Record:
        """Return a record of ``shape`` trajectories in which nothing is known yet."""
        n = clock.n_steps + 1
        sizes = {"states": 13, "regressors": n_regressors, "coefficients": 6, "specific_force": 3, "derivative": 13}
        arrays = {name: np.full((n, *shape, size), np.nan) for name, size in sizes.items()}
        return cls(
            time=clock.dt * np.arange(n), density=np.full((n, *shape), np.nan), wind=None, controls={},
            ended=np.full(shape, FLYING, dtype=object), end=np.full(shape, n), **arrays,
        )  # fmt: skip

    def row(self, k: int, state, now: Instant, controls: dict, mass: float) -> None:
        """Write down step ``k``."""
        self.states[k], self.regressors[k], self.coefficients[k] = state, now.regressors, now.coefficients
        self.specific_force[k], self.derivative[k], self.density[k] = now.force / mass, now.derivative, now.density
        for name, value in controls.items():
            if name not in self.controls:
                self.controls[name] = np.full(self.density.shape, np.nan)
            self.controls[name][k] = value

    def finish(self, k: int, reasons: dict[str, np.ndarray]) -> None:
        """Write down which trajectories end at step ``k``, and why."""
        for reason, where in reasons.items():
            now = np.broadcast_to(where, self.ended.shape) & self.flying
            self.ended[now], self.end[now] = reason, k

    @property
    def flying(self) -> np.ndarray:
        """Which trajectories have not ended, (...)."""
        return self.ended == FLYING

    def without_ended(self) -> Record:
        """Return the record with NaN in the rows of trajectories that had ended."""
        over = np.arange(len(self.time)).reshape(-1, *[1] * self.end.ndim) >= self.end
        for values in (*self[1:6], self.density, *self.controls.values()):
            values[over] = np.nan
        return self


def fly(motion: Motion, commands: Callable, air: Callable | None, clock: Clock, state: np.ndarray) -> Record:
    """Return what is flown from states (..., 13).

    Parameters
    ----------
    motion : Motion
    commands : callable
        (step, stage, observe) to controls by name; see :func:`control_schedule`.
    air : callable or None
        (stage, state) to the wind and its rate of change; see :func:`wind_schedule`.
    clock : Clock
    state : ndarray (..., 13)
        At the start.
    """
    start, mass = state, motion.aircraft.mass
    record = Record.empty(clock, state.shape[:-1], len(motion.regressors))
    winds = []

    def instant(step, stage, state, last):
        stage += 2 * step
        here = None if air is None else air(stage, state)
        wind = None if here is None else here.wind
        controls = motion.mixed(commands(step, stage, lambda: channels(state, wind)))
        return motion.at(state, controls, here, None if last is None else last.implicit), controls, wind

    now = None
    with np.errstate(all="ignore"):  # what diverges is found, and said
        for k in range(clock.n_steps + 1):
            now, controls, wind = instant(k, 0, state, now)
            over = lost(state, now)
            if over:
                record.finish(k, over)
                if not record.flying.any():
                    break
                state = np.where(record.flying[..., None], state, start)  # flown on from there, never shown
                now, controls, wind = instant(k, 0, state, None)
            record.row(k, state, now, controls, mass)
            winds.append(wind)
            if k < clock.n_steps:
                state = _step(instant, k, state, now, clock.dt)
    return record.without_ended()._replace(wind=None if air is None else _stacked(winds, record.states))


def _step(instant, k, state, now: Instant, dt) -> np.ndarray:
    """Return the states one step on."""

    def derivative(t, x):
        stage = round(2 * t / dt)
        return now.derivative if stage == 0 else instant(k, stage, x, now)[0].derivative

    return rk4_step(derivative, 0.0, state, dt)


def lost(state, now: Instant) -> dict[str, np.ndarray]:
    """Return which trajectories cannot go on, by the reason."""
    fine = np.isfinite(now.derivative).all(axis=-1)
    fine = fine & (np.abs(state[..., VELOCITY]) < FASTEST).all(axis=-1)
    fine = fine & (np.abs(state[..., RATES]) < SPINNING).all(axis=-1)
    found = {
        "airspeed": now.airspeed < SLOWEST,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~fine,
        "fixed point": np.logical_not(now.settled),
    }
    return {reason: where for reason, where in found.items() if np.any(where)}


def _stacked(winds, states) -> np.ndarray:
    """Return the wind at every step, (n_steps + 1, ..., 3)."""
    stacked = np.full((*states.shape[:-1], 3), np.nan)
    for k, wind in enumerate(winds):
        stacked[k] = wind
    return stacked
