"""Simulation of a model, as one trajectory or as an ensemble drawn from its posterior."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.linalg import semidefinite_root
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import AIR_DATA, CHANNELS, TRUTH_SUFFIX
from skdgp.dynamics._air.air import LocalAir, as_air
from skdgp.dynamics._air.turbulence import Turbulence
from skdgp.dynamics._control.linearize import jacobian
from skdgp.dynamics._equations.aerodynamics import Drift
from skdgp.dynamics._equations.error_covariance import STATES, checked_std, state_deviations
from skdgp.dynamics._equations.motion import CONTROLS, PROPULSION, Instant, Motion
from skdgp.dynamics._equations.rigid_body import RATES, VELOCITY, rk4_step
from skdgp.dynamics._simulation.inputs import (
    Clock,
    as_starts,
    control_schedule,
    initial_states,
    perturbed,
    tables_of,
    warn_of_clocks,
)
from skdgp.dynamics._simulation.trajectory import channels, trajectory_table, warn_of
from skdgp.dynamics._simulation.wind import AirAt, airspeeds, drift_in, gusty_air, met_turbulence, wind_schedule
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import Thrust

SLOWEST = 1.0
"""Airspeed [m/s] below which a trajectory ends: no angle of attack is known there."""
FASTEST, SPINNING = 1000.0, 60.0
"""Velocity [m/s] and rate [rad/s] beyond which a trajectory has diverged."""
FLYING = ""
MOST_KNOTS = 250
"""Points of a trajectory at which the model's errors are known, linear between them: a knot a step on short flights."""


