"""Simulation of a model: `simulate` flies a whole flight, `Simulator` one step at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Seed, Vector
from skdgp._flight.channels import SENSOR_GUST, SPECIFIC_FORCE, WIND
from skdgp._flight.frames import by_components
from skdgp._flight.tables import check_number
from skdgp.dynamics._aerodynamics import Aerodynamics, Drift, separate_generator
from skdgp.dynamics._air import (
    LocalAir,
    Turbulence,
    as_air,
    gusty_air,
    turbulence_of_winds,
)
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._dryden import Gusts, dryden_gusts, gust_stream
from skdgp.dynamics._inputs import (
    as_starts,
    control_schedule,
    initial_states,
    stages_of,
    tables_of,
    warn_of_clocks,
    wind_schedule,
)
from skdgp.dynamics._integrate import FLYING, Integrator, channels, end_reasons, fly_record
from skdgp.dynamics._motion import PROPULSION, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY
from skdgp.dynamics._trajectories import (
    SimulationWarning,
    farthest_beyond,
    trajectory_table,
    warn_of,
)
from skdgp.dynamics._trim import Trim

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
    from a flight, alpha_dot and beta_dot, which follow from the loads, by fixed point.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        Gives the coefficients: see :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    x0 : mapping, Series, DataFrame, Trim or list of Trim
        The start, or several that are flown together. By name: a row of a flight, or ``airspeed``,
        ``alpha``, ``beta``, ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``, ``altitude``, ...;
        other values are zero.
    controls : DataFrame, list of DataFrame, mapping or callable
        Elevator, aileron, rudder [rad], elevons, throttle and the model's other controls, and what
        gives the thrust. Surfaces are commands, which the servos follow with the delay and the lag
        that the model has learned. A table with ``time`` [s], its first row the start (linear between rows; a
        list: one for each start); constants by name; or a feedback law, a function (t, state) to
        values by name, where ``state`` maps the names of channels to arrays, ``state["phi"]``: it is
        asked once a step, as a flight computer.
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
        Of the paths and the gusts; the gusts of the mean are drawn, too.
    thrust : "auto" or None, default="auto"
        "auto": the controls thrust_x ... thrust_n [N], [N m], or thrust [N] along the thrust line,
        or the propeller at propeller_speed [rad/s] or throttle. None: a glider, or a model whose
        coefficients include the thrust.

    Returns
    -------
    pandas.DataFrame
        A flight table: ``time``, position, velocities, angles, rates, airspeed, alpha, beta,
        altitude, density, ``ax``, ``ay``, ``az`` at the centre of gravity, ``p_dot``, ``q_dot``,
        ``r_dot``, controls (of the surfaces the deflections) and coefficients; ``beyond``, the
        regressor farthest outside its training range, or ""; ``ended``, why the trajectory is over,
        or "": its rows are then NaN.
        Several starts have a column ``start``, paths also ``path``; ``flight`` numbers each.

    Raises
    ------
    ValueError
        If the start is not finite, controls are missing or end early, nothing gives the thrust, a
        regressor cannot be rebuilt, or the model lacks a coefficient or has no posterior to draw from.

    Warns
    -----
    SimulationWarning
        If a trajectory ends early, or leaves the training ranges; if paths meet no gusts as the model
        knows no turbulence.
    UserWarning
        If start and controls carry times that do not begin together, or a start does not fit its
        wind.

    Notes
    -----
    Paths do not have the errors of lag and delay of the servos, as those of
    :func:`skdgp.dynamics.linearize` have: all fly with the same servos.

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
    given_air = as_air(air)
    motion = Motion(model, aircraft, thrust=thrust, air=given_air)
    starts = as_starts(x0)
    n_starts = len(starts)
    tables = tables_of(controls, "controls", n_starts)
    winds = tables_of(given_air.wind, "wind", n_starts)
    stages = stages_of(dt, duration, [*tables, *winds])
    warn_of_clocks(starts, tables, dt)
    air_schedule = wind_schedule(given_air.wind, winds, stages)
    names = {*motion.inputs, *PROPULSION}
    commands = control_schedule(controls, tables, stages, names)
    states = initial_states(starts, partial(air_schedule, 0))
    wind = air_schedule(0, states).velocity(states[:, ATTITUDE])
    speeds = channels(states, wind)["airspeed"]
    turbulence = _turbulence_met(given_air.gusts, winds, motion, speeds, n_paths)
    drifts = None
    if n_paths is not None:
        states = np.tile(states, (n_paths, 1, 1))
        drift = drift_in_still_air(motion.aerodynamics) if given_air.drift else None
        if drift is not None:
            drifts = drift.draw(stages, states.shape[:-1], random_state)
        drawn = motion.aerodynamics.sample(n_paths, random_state)
        motion = motion.with_aerodynamics(drawn)
    elif len(states) == 1:
        states = states[0]  # a single start has no axis
    if turbulence is not None:
        generator = separate_generator(random_state, 5)
        span = motion.aircraft.span
        gusts = _drawn_gusts(turbulence, stages, states.shape[:-1], speeds, span, generator)
        if winds:  # contain their velocity
            velocity = np.zeros_like(gusts.velocity)
            gusts = gusts._replace(velocity=velocity, acceleration=velocity)
        air_schedule = gusty_air(air_schedule, gusts)
    record = fly_record(motion, commands, air_schedule, stages, states, drifts)
    farthest = farthest_beyond(motion, record.instants.regressors)
    warn_of(record, motion, farthest)
    table_times = [float(table["time"].iloc[0]) for table in tables]
    first_times = np.broadcast_to(table_times or 0.0, n_starts)
    return trajectory_table(record, motion, farthest, first_times)


def _turbulence_met(
    gusts: Any, tables: Sequence[pd.DataFrame], motion: Motion, speeds: Vector, n_paths: int | None
) -> Turbulence | None:
    """Return the turbulence of the gusts to draw, None for none; warn where that of paths is not known."""
    if gusts is None or isinstance(gusts, Turbulence):
        return gusts
    if n_paths is None:
        return None
    met = speeds if len(tables) > 1 else [speeds.mean()] * len(tables)
    winds = []
    for table, speed in zip(tables, met, strict=True):
        winds.append(table[["time", *WIND]].assign(airspeed=speed))
    turbulence = turbulence_of_winds(winds, motion.aircraft.span) or motion.aerodynamics.turbulence
    if turbulence is None:
        warn(
            "The model does not know the turbulence of its flights, so the paths meet no gusts of their own: give "
            "air=Air(gusts=Turbulence.low_altitude(height, wind_at_6m)), or Air(gusts=None) for calm air.",
            SimulationWarning,
        )
    return turbulence


def _drawn_gusts(
    turbulence: Turbulence,
    stages: Array,
    shape: tuple[int, ...],
    speeds: Vector,
    span: float,
    generator: np.random.Generator,
) -> Gusts:
    """Return gusts (n_stages, *shape, 3) of trajectories (), (n_starts,) or (n_paths, n_starts)."""
    n_starts = len(speeds)
    drawn = dryden_gusts(
        len(stages),
        stages[1],
        speeds,
        np.tile(turbulence.length, (n_starts, 1)),
        np.tile(turbulence.intensity, (n_starts, 1)),
        span,
        generator,
        n_draws=math.prod(shape) // n_starts,
    )
    return Gusts(*(by_components(part.reshape(-1, *shape, 3)) for part in drawn))


def drift_in_still_air(model: Aerodynamics) -> Drift | None:
    r"""Return the part of a drift that is not of the gusts of the training flights, all of it if these are unknown.

    Of the variance :math:`\tau^2` it is :math:`\sigma_0^2 / (\sigma_\mathrm{flown}^2 + \sigma_0^2)`, with
    what sensors show of calm air, :math:`\sigma_0`. Gusts, with their rates, are drawn themselves: with the whole
    drift besides, spreads of the roll rate were 1.5 times the true ones, without it 0.9 to 1.1.
    """
    drift = model.drift
    flown = model.turbulence
    if drift is None or flown is None:
        return drift
    flown_power = np.sum(np.square(flown.intensity)) + SENSOR_GUST**2
    return drift._replace(variance=SENSOR_GUST**2 / flown_power * drift.variance)


class Simulator:
    """Step-by-step simulation of an aircraft with a controller: call ``reset``, then ``step`` repeatedly.

    Each step holds the controls and integrates the equations of `simulate` (RK4).

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    dt : float, default=0.02
        Time step [s].
    air, thrust
        As for :func:`skdgp.dynamics.simulate`; the wind is constant. Gusts are met if they are a `Turbulence`.

    Attributes
    ----------
    time : float
        Since the reset [s].
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
    >>> state = simulator.reset({"airspeed": 12.0, "alpha": 0.05, "phi": 0.0, "altitude": 100.0})
    >>> for _ in range(150):
    ...     state = simulator.step({"aileron": 1.5 * (0.4 - state["phi"]) - 0.3 * state["p"]})
    >>> round(state["time"], 2), abs(state["phi"] - 0.4) < 0.05
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
        self.motion = Motion(model, aircraft, thrust=thrust, air=air)
        self.dt = check_number("dt", dt, unit="s")
        self._mean_motion = self.motion
        self._wind = wind_schedule(air.wind, [], np.zeros(1))(0, np.zeros(13))
        self._turbulence = air.gusts if isinstance(air.gusts, Turbulence) else None
        self._flight: Any = None

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
            None: the mean of the model flies. Else a function drawn from its posterior. Also of the gusts.

        Returns
        -------
        dict
            ``time``, position, velocities, angles, rates, air data, altitude; and ``ax``, ``ay``,
            ``az`` [m/s^2], specific force at the centre of gravity, NaN without controls.
        """
        states = initial_states(as_starts(x0), lambda states: self._wind)
        if len(states) > 1:
            raise ValueError(
                f"Got {len(states)} starts, but expected one: simulate() flies several at once."
            )
        motion = self._mean_motion
        if random_state is not None:
            drawn = motion.aerodynamics.sample(1, random_state)
            motion = motion.with_aerodynamics(drawn)
        self.motion = motion
        self.time = 0.0
        self.ended = FLYING
        self.beyond = ""
        self._air = self._wind
        self._gust_step: float | None = None
        self._generator = separate_generator(0 if random_state is None else random_state, 5)
        if controls is None and isinstance(x0, Trim):
            controls = x0.controls
        self._flight = Integrator(motion, states[0], self.dt)
        if controls is not None:
            self._flight.now = motion.at(states[0], motion.mixed(controls), self._air)
        return self._seen()

    def step(self, controls: Mapping, duration: float | None = None) -> dict[str, float]:
        """Return the observation after a step with controls by name, of a ``duration`` [s], by default ``dt``.

        A longer one is integrated in steps of at most ``dt``. The observation has the entries of
        :meth:`reset`. Accelerometers show the last stage of the integration, before the next controls. All
        but ``time`` are NaN after the end of the flight. Raises ValueError before `reset` or after the end.
        """
        if self._flight is None:
            raise ValueError("Got no start yet, but expected a flight: call reset(x0).")
        if self.ended:
            raise ValueError(
                f"Got a flight that has ended ({self.ended}), but expected one that flies: "
                "call reset(x0)."
            )
        duration = self.dt if duration is None else duration
        n_steps = max(1, math.ceil(duration / self.dt - 1e-6))
        flight = self._flight
        flight.dt = duration / n_steps
        mixed = self.motion.mixed(controls)

        def inputs(stage: int, state: Array) -> tuple[LocalAir, dict, float]:
            return self._air, mixed, 0.0

        with np.errstate(all="ignore"):  # what diverges is ended
            for _ in range(n_steps):
                self._meet_gust(flight.dt)
                flight.begin(inputs)
                flight.step(inputs)
            reasons = end_reasons(flight.state, flight.now)
        self.state[ATTITUDE] /= np.linalg.norm(self.state[ATTITUDE])
        self.time += duration
        farthest = int(farthest_beyond(self.motion, flight.now.regressors))
        self.beyond = ["", *self.motion.regressors][farthest]
        self.ended = next(iter(reasons), FLYING)
        return self._seen()

    @property
    def state(self) -> Array:
        """State (13,), see `STATE_NAMES`."""
        return self._flight.state

    def _meet_gust(self, dt: float) -> None:
        """Draw the gusts of the next step of ``dt`` [s]."""
        if self._turbulence is None:
            return
        turbulence = self._turbulence
        if dt != self._gust_step:
            self._gust_step = dt
            airspeed = np.linalg.norm(self.state[VELOCITY])
            size = ([turbulence.length], [turbulence.intensity], self.motion.aircraft.span)
            self._gusts = gust_stream(dt, airspeed, *size, self._generator)
        gusts = Gusts(*(part[0] for part in next(self._gusts)))
        self._air = self._wind._replace(gusts=gusts)

    def _seen(self) -> dict[str, float]:
        wind = self._air.velocity(self.state[ATTITUDE])
        readings = {name: float(value) for name, value in channels(self.state, wind).items()}
        now = self._flight.now
        force = UNKNOWN_FORCE if now is None else now.force
        specific_force = force / self.motion.aircraft.mass
        readings |= dict(zip(SPECIFIC_FORCE, specific_force.tolist(), strict=True))
        if self.ended:
            readings = dict.fromkeys(readings, np.nan)
        return {"time": self.time, **readings}
