"""Simulation of a model: one trajectory, an ensemble drawn from its posterior, or step by step for controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.linalg import semidefinite_root
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import AIR_DATA, CHANNELS, TRUTH_SUFFIX
from skdgp.dynamics._aerodynamics import Drift
from skdgp.dynamics._air import LocalAir, as_air
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._error_covariance import STATES, checked_std, state_deviations
from skdgp.dynamics._inputs import (
    Clock,
    as_starts,
    control_schedule,
    initial_states,
    perturbed,
    tables_of,
    warn_of_clocks,
)
from skdgp.dynamics._linearize import jacobian
from skdgp.dynamics._loads import Thrust
from skdgp.dynamics._motion import CONTROLS, PROPULSION, Instant, Motion
from skdgp.dynamics._rigid_body import RATES, VELOCITY, rk4_step
from skdgp.dynamics._trajectory import beyond, channels, trajectory_table, warn_of
from skdgp.dynamics._turbulence import Turbulence
from skdgp.dynamics._wind import AirAt, airspeeds, drift_in, gusty_air, met_turbulence, wind_field, wind_schedule

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


class Simulator:
    """Step-by-step simulation of an aircraft with a controller: call ``reset``, then ``step`` repeatedly.

    Each step holds the controls for ``dt`` and integrates the equations of `simulate` (RK4). Several starts are
    simulated as one batch.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    dt : float, default=0.02
        Time step [s].
    air, thrust
        As for :func:`skdgp.dynamics.simulate`; the wind is constant or a function, no gusts are drawn besides it.

    Attributes
    ----------
    ended : str or ndarray of str
        Why the flight, or each, is over; "" while it is not.
    beyond : str or ndarray of str
        After a step: the regressor that is farthest outside of what the model was learned from, or "".

    Examples
    --------
    A controller that holds the bank angle:

    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, Simulator
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> def coefficients(X):
    ...     alpha, beta, p, q, r, aileron = X.T
    ...     Cl = -0.05 * beta - 0.4 * p + 0.1 * aileron
    ...     return np.stack([-0.02 + 2 * alpha**2, -0.4 * beta, -0.2 - 4.5 * alpha, Cl,
    ...                      0.02 - 0.4 * alpha - 8 * q, 0.08 * beta - 0.1 * r], axis=-1)
    >>> model = Aerodynamics(coefficients, ["alpha", "beta", "p_hat", "q_hat", "r_hat", "aileron"])
    >>> simulator = Simulator(model, glider, thrust=None)
    >>> seen = simulator.reset({"airspeed": 12.0, "alpha": 0.05, "phi": 0.0, "altitude": 100.0})
    >>> for _ in range(150):
    ...     seen = simulator.step({"aileron": 1.5 * (0.4 - seen["phi"]) - 0.3 * seen["p"]})
    >>> round(float(seen["time"]), 2), bool(abs(seen["phi"] - 0.4) < 0.05)
    (3.0, True)
    """

    def __init__(
        self, model: Any, aircraft: Aircraft, dt: float = 0.02, *, air: Any = None, thrust: Thrust = "auto"
    ) -> None:
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"Got dt={dt!r}, but expected a time step > 0 [s].")
        air = as_air(air)
        if isinstance(air.gusts, Turbulence):
            raise ValueError("Got a Turbulence, but a Simulator draws no gusts: give a wind, as a function.")
        self.motion = Motion(model, aircraft, thrust=thrust, air=air)
        self.dt, self._steps, self._mean, self._air = float(dt), 0, self.motion.aerodynamics, wind_field(air.wind)
        self.ended: Any = FLYING
        self.beyond: Any = ""
        self._state: Any = None

    @property
    def time(self) -> float:
        """Since the reset [s]."""
        return self._steps * self.dt

    @property
    def state(self) -> Array:
        """The state (13,), or states (n, 13), see `STATE_NAMES`; NaN where a flight has ended."""
        if self._state is None:
            raise ValueError("Got no start yet: call reset(x0) first.")
        shown = np.where((self._ended == FLYING)[..., None], self._state, np.nan)
        return shown.reshape(-1, 13)[0] if self._single else shown

    def reset(
        self, x0: Any, *, random_state: Seed = None, initial_std: Mapping[str, float] | None = None
    ) -> dict[str, Any]:
        """Begin a flight, or several, and return ``time``, position, velocities, angles, rates, air data, altitude.

        ``x0`` and ``initial_std`` are as for :func:`skdgp.dynamics.simulate`. Without a ``random_state`` the mean of
        the model flies, else functions drawn from its posterior, one for each start.
        """
        starts = as_starts(x0)
        states = initial_states(starts, lambda at: self._air(0.0, at))
        states = perturbed(states, initial_std, 1, random_state)[0]
        single, mean_flies = len(states) == 1, random_state is None
        drawn = None if mean_flies else self._mean.sample(len(states), random_state, correlated=True)
        self.motion.aerodynamics = drawn or self._mean
        self._state = states[0] if single and mean_flies else states
        self._single, self._start, self._steps = single, self._state, 0
        self._ended = np.full(self._state.shape[:-1], FLYING, dtype=object)
        self._implicit: Any = None
        self.beyond = "" if single else np.full(len(states), "", dtype=object)
        return self._seen()

    def step(self, controls: Mapping) -> dict[str, Any]:
        """Return what is seen after a step with controls by name; raises ValueError before `reset` or after the end."""
        if self._state is None or not (self._ended == FLYING).any():
            what = "no start yet" if self._state is None else f"a flight that has ended ({self.ended})"
            raise ValueError(f"Got {what}, but expected one that flies: call reset(x0).")
        controls = self.motion.mixed(controls)

        def at(t, state):
            now = self.motion.at(state, controls, self._air(t, state), self._implicit)
            self._implicit = now.implicit
            return now

        with np.errstate(all="ignore"):  # what diverges is ended
            state = rk4_step(lambda t, x: at(t, x).derivative, self.time, self._state, self.dt)
            self._steps += 1
            now = at(self.time, state)
            for reason, where in end_reasons(state, now).items():
                self._ended[np.broadcast_to(where, self._ended.shape) & (self._ended == FLYING)] = reason
        names = np.array(["", *self.motion.regressors], dtype=object)[beyond(self.motion, now.regressors)]
        self.beyond = str(np.reshape(names, -1)[0]) if self._single else names
        flying = self._ended == FLYING
        self._state = state if flying.all() else np.where(flying[..., None], state, self._start)
        return self._seen()

    def _seen(self) -> dict[str, Any]:
        air = self._air(self.time, self._state)
        seen: dict[str, Any] = {"time": self.time} | channels(self._state, None if air is None else air.wind)
        over = self._ended != FLYING
        if over.any():
            seen = {name: np.where(over, np.nan, value) if name != "time" else value for name, value in seen.items()}
        if not self._single:
            self.ended = self._ended.copy()
            return seen
        self.ended = str(self._ended.reshape(-1)[0])
        return {name: float(np.reshape(value, -1)[0]) for name, value in seen.items()}
