"""Simulation of a model: the loop over time, the states it records, trajectories, and bands of an ensemble."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.messages import warn
from skdgp._compute.parallel import threads_for
from skdgp._compute.statistics import path_quantiles
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.checks import check_columns, check_number
from skdgp._flight.frames import (
    air_data,
    body_to_ned,
    ned_to_body,
    quaternion_to_euler,
    unwrapped_paths,
)
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._aerodynamics import Aerodynamics
from skdgp.dynamics._air import AirAt, Turbulence, as_air
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._inputs import (
    Clock,
    UncertainStart,
    airspeeds,
    as_starts,
    control_schedule,
    drift_in,
    gusty_air,
    initial_states,
    met_turbulence,
    perturbed,
    tables_of,
    warn_of_clocks,
    wind_schedule,
)
from skdgp.dynamics._motion import PROPULSION, Instant, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY, rk4_step
from skdgp.dynamics._servos import Servos
from skdgp.dynamics._trim import Trim

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


def fly_record(
    motion: Motion,
    commands: Callable,
    air: AirAt,
    clock: Clock,
    state: Array,
    drifts: Array | None = None,
    deflections: Mapping[str, Array] | None = None,
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

    now, reached = None, dict(deflections or {})  # and the deflections at the end of the last step
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
    fine = (
        np.isfinite(now.derivative).all(axis=-1)
        & (np.abs(state[..., VELOCITY]) < FASTEST).all(axis=-1)
        & (np.abs(state[..., rigid_body.RATES]) < SPINNING).all(axis=-1)
    )
    reasons: dict[str, Any] = {
        "airspeed": now.airspeed < SLOWEST,
        "altitude": np.isnan(now.density) & np.isfinite(state[..., 2]),
        "diverged": ~fine,
        "fixed point": np.logical_not(now.settled),
    }
    return {reason: where for reason, where in reasons.items() if np.any(where)}


BEYOND = 0.02  # Fraction of its training range by which a regressor may exceed it without a warning
TINY = 1e-12
UNKNOWN_FORCE = np.full(3, np.nan)


def simulate(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    x0: Any,
    controls: Any,
    dt: float = 0.02,
    *,
    duration: float | None = None,
    air: Any = None,
    n_paths: int | None = None,
    random_state: Seed = 0,
    thrust: str | None = "auto",
) -> pd.DataFrame:
    r"""Return the flight of an aircraft with learned aerodynamics: RK4 over the six degrees of freedom.

    At every stage the regressors are rebuilt from the simulated state as the pipeline builds them
    from a log; those that follow from the loads (alpha_dot, beta_dot, p_dot, q_dot, r_dot, ax, ay,
    az) are found by fixed point.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        Gives the coefficients: see :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    x0 : mapping, Series, DataFrame, Trim, list of Trim or array-like, (13,) or (n_starts, 13)
        The start, or several that are flown together. By name: a row of a flight, or ``airspeed``,
        ``alpha``, ``beta``, ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``, ``altitude``, ...;
        other values are zero. Of paths also an `UncertainStart`.
    controls : DataFrame, list of DataFrame, mapping or callable
        Elevator, aileron, rudder [rad], elevons, throttle and the model's other controls, and what
        gives the thrust. Surfaces are commands, which the servos follow with the lag that the model
        has learned. A table with ``time`` [s], its first row the start (linear between rows; a
        list: one for each start); constants by name; or a feedback law, a function (t, state) to
        values by name, where ``state`` maps the names of channels to arrays, ``state["phi"]``; or
        ``FlightComputer(law)``, which asks it once a step.
    dt : float, default=0.02
        Time step [s].
    duration : float, optional
        [s]; by default as long as the tables.
    air : Air, table, list of tables or array-like (3,), optional
        A wind, as a table or a constant, or an `Air` of wind, gusts, density and gravity. By
        default paths meet the gusts of a wind that is a table, else the gusts of the training
        flights. ``Air(gusts=None)`` is calm.
    n_paths : int, optional
        Number of functions drawn from the posterior to fly instead of the mean, each for a whole
        flight. Their spread is the uncertainty of the trajectory.
    random_state : int or RandomState, default=0
        Of the paths.
    thrust : "auto" or None, default="auto"
        "auto": the controls thrust_x ... thrust_n [N], [N m], or thrust [N] along the thrust line,
        or the propeller at propeller_speed [rad/s] or throttle. None: a glider, or a model whose
        coefficients include the thrust.

    Returns
    -------
    pandas.DataFrame
        A flight table: ``time``, position, velocities, angles, rates, airspeed, alpha, beta,
        altitude, density, ``ax``, ``ay``, ``az``, ``p_dot``, ``q_dot``, ``r_dot``, controls (of the
        surfaces the deflections) and coefficients; ``beyond``, the regressor farthest outside its
        training range, or ""; ``ended``, why the trajectory is over, or "": its rows are then NaN.
        Several starts have a column ``start``, paths also ``path``; ``flight`` names each.
        ``attrs["air"]`` says in words which gusts were met.

    Raises
    ------
    ValueError
        If the start is not finite, controls are missing or end early, nothing gives the thrust, a
        regressor cannot be rebuilt, the model lacks a coefficient or has no posterior to draw from,
        or there is a Turbulence without paths.

    Warns
    -----
    SimulationWarning
        If a trajectory ends early, or leaves the training ranges.
    UserWarning
        If start and controls carry times that do not begin together, or a start does not fit its
        wind.

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
    described = as_air(air)
    motion = Motion(model, aircraft, thrust=thrust, air=described)
    x0, start_std = x0 if isinstance(x0, UncertainStart) else (x0, None)
    starts = as_starts(x0)
    clock = Clock.of(dt, duration, tables_of(controls, described.wind))
    warn_of_clocks(starts, controls, clock.dt)
    local = wind_schedule(described.wind, clock, len(starts))
    mixing = motion.aerodynamics.mixing
    names = {*motion.controls, *PROPULSION, *(() if mixing is None else mixing.surfaces)}
    commands = control_schedule(controls, clock, names, len(starts))
    states = initial_states(starts, lambda start: local(0, start))
    if n_paths is None and isinstance(described.gusts, Turbulence):
        raise ValueError(
            "Got gusts without n_paths, but expected both: gusts are drawn, for each path its own."
        )
    if start_std is not None and n_paths is None:
        raise ValueError("Got an UncertainStart without n_paths: nothing would show it.")
    drifts, sentence = None, ""
    if n_paths is not None:
        met, sentence = met_turbulence(described, local, motion, states)
        speed = float(airspeeds(states, local).mean())
        drift = drift_in(met, motion, speed) if described.drift else None
        if met is not None and np.any(met.intensity):
            local = gusty_air(described, met, local, motion, clock, states, n_paths, random_state)
        motion.aerodynamics = motion.aerodynamics.sample(n_paths, random_state)
        states = perturbed(states, start_std, n_paths, random_state)
        if drift is not None:
            drifts = drift.draw(clock.stages, states.shape[:-1], random_state)
    elif len(states) == 1:
        states = states[0]
    record = fly_record(motion, commands, local, clock, states, drifts)
    warn_of(record, motion)
    first = [table["time"].iloc[0] for table in tables_of(controls)] or [0.0]
    table = trajectory_table(
        record, motion, np.broadcast_to(np.array(first, dtype=float), (len(starts),))
    )
    table.attrs["air"] = sentence
    return table


