"""Simulation of the example flights, several at once, with the autopilot in the loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp.datasets._autopilot import Autopilot
from skdgp.datasets._brumby import BRUMBY
from skdgp.datasets._flight_plans import FlightPlan, scheduled
from skdgp.datasets._loads import loads
from skdgp.dynamics import euler_to_quaternion, ned_to_body, rk4_step
from skdgp.dynamics._simulation.gusts import Gusts, dryden_gusts, low_altitude_turbulence

__all__ = ["STEP", "FlightRecord", "fly"]

STEP = 0.025
"""Between autopilot commands, integration steps and log rows [s]."""
SETTLING = 8.0
"""Flown before the log begins, so that it does not open with the transients of a guessed trim [s]."""
FIELD_ELEVATION = 60.0
"""Height of the ground, above which turbulence scales [m]."""
AIRSPEED, ALPHA = 36.0, 0.085
TRIM = (-0.04, -0.007, 0.0, 0.63)
"""Elevator, aileron, rudder [rad], throttle."""
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])
ELEVON_LIMIT, RUDDER_LIMIT = 0.42, 0.35


class FlightRecord(NamedTuple):
    """What was flown, at each log time: arrays (n_times, n_flights, k)."""

    time: np.ndarray
    state: np.ndarray
    controls: np.ndarray
    """Left and right elevon, rudder [rad], propeller speed [rad/s]."""
    throttle: np.ndarray
    wind: np.ndarray
    """Mean wind NED, (n_flights, 3) [m/s]."""
    gusts: Gusts


class _Schedule(NamedTuple):
    """What the plans want at each time, (n_times, n_flights, ...)."""

    orbit: np.ndarray
    altitude: np.ndarray
    airspeed: np.ndarray
    excitation: np.ndarray


def fly(plans: tuple[FlightPlan, ...], duration: float, turbulence: float, rng) -> FlightRecord:
    """Return the flights of ``plans``, ``duration`` [s] each, all integrated in one loop over time (RK4).

    ``turbulence`` multiplies the gusts; the random numbers behind them do not depend on it.
    """
    time = np.arange(round((SETTLING + duration) / STEP)) * STEP - SETTLING
    schedule = _schedule(plans, time)
    wind = np.array([plan.wind for plan in plans])
    gusts = _gusts(plans, turbulence, 2 * len(time) + 1, rng)
    autopilot = Autopilot(TRIM, ALPHA, STEP, len(plans))
    state, controls = _initial(schedule, wind)
    slopes = (np.zeros(len(plans)), np.zeros(len(plans)))
    states, surfaces, throttles = [], [], []
    for k in range(len(time)):
        air = [Gusts(*part) for part in zip(*(part[2 * k : 2 * k + 3] for part in gusts), strict=True)]
        start = loads(state, controls, wind, air[0], slopes)
        command = schedule.excitation[k] + autopilot.command(
            state, start, schedule.orbit[k], schedule.altitude[k], schedule.airspeed[k]
        )
        target, throttle = _actuator_targets(command)
        states.append(state)
        surfaces.append(controls)
        throttles.append(throttle)
        slopes = start.slopes
        state, controls = _advance(state, controls, target, wind, air, start)
    log = slice(round(SETTLING / STEP), None)
    return FlightRecord(
        time[log], np.array(states)[log], np.array(surfaces)[log], np.array(throttles)[log], wind,
        Gusts(*(part[:-1:2][log] for part in gusts)),
    )  # fmt: skip


def _advance(state, controls, target, wind, air, start):
    """Return state and controls one step on; the slopes are held, the actuators are exact first-order lags."""
    lagging = [target + np.exp(-dt / TIME_CONSTANTS) * (controls - target) for dt in (0.0, 0.5 * STEP, STEP)]

    def derivative(t, x):
        stage = round(2.0 * t / STEP)
        return loads(x, lagging[stage], wind, air[stage], start.slopes).derivative if stage else start.derivative

    return rk4_step(derivative, 0.0, state, STEP), lagging[2]


def _actuator_targets(command):
    """Return where the actuators go (n, 4) and the throttle (n,), mixed and limited."""
    elevator, aileron, rudder, throttle = command.T
    target = np.empty_like(command)
    target[:, 0] = np.clip(elevator + aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    target[:, 1] = np.clip(elevator - aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    target[:, 2] = np.clip(rudder, -RUDDER_LIMIT, RUDDER_LIMIT)
    throttle = np.clip(throttle, 0.0, 1.0)
    target[:, 3] = BRUMBY.propeller.speed_at(throttle)
    return target, throttle


def _schedule(plans, time) -> _Schedule:
    orbit = np.stack([scheduled(plan.orbits, time) for plan in plans], axis=1)
    altitude = np.stack([scheduled(plan.altitudes, time)[:, 0] for plan in plans], axis=1)
    airspeed = np.stack([scheduled(plan.airspeeds, time)[:, 0] for plan in plans], axis=1)
    excitation = np.stack([np.stack(plan.excitation(time), axis=-1) for plan in plans], axis=1)
    return _Schedule(orbit, altitude, airspeed, excitation)


def _gusts(plans, turbulence, n_times, rng) -> Gusts:
    """Return gusts every half step, so that each stage of the integration meets its own."""
    heights = [plan.altitudes[0][1] - FIELD_ELEVATION for plan in plans]
    scales = [low_altitude_turbulence(h, plan.wind_at_6m) for h, plan in zip(heights, plans, strict=True)]
    lengths, intensities = (np.array(part) for part in zip(*scales, strict=True))
    return dryden_gusts(n_times, 0.5 * STEP, AIRSPEED, lengths, turbulence * intensities, BRUMBY.span, rng)


def _initial(schedule: _Schedule, wind):
    """Return state and controls about trimmed, on the orbit due north of its centre, heading along it."""
    centre, radius = schedule.orbit[0, :, :2], schedule.orbit[0, :, 2]
    n_flights = len(radius)
    state = np.zeros((n_flights, 13))
    state[:, :2], state[:, 2] = centre, -schedule.altitude[0]
    state[:, 0] += np.abs(radius)
    heading = 0.5 * np.pi * np.sign(radius)
    state[:, 6:10] = euler_to_quaternion(0.0, ALPHA, heading)
    state[:, 3:6] = ned_to_body(state[:, 6:10], wind)
    state[:, 3] += schedule.airspeed[0] * np.cos(ALPHA)
    state[:, 5] += schedule.airspeed[0] * np.sin(ALPHA)
    controls, _ = _actuator_targets(np.tile(TRIM, (n_flights, 1)))
    return state, controls