def simulate(
    model: Any,
    aircraft: Aircraft,
    x0: Any,
    controls: Any,
    dt: float = 0.02,
    *,
    duration: float | None = None,
    air: Any = None,
    n_paths: int | None = None,
    random_state: Seed = 0,
    return_std: bool = False,
    initial_std: Mapping[str, float] | None = None,
    thrust: Thrust = "auto",
) -> pd.DataFrame:
    r"""Return the flight of an aircraft with learned aerodynamics: RK4 over the six degrees of freedom.

    At every stage the regressors are rebuilt from the simulated state as the pipeline builds them from a log; those
    that follow from the loads (alpha_dot, beta_dot, p_dot, q_dot, r_dot, ax, ay, az) are found by fixed point.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        Gives the coefficients: see :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    x0 : mapping, Series, DataFrame, Trim, list of Trim or array-like of shape (13,) or (n_starts, 13)
        The start, or several that are flown together. By name: a row of a flight, or ``airspeed``, ``alpha``, ``beta``,
        ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``, ``altitude``, ...; what is not given is zero.
    controls : DataFrame, list of DataFrame, mapping or callable
        Elevator, aileron, rudder [rad], elevons, throttle and the model's other controls, and what gives the thrust: a
        table with ``time`` [s], its first row the start (linear between rows; a list: one for each start); constants
        by name; or a feedback law, a function (t, state) to values by name, where ``state`` maps the names of
        channels to arrays, ``state["phi"]``; or ``FlightComputer(law)``, which asks it once a step.
    dt : float, default=0.02
        Time step [s].
    duration : float, optional
        [s]; by default as long as the tables.
    air : Air, DataFrame, list of DataFrame, array-like (3,), callable, Turbulence or "calm", optional
        A wind, as a table, a function or a constant, a `Turbulence`, or an `Air` of both, with density and gravity. By
        default paths meet the gusts of a wind that is a table or a function, else those of the training flights. "calm"
        is without gusts.
    n_paths : int, optional
        Number of functions drawn from the posterior to fly instead of the mean, each for a whole flight. Their spread
        is the uncertainty of the trajectory.
    random_state : int or RandomState, default=0
        Of the paths.
    return_std : bool, default=False
        Whether to add standard deviations ``airspeed_std``, ``phi_std``, ... of the mean's trajectory by the joint
        posterior along it, to first order, with the rates of gusts, but not their velocity: fast, and right for some
        seconds; ``n_paths`` is right for longer.
    initial_std : mapping of str to float, optional
        Standard deviations of the start, for paths or ``return_std``, by name ("u", "v", "w", "v_north", ..., "phi",
        ...). Those of angles alone leave the velocity over the ground as it is, which is how it is measured.
    thrust : "auto", callable or None, default="auto"
        "auto": the controls thrust_x ... thrust_n [N], [N m], or thrust [N] along the thrust line, or the propeller at
        propeller_speed [rad/s] or throttle. A function (controls, airspeed, density) to newtons along the thrust
        line. None: a glider, or a model whose coefficients include the thrust.

    Returns
    -------
    pandas.DataFrame
        A flight table: ``time``, position, velocities, angles, rates, airspeed, alpha, beta, altitude, density, ``ax``,
        ``ay``, ``az``, ``p_dot``, ``q_dot``, ``r_dot``, controls and coefficients; ``beyond``, the regressor that is
        farthest outside of what was flown, or ""; ``ended``, why the trajectory is over, or "": its rows are then NaN.
        Several starts have a column ``start``, paths also ``path``; ``flight`` names each. ``attrs["air"]`` says in
        words which gusts were met.

    Raises
    ------
    ValueError
        If the start is not finite, controls are missing or end early, nothing gives the thrust, a regressor cannot be
        rebuilt, the model lacks a coefficient or has no posterior to draw from, or there is a Turbulence without paths.

    Warns
    -----
    SimulationWarning
        If a trajectory ends early, or leaves what the model was learned from.
    UserWarning
        If start, controls and wind carry times that do not begin together, or a start does not fit its wind.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, simulate
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> def coefficients(X):
    ...     alpha, beta, p, q, r, elevator = X.T
    ...     return np.stack([-0.02 + 2 * alpha**2, -0.4 * beta, -0.2 - 4.5 * alpha, -0.05 * beta - 0.4 * p + 0.1 * r,
    ...                      0.02 - 0.4 * alpha - 8 * q - 0.8 * elevator, 0.08 * beta - 0.1 * r], axis=-1)
    >>> model = Aerodynamics(coefficients, ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator"])
    >>> flown = simulate(model, glider, {"airspeed": 12.0, "alpha": 0.05, "altitude": 100.0},
    ...                  {"elevator": -0.01}, duration=10.0, thrust=None)
    >>> flown[["time", "airspeed", "altitude"]].iloc[-1].round(1).to_dict()
    {'time': 10.0, 'airspeed': 11.2, 'altitude': 90.8}
    """
    asked = as_air(air)
    motion = Motion(model, aircraft, thrust=thrust, air=asked)
    starts = as_starts(x0)
    clock = Clock.of(dt, duration, tables_of(controls, asked.wind))
    warn_of_clocks(starts, controls, asked.wind, clock.dt)
    local = wind_schedule(asked.wind, clock, len(starts))
    commands = control_schedule(controls, clock, is_control(motion), len(starts))
    states = initial_states(starts, lambda at: local(0, at))
    if n_paths is None and isinstance(asked.gusts, Turbulence):
        raise ValueError("Got gusts without n_paths, but expected both: gusts are drawn, for each path its own.")
    if n_paths is not None and return_std:
        raise ValueError("Got n_paths and return_std=True, but expected one of them: paths spread by themselves.")
    if initial_std is not None and n_paths is None and not return_std:
        raise ValueError("Got initial_std without n_paths or return_std=True: nothing would show it.")
    drift, drifts, said = None, None, ""
    if n_paths is not None or return_std:
        met, said = met_turbulence(asked, local, motion, clock, states)
        if asked.drift:
            drift = drift_in(met, motion, float(airspeeds(states, local).mean()), drawn=n_paths is not None)
    if n_paths is not None:
        if met is not None and np.any(met.intensity):
            local = gusty_air(asked, met, local, motion, clock, states, n_paths, random_state)
        motion.aerodynamics = motion.aerodynamics.sample(n_paths, random_state, correlated=True)
        states = perturbed(states, initial_std, n_paths, random_state)
        drifts = None if drift is None else drift.draw(clock.stages, states.shape[:-1], random_state)
    elif len(states) == 1:
        states = states[0]
    record = fly_record(motion, commands, local, clock, states, drifts)
    warn_of(record, motion)
    std = linear_std(record, motion, initial_std, drift) if return_std else {}
    first = [table["time"].iloc[0] for table in tables_of(controls)] or [0.0]
    table = trajectory_table(record, motion, np.broadcast_to(np.array(first, dtype=float), (len(starts),)), std)
    table.attrs["air"] = said
    return table