class Simulator:
    """Step-by-step simulation of an aircraft with a controller: call ``reset``, then ``step`` repeatedly.

    Each step holds the controls for ``dt`` and integrates the equations of `simulate` (RK4).

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    dt : float, default=0.02
        Time step [s].
    air, thrust
        As for :func:`skdgp.dynamics.simulate`; the wind is constant, no gusts are drawn.

    Attributes
    ----------
    ended : str
        Why the flight is over; "" while it is not.
    beyond : str
        After a step: the regressor farthest outside its training range, or "".

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
        self,
        model: Aerodynamics | BaseEstimator,
        aircraft: Aircraft,
        dt: float = 0.02,
        *,
        air: Any = None,
        thrust: str | None = "auto",
    ) -> None:
        air = as_air(air)
        if isinstance(air.gusts, Turbulence):
            raise ValueError("Got a Turbulence, but a Simulator draws no gusts: simulate() does.")
        self.motion = Motion(model, aircraft, thrust=thrust, air=air)
        self.dt = check_number("dt", dt, unit="s")
        self._mean = self.motion.aerodynamics
        if tables_of(air.wind):
            raise ValueError(
                "Got a wind over time, but a Simulator flies in a constant one: simulate() does."
            )
        self._air = wind_schedule(air.wind, Clock(dt, 1), 1)
        self._steps = 0
        self.ended = FLYING
        self.beyond = ""
        self._state: Any = None
        self._specific_force = UNKNOWN_FORCE

    @property
    def time(self) -> float:
        """Since the reset [s]."""
        return self._steps * self.dt

    def reset(
        self, x0: Any, *, controls: Mapping | None = None, random_state: Seed = None
    ) -> dict[str, float]:
        """Begin a flight, and return the observation at its start.

        Parameters
        ----------
        x0
            One start of :func:`skdgp.dynamics.simulate`.
        controls : mapping of str to float, optional
            Controls at the start, for the accelerometers alone; by default the controls of a
            `Trim`.
        random_state : int, RandomState instance or None
            None: the mean of the model flies. Else a function drawn from its posterior.

        Returns
        -------
        dict
            ``time``, position, velocities, angles, rates, air data, altitude; and ``ax``, ``ay``,
            ``az`` [m/s^2], specific force at the centre of gravity, NaN without controls.
        """
        states = initial_states(as_starts(x0), lambda start: self._air(0, start))
        if len(states) > 1:
            raise ValueError(
                f"Got {len(states)} starts, but expected one: simulate() flies several at once."
            )
        self.motion.aerodynamics = self._mean
        if random_state is not None:
            self.motion.aerodynamics = self._mean.sample(1, random_state)
        self._state = states
        self._steps = 0
        self._reached: dict[str, Array] = {}  # deflections at the end of the last step
        self.ended = FLYING
        self.beyond = ""
        if controls is None and isinstance(x0, Trim):
            controls = x0.controls
        self._specific_force = UNKNOWN_FORCE
        if controls is not None:
            now = self.motion.at(states, self.motion.mixed(controls), self._air(0, states))
            self._specific_force = now.force[0] / self.motion.aircraft.mass
        return self._seen()

    def step(self, controls: Mapping) -> dict[str, float]:
        """Return the observation after a step with controls by name.

        It has the entries of :meth:`reset`. Accelerometers show the end of the step, before the
        next controls. All but ``time`` are NaN after the end of the flight. Raises ValueError
        before `reset` or after the end.
        """
        if self._state is None or self.ended:
            what = (
                "no start yet" if self._state is None else f"a flight that has ended ({self.ended})"
            )
            raise ValueError(f"Got {what}, but expected one that flies: call reset(x0).")
        record = fly_record(
            self.motion, lambda step, stage, observe: controls, self._air,
            Clock(self.dt, 1), self._state, deflections=self._reached,
        )  # fmt: skip
        self._steps += 1
        self.ended = record.ended[0]
        farthest = beyond(self.motion, record.regressors[-1])[0]
        self.beyond = ["", *self.motion.regressors][farthest]
        if not self.ended:
            self._state = record.states[-1]
            self._specific_force = record.specific_force[-1, 0]
            self._reached = {name: values[-1] for name, values in record.controls.items()}
        return self._seen()

    def _seen(self) -> dict[str, float]:
        air = self._air(0, self._state)
        columns = channels(self._state, None if air is None else air.wind)
        seen = {name: float(values[0]) for name, values in columns.items()}
        seen |= dict(zip(SPECIFIC_FORCE, self._specific_force.tolist(), strict=True))
        if self.ended:
            seen = dict.fromkeys(seen, np.nan)
        return {"time": self.time} | seen


class SimulationWarning(UserWarning):
    """A trajectory ended early, or left the range of the training data."""


def trajectory_table(record: Any, motion: Motion, first_times: Array) -> pd.DataFrame:
    """Return the record as one flight table: path by path, start by start, row by row.

    The record's trajectories are (), (n_starts,) or (n_paths, n_starts); ``first_times``
    (n_starts,) is the time at each start.
    """
    shape = record.ended.shape
    n_times = len(record.time)
    wind = record.wind

    def column(values: Array) -> Array:
        return np.moveaxis(np.broadcast_to(values, (n_times, *shape)), 0, -1).ravel()

    over = np.arange(n_times).reshape(-1, *[1] * len(shape)) >= record.end
    columns = channels(record.states, wind) | {"density": record.density}
    for names, values in (
        (("p_dot", "q_dot", "r_dot"), record.derivative[..., rigid_body.RATES]),
        (SPECIFIC_FORCE, record.specific_force),
        (COEFFICIENTS, record.coefficients),
    ):
        columns |= {name: values[..., k] for k, name in enumerate(names)}
    if wind is not None:
        columns |= {name: wind[..., k] for k, name in enumerate(WIND)}
    clock = np.add.outer(record.time, first_times)
    table: dict[str, Any] = {
        "time": column(clock[:, None] if len(shape) == 2 else clock.reshape(n_times, *shape)),
        **_identity(shape, n_times),
        **{name: column(values) for name, values in (columns | record.controls).items()},
    }
    farthest = np.array(["", *motion.regressors], dtype=object)[
        column(beyond(motion, record.regressors))
    ]
    table["beyond"] = pd.Categorical(farthest, ["", *motion.regressors])
    table["ended"] = pd.Categorical(column(np.where(over, record.ended, "")))
    return pd.DataFrame(table)


def _identity(shape: tuple[int, ...], n_times: int) -> dict[str, Any]:
    """Return the columns that name the trajectories."""
    if not shape:
        return {"flight": pd.Categorical(["simulation"] * n_times)}
    index = np.indices(shape).reshape(len(shape), -1)
    labels = ("path", "start")[-len(shape) :]
    names = [
        ", ".join(f"{label} {number}" for label, number in zip(labels, numbers, strict=True))
        for numbers in index.T
    ]
    columns: dict[str, Any] = {"flight": pd.Categorical(np.repeat(names, n_times), names)}
    return columns | {
        label: np.repeat(numbers, n_times) for label, numbers in zip(labels, index, strict=True)
    }


def beyond(motion: Motion, regressors: Array) -> np.ndarray:
    """Return the 1-based index of the regressor (..., d) farthest outside its training range, 0 if none is outside."""
    limits = motion.aerodynamics.limits
    if limits is None:
        return np.zeros(regressors.shape[:-1], dtype=int)
    low, high = limits
    outside = np.maximum(low - regressors, regressors - high) / np.maximum(high - low, TINY)
    outside = np.where(np.isfinite(outside), outside, 0.0)
    return np.where(outside.max(axis=-1) > BEYOND, 1 + outside.argmax(axis=-1), 0)


def warn_of(record: Any, motion: Motion) -> None:
    """Warn of trajectories that ended early, and of trajectories that left the training ranges."""
    ended = [reason for reason in record.ended.ravel().tolist() if reason]
    n, dt = record.ended.size, record.time[1]
    if ended:
        why = ", ".join(
            f"{REASONS[reason]}: {ended.count(reason)}" for reason in REASONS if reason in ended
        )
        warn(
            f"{len(ended)} of {n} trajectories ended early, the first {record.end.min() * dt:.2f} "
            f"s after its start "
            f"({why}). Their rows are NaN from there on, and the column ended says why. Look at "
            f"start, controls, wind "
            "and thrust; try a smaller dt.",
            SimulationWarning,
            stacklevel=3,
        )
    outside, limits = (
        beyond(motion, record.regressors).reshape(len(record.time), -1),
        motion.aerodynamics.limits,
    )
    if limits is not None and outside.any():
        first = int(np.flatnonzero(outside.any(axis=1))[0])
        k = int(outside[first].max()) - 1
        (low, high), values = limits[:, k], record.regressors[..., k]
        warn(
            f"{np.count_nonzero(outside.any(axis=0))} of {n} trajectories left what the model was "
            f"learned from, the "
            f"first {first * dt:.2f} s after its start in {motion.aerodynamics.regressors[k]} "
            f"(here "
            f"{np.nanmin(values):.3g} to {np.nanmax(values):.3g}, learned from {low:.3g} to "
            f"{high:.3g}): the column "
            "beyond says where.",
            SimulationWarning,
            stacklevel=3,
        )


def trajectory_bands(
    trajectories: pd.DataFrame, level: float = 0.95, columns: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return the bands of an ensemble that `simulate` returned with ``n_paths``, by ``start`` and ``time``.

    ``level`` is the fraction of the flying paths inside: quantiles (1 - level) / 2
    and (1 + level) / 2. ``columns`` are by default velocities, angles (heading unwrapped), rates,
    airspeed, alpha, beta, altitude. The table has ``<column>`` (the median), ``<column>_low``,
    ``<column>_high``, and ``flying``, the share that has not ended.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import trajectory_bands
    >>> paths = pd.DataFrame({"start": 0, "path": [0, 1, 2], "time": 0.0, "airspeed": [20.0, 21.0, 22.0], "ended": ""})
    >>> trajectory_bands(paths, level=1.0)[["airspeed", "airspeed_low", "airspeed_high"]].iloc[0].tolist()
    [21.0, 20.0, 22.0]
    """
    if not 0 < level <= 1:
        raise ValueError(f"Got level={level!r}, but expected a fraction above 0, at most 1.")
    check_columns(
        trajectories,
        ["start", "path", "time", "ended"],
        what="ensemble (simulate with n_paths=...)",
    )
    candidates = (
        (*EARTH_VELOCITY, *EULER, *RATES, *AIR_DATA, "altitude", "north", "east")
        if columns is None
        else columns
    )
    names = [name for name in candidates if name in trajectories]
    rows = []
    for start, part in trajectories.groupby("start", sort=False):
        n_paths = part["path"].nunique()
        flying = (part["ended"] == "").to_numpy().reshape(n_paths, -1).mean(axis=0)
        band = {"start": start, "time": part["time"].to_numpy()[: len(flying)], "flying": flying}
        for name in names:
            values = part[name].to_numpy(float).reshape(n_paths, -1)
            if name in EULER:
                values = unwrapped_paths(values)
            low, middle, high = path_quantiles(values, level)
            band |= {name: middle, f"{name}_low": low, f"{name}_high": high}
        rows.append(pd.DataFrame(band))
    return pd.concat(rows, ignore_index=True)
