"""Simulation of the example flights as one batch, by the loop of `skdgp.dynamics.simulate`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import HAT, RATE_LENGTHS
from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients
from skdgp.datasets._flight_controls import ALPHA, FlightControls
from skdgp.datasets._flight_plans import FlightPlan
from skdgp.dynamics import Aerodynamics, euler_to_quaternion, ned_to_body
from skdgp.dynamics._equations.motion import Air, Instant, Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, VELOCITY
from skdgp.dynamics._simulation.gusts import GustyAir, dryden_gusts, low_altitude_turbulence
from skdgp.dynamics._simulation.inputs import Clock
from skdgp.dynamics._simulation.simulate import Record, fly_record

STEP = 0.025
"""Between autopilot commands, integration steps and log rows [s]."""
SETTLING = 8.0
"""Flown before the log begins, so that it does not open with the transients of a guessed trim [s]."""
FIELD_ELEVATION = 60.0
"""Height of the ground, above which turbulence scales [m]."""
AIRSPEED = 36.0
"""At which the gusts are crossed [m/s]."""
PASSES = 8
"""Of the fixed point of alpha_dot and beta_dot in the truth; each brings it 70 times nearer."""


def brumby_motion() -> Motion:
    """Return how the Brumby moves; alpha_dot and beta_dot lag by one call, as in the steps of the example flights."""
    names = [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
    return Motion(Aerodynamics(brumby_coefficients, names), BRUMBY, lagged=True)


def fly_plans(
    plans: tuple[FlightPlan, ...],
    duration: float,
    turbulence: float,
    rng: np.random.Generator,
    controls_of: Callable = FlightControls,
) -> tuple[Record, Instant]:
    """Return the flights of ``plans``, ``duration`` [s] each, and what acted, the fixed point of the slopes converged.

    ``turbulence`` multiplies the gusts; the random numbers behind them do not depend on it. ``controls_of`` makes the
    controls from the plans, the times and the step.
    """
    time: np.ndarray = np.arange(round((SETTLING + duration) / STEP)) * STEP - SETTLING
    heights = [plan.altitudes[0][1] - FIELD_ELEVATION for plan in plans]
    scales = [low_altitude_turbulence(h, plan.wind_at_6m) for h, plan in zip(heights, plans, strict=True)]
    lengths, intensities = (np.array(part) for part in zip(*scales, strict=True))
    gusts = dryden_gusts(2 * len(time) + 1, 0.5 * STEP, AIRSPEED, lengths, turbulence * intensities, BRUMBY.span, rng)
    wind = np.array([plan.wind for plan in plans])
    air = GustyAir(lambda stage, state: Air(wind), gusts)
    motion, controls = brumby_motion(), controls_of(plans, time, STEP)
    record = fly_record(motion, controls, air, Clock(STEP, len(time) - 1), _initial_states(controls, wind))
    log = slice(round(SETTLING / STEP), None)
    record = record.rows(log)
    at = air(slice(2 * log.start, 2 * len(time), 2), record.states)
    implicit = None
    for _ in range(PASSES):
        truth = motion.at(record.states, record.controls, at, implicit)
        implicit = truth.implicit
    return record._replace(time=time[log]), truth


def _initial_states(controls: FlightControls, wind: Array) -> Array:
    """Return states (n_flights, 13) about trimmed, on the orbit due north of its centre, heading along it."""
    orbit, airspeed = controls.orbit[0], controls.airspeed[0]
    state = np.zeros((len(orbit), 13))
    state[:, :2], state[:, 2] = orbit[:, :2], -controls.altitude[0]
    state[:, 0] += np.abs(orbit[:, 2])
    state[:, ATTITUDE] = euler_to_quaternion(0.0, ALPHA, 0.5 * np.pi * np.sign(orbit[:, 2]))
    state[:, VELOCITY] = ned_to_body(state[:, ATTITUDE], wind)
    state[:, 3] += airspeed * np.cos(ALPHA)
    state[:, 5] += airspeed * np.sin(ALPHA)
    return state