class Record(NamedTuple):
    """Simulated trajectories: arrays (n_steps + 1, ...) over time, NaN after the end of a trajectory."""

    time: np.ndarray
    """Since the start, (n_steps + 1,)."""
    states: Array
    regressors: Array
    coefficients: Array
    specific_force: Array
    derivative: Array
    density: Array
    wind: Array | None
    controls: dict[str, Array]
    ended: Array
    """Why each trajectory ended, (...), `FLYING` where it did not."""
    end: Array
    """The step at which it did, (...)."""

    def rows(self, part: slice) -> Record:
        """Return the record of some of the steps."""
        controls = {name: values[part] for name, values in self.controls.items()}
        arrays = (None if values is None else values[part] for values in self[:8])
        return Record(*arrays, controls, self.ended, self.end - part.start)  # type: ignore[arg-type, call-arg]


def fly_record(
    motion: Motion, commands: Callable, air: AirAt, clock: Clock, state: Array, drifts: Array | None = None
) -> Record:
    """Return what is flown from states (..., 13): the loop over time.

    ``commands`` (step, stage, observe) are those of :func:`control_schedule`, ``air`` (stage, state) of
    :func:`wind_schedule`; a step has two stages. ``drifts`` (n_stages, ..., 6) are added to the coefficients.
    """
    start, n = state, clock.n_steps + 1
    ended, end = np.full(state.shape[:-1], FLYING, dtype=object), np.full(state.shape[:-1], n)
    flown: list[tuple[Array, Instant, dict, Array | None]] = []

    def instant(step, stage, state, last):
        stage += 2 * step
        here = air(stage, state)
        wind = None if here is None else here.wind
        controls = motion.mixed(commands(step, stage, lambda: channels(state, wind)))
        drift = 0.0 if drifts is None else drifts[stage]
        return motion.at(state, controls, here, None if last is None else last.implicit, drift), controls, wind

    def slope(step, now, t, state):
        stage = round(2 * t / clock.dt)
        return now.derivative if stage == 0 else instant(step, stage, state, now)[0].derivative

    now = None
    with np.errstate(all="ignore"):  # what diverges is ended
        for k in range(n):
            now, controls, wind = instant(k, 0, state, now)
            over = end_reasons(state, now)
            for reason, where in over.items():
                first = np.broadcast_to(where, ended.shape) & (ended == FLYING)
                ended[first], end[first] = reason, k
            if not (ended == FLYING).any():
                break
            if over:
                state = np.where((ended == FLYING)[..., None], state, start)  # flown on from there, never shown
                now, controls, wind = instant(k, 0, state, None)
            flown.append((state, now, controls, wind))
            if k < clock.n_steps:
                state = rk4_step(partial(slope, k, now), 0.0, state, clock.dt)
    return _record(motion, clock.dt * np.arange(n), flown, ended, end)


def _record(motion: Motion, time: np.ndarray, flown: list[tuple], ended: Array, end: Array) -> Record:
    """Return the record of the steps ``flown``: state, instant, controls and wind of each."""
    is_over = np.arange(len(time)).reshape(-1, *[1] * ended.ndim) >= end

    def over_time(values: Sequence, *size: int) -> Array:
        array = np.full((len(time), *ended.shape, *size), np.nan)
        for k, value in enumerate(values):
            array[k] = value
        array[is_over] = np.nan
        return array

    states, instants, controls, winds = zip(*flown, strict=True) if flown else ((), (), ({},), (None,))
    return Record(
        time=time,
        states=over_time(states, 13),
        regressors=over_time([now.regressors for now in instants], len(motion.regressors)),
        coefficients=over_time([now.coefficients for now in instants], 6),
        specific_force=over_time([now.force for now in instants], 3) / motion.aircraft.mass,
        derivative=over_time([now.derivative for now in instants], 13),
        density=over_time([now.density for now in instants]),
        wind=None if winds[0] is None else over_time(winds, 3),
        controls={name: over_time([each[name] for each in controls]) for name in controls[0]},
        ended=ended,
        end=end,
    )


def end_reasons(state: Array, now: Instant) -> dict[str, Array]:
    """Return which trajectories cannot go on, by reason."""
    fine = np.isfinite(now.derivative).all(axis=-1)
    fine = fine & (np.abs(state[..., VELOCITY]) < FASTEST).all(axis=-1)
    fine = fine & (np.abs(state[..., RATES]) < SPINNING).all(axis=-1)
    found: dict[str, Any] = {
        "airspeed": now.airspeed < SLOWEST,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~fine,
        "fixed point": np.logical_not(now.settled),
    }
    return {reason: where for reason, where in found.items() if np.any(where)}


def linear_std(
    record: Record, motion: Motion, initial_std: Mapping[str, float] | None, drift: Drift | None
) -> dict[str, Array]:
    """Return the standard deviations along trajectories () or (n_starts,), by name, (n_times, ...), to first order."""
    start, shape = checked_std(initial_std), record.ended.shape
    found = {f"{name}_std": np.full((len(record.time), *shape), np.nan) for name in (*STATES, *AIR_DATA)}
    for place in np.ndindex(shape):
        n = int(record.end[place])
        if n > 1:
            for name, std in zip(found, _std_along(record, motion, start, drift, place, n).T, strict=True):
                found[name][(slice(n), *place)] = std
    return found


def _std_along(
    record: Record, motion: Motion, start: Mapping[str, float], drift: Drift | None, place: Any, n: int
) -> Array:
    """Return the standard deviations (n, 18) of `STATES` and `AIR_DATA` along the first n steps of one trajectory.

    Errors of the model at the points passed are jointly Gaussian, with its posterior covariance, and that of a drift.
    """
    states = record.states[(slice(n), *place)]
    knots = np.unique(np.append(np.arange(0, n, max(1, -(-n // MOST_KNOTS))), n - 1))
    at: Any = (knots, *place)
    wind = None if record.wind is None else LocalAir(record.wind[at])
    controls = {name: values[at] for name, values in record.controls.items()}
    slopes = jacobian(motion, record.states[at], controls, air=wind)
    covariance = motion.aerodynamics.covariance(record.regressors[at], correlated=True)
    if drift is not None:
        covariance = covariance + drift.covariance(record.time[knots])
    root = semidefinite_root(covariance)  # (6 k, m), output by output
    errors = np.moveaxis(root.reshape(6, len(knots), -1), 1, 0)
    left = np.clip(np.searchsorted(knots, np.arange(n), side="right") - 1, 0, len(knots) - 2)
    share = (np.arange(n) - knots[left]) / np.diff(knots)[left]

    def between(values: Array, step: int) -> Array:
        """Return values at the knots, (k, ...), at a step, linear between them."""
        k, part = left[step], share[step]
        return (1.0 - part) * values[k] + part * values[k + 1]

    def samples() -> Iterator[tuple[Array, Array]]:
        for step in range(n):
            yield between(slopes.state, step), between(slopes.coefficients, step) @ between(errors, step)

    air_data = (between(slopes.outputs_state[:, :3], step) for step in range(n))
    steps = [record.time[1]] * (n - 1)
    return np.stack([*state_deviations(samples(), steps, start, states, further=air_data)])


def is_control(motion: Motion) -> Callable[[str], bool]:
    """Return the function that finds the controls among the columns of a table, which may be a whole log."""
    if callable(motion.thrust):
        return lambda name: (name in CONTROLS or name not in CHANNELS) and not name.endswith(TRUTH_SUFFIX)
    mixing = motion.aerodynamics.mixing
    known = {*motion.controls, *PROPULSION, *(() if mixing is None else mixing.surfaces)}
    return lambda name: name in known
