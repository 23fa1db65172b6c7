"""Simulation of a model, as one trajectory or as an ensemble drawn from its posterior."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skdgp._compute.linalg import semidefinite_root
from skdgp._compute.typing import Array, Seed, Vector
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import AIR_DATA, CHANNELS, HAT, RATE_LENGTHS, SENSOR_GUST, TRUTH_SUFFIX, WIND, rate_factor
from skdgp._flight.channels import RATES as BODY_RATES
from skdgp._flight.frames import body_to_ned, ned_to_body
from skdgp.dynamics._control.linearize import jacobian
from skdgp.dynamics._equations.aerodynamics import Drift
from skdgp.dynamics._equations.error_covariance import (
    STATES,
    checked_std,
    error_covariances,
    standard_deviations,
    start_errors,
    state_readouts,
)
from skdgp.dynamics._equations.motion import CONTROLS, Air, Instant, Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, POSITION, RATES, VELOCITY, rk4_step
from skdgp.dynamics._simulation.gusts import Gusts, GustyAir, dryden_gusts
from skdgp.dynamics._simulation.inputs import (
    PROPULSION,
    AirAt,
    Clock,
    as_starts,
    control_schedule,
    initial_states,
    perturbed,
    tables_of,
    warn_of_clocks,
    wind_schedule,
)
from skdgp.dynamics._simulation.trajectory import channels, trajectory_table, warn_of
from skdgp.dynamics._simulation.turbulence import LENGTH, TooShort, Turbulence
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import Thrust

SLOWEST = 1.0
"""Airspeed [m/s] below which a trajectory ends: no angle of attack is known there."""
FASTEST, SPINNING = 1000.0, 60.0
"""Velocity [m/s] and rate [rad/s] beyond which a trajectory has diverged."""
FLYING = ""
STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))
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
    wind: Any = None,
    gusts: Turbulence | Literal["auto"] | float | None = "auto",
    n_paths: int | None = None,
    random_state: Seed = 0,
    drift: bool = True,
    return_std: bool = False,
    initial_std: Mapping[str, float] | None = None,
    thrust: Thrust = "auto",
    density: float | Callable | None = None,
    gravity: float = STANDARD_GRAVITY,
    hold: bool = False,
) -> pd.DataFrame:
    r"""Return the flight of an aircraft with learned aerodynamics: RK4 over the six degrees of freedom.

    At every stage the regressors are rebuilt from the simulated state as the pipeline builds them from a log, the
    model gives the coefficients, and Newton's and Euler's equations the rest (`rigid_body_derivative`). Regressors
    that follow from the loads (alpha_dot, beta_dot, p_dot, q_dot, r_dot, ax, ay, az) are found by fixed point.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        Gives the coefficients: see :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
        Mass, inertia, reference lengths, thrust line and propeller.
    x0 : mapping, Series, DataFrame, Trim, list of Trim or array-like of shape (13,) or (n_starts, 13)
        The start, or several that are flown together. By name: a row of a flight, or ``airspeed``, ``alpha``, ``beta``,
        ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``, ``altitude``, ...; what is not given is zero.
    controls : DataFrame, list of DataFrame, mapping or callable
        Elevator, aileron, rudder [rad], elevons, throttle and the model's other controls, and what gives the thrust: a
        table with ``time`` [s], its first row the start (linear between rows; a list: one for each start); constants
        by name; or a feedback law, a function (t, state) to values by name, where ``state`` maps the names of
        channels to arrays, ``state["phi"]``.
    dt : float, default=0.02
        Time step [s].
    duration : float, optional
        [s]; by default as long as the tables.
    wind : array-like (3,), DataFrame or callable, optional
        Velocity of the air, north, east, down [m/s]: constant; a table with ``time``, ``wind_north``, ``wind_east``,
        ``wind_down``; or a function (t, position (..., 3)).
    gusts : "auto", Turbulence, float or None, default="auto"
        Turbulence in which each path meets gusts of its own, with their rates p, q, r, besides the ``wind``. A table or
        function as ``wind`` contains the velocity of the gusts: then only rates are drawn. "auto": that of this table
        or function (`Turbulence.from_wind`), else that of the training flights, if the model knows it. A number: that
        of the training flights, with vertical gusts of this standard deviation [m/s]. None: calm air.
    n_paths : int, optional
        Number of functions drawn to fly instead of the mean, each for a whole flight: from the posterior, with errors
        by noise that is correlated between samples, which it does not contain. Their spread is the uncertainty of the
        trajectory.
    random_state : int or RandomState, default=0
        Of the paths.
    drift : bool, default=True
        Whether each path, and ``return_std``, also has a drift of its own flight: errors of the coefficients that
        change slowly, as the residuals of the training flights did, besides what drawn gusts explain. In calmer air it
        is smaller, in calm air the misfit of the function alone; where the model does not know the turbulence of its
        flights, it is as large as theirs. False: the uncertainty of the aircraft alone.
    return_std : bool, default=False
        Whether to add columns ``airspeed_std``, ``phi_std``, ... of the mean's trajectory: standard deviations by the
        joint posterior of the coefficients along it, to first order, with the rates of gusts, but no velocity of gusts.
        Fast, and right for some seconds, while errors are small; ``n_paths`` is right for longer.
    initial_std : mapping of str to float, optional
        Standard deviations of the start, for paths or ``return_std``, by name ("u", "v", "w", "v_north", ..., "phi",
        ...). Those of angles alone leave the velocity over the ground as it is, which is how it is measured.
    thrust : "auto", callable or None, default="auto"
        "auto": the controls thrust_x ... thrust_n [N], [N m], or thrust [N] along the thrust line, or the propeller at
        propeller_speed [rad/s] or throttle. A function (controls, airspeed, density) to newtons along the thrust
        line. None: a glider, or a model whose coefficients include the thrust.
    density : float or callable, optional
        [kg/m^3], or a function of altitude [m]; by default the standard atmosphere.
    gravity : float, default=9.80665
        [m/s^2].
    hold : bool, default=False
        Whether a feedback law is asked once a step, as in a flight computer; else at every stage.

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
        rebuilt, the model lacks a coefficient or has no posterior to draw from, there is a Turbulence or a number as
        ``gusts`` without paths, or a number and the model does not know the turbulence of its flights.

    Warns
    -----
    SimulationWarning
        If a trajectory ends early (it diverged, lost its airspeed, or no fixed point was found), or leaves what the
        model was learned from.
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
    motion = Motion(model, aircraft, thrust=thrust, gravity=gravity, density=density)
    starts = as_starts(x0)
    clock = Clock.of(dt, duration, tables_of(controls, wind))
    warn_of_clocks(starts, controls, wind, clock.dt)
    air = wind_schedule(wind, clock, len(starts))
    commands = control_schedule(controls, clock, is_control(motion), len(starts), hold=hold)
    states = initial_states(starts, lambda at: air(0, at))
    if n_paths is None and not (gusts is None or (isinstance(gusts, str) and gusts == "auto")):
        raise ValueError("Got gusts without n_paths, but expected both: gusts are drawn, for each path its own.")
    met, said = _turbulence(gusts, wind, air, motion, clock, states) if n_paths or return_std else (None, "")
    drifting = None
    if drift and (n_paths or return_std):
        speed = float(_airspeed(states, air).mean())
        drifting = _drift_in(met, motion, speed, drawn=n_paths is not None)
    if n_paths is not None:
        if met is not None and np.any(met.intensity):
            air = _gusty(air, met, _varies(wind), motion, clock, states, n_paths, random_state)
        motion.aerodynamics = motion.aerodynamics.sample(n_paths, random_state, correlated=True)
        states = perturbed(states, initial_std, n_paths, random_state)
        if return_std:
            raise ValueError("Got n_paths and return_std=True, but expected one of them: paths spread by themselves.")
    elif initial_std is not None and not return_std:
        raise ValueError("Got initial_std without n_paths or return_std=True: nothing would show it.")
    elif len(states) == 1:
        states = states[0]
    drifts = None
    if drifting is not None and n_paths is not None:
        drifts = drifting.draw(clock.stages, states.shape[:-1], random_state)
    record = fly_record(motion, commands, air, clock, states, drifts)
    warn_of(record, motion)
    std = linear_std(record, motion, initial_std, drifting) if return_std else {}
    first = [table["time"].iloc[0] for table in tables_of(controls)] or [0.0]
    table = trajectory_table(record, motion, np.broadcast_to(np.array(first, dtype=float), (len(starts),)), std)
    table.attrs["air"] = said
    return table


def _turbulence(
    gusts: Any, wind: Any, air: AirAt, motion: Motion, clock: Clock, states: Array
) -> tuple[Turbulence | None, str]:
    """Return the turbulence to fly in, None if nobody knows it, and a sentence that says what it is."""
    flown = motion.aerodynamics.turbulence
    if gusts is None:
        return STILL, "Air without gusts, as asked."
    if isinstance(gusts, Turbulence):
        intensity, length = (np.asarray(part, dtype=float) for part in gusts[:2])
        size = np.stack([intensity, length]) if intensity.shape == length.shape == (3,) else np.full((2, 3), np.nan)
        if not (np.isfinite(size).all() and (intensity >= 0).all() and (length > 0).all()):
            raise ValueError(f"Got {gusts}, but expected three intensities >= 0 [m/s] and lengths > 0 [m], of u, v, w.")
        return gusts, f"Gusts {_sizes(gusts)}, as asked."
    scaled = isinstance(gusts, Real) and not isinstance(gusts, bool) and 0.0 <= float(gusts) < np.inf
    if not scaled and not (isinstance(gusts, str) and gusts == "auto"):
        raise ValueError(
            f"Got gusts={gusts!r}, but expected 'auto', a Turbulence, an intensity [m/s] from 0 on, or None."
        )
    if not scaled and _varies(wind):
        found = _turbulence_of(wind, air, motion, clock, states)
        if found is not None:
            return found, f"Gusts as those of the wind, {_sizes(found)}."
    if flown is None and scaled:
        raise ValueError(
            f"Got gusts={gusts!r}, but the model does not know the turbulence of its flights: their tables lack "
            "airspeed, alpha, beta, attitude or v_north, v_east, v_down, or last less than 30 s. Give "
            "Turbulence.from_flight(flight, span) or Turbulence.low_altitude(height, wind_at_6m)."
        )
    if flown is None:
        return None, "No gusts are drawn, but errors as in the training flights: their turbulence is not known."
    if scaled:
        found = flown.scaled(float(gusts) / flown.intensity[2])
        return found, f"Gusts {_sizes(found)}, as asked."
    return flown, f"Gusts as in the training flights, {_sizes(flown)}: nothing else is said of the air."


def _sizes(turbulence: Turbulence) -> str:
    """Return the intensities in words."""
    u, v, w = turbulence.intensity
    return f"{u:.2g}, {v:.2g}, {w:.2g} m/s (u, v, w)"


def _varies(wind: Any) -> bool:
    """Return whether a wind contains its gusts: a table or a function."""
    return callable(wind) or bool(tables_of(wind))


def _turbulence_of(wind: Any, air: AirAt, motion: Motion, clock: Clock, states: Array) -> Turbulence | None:
    """Return the turbulence of a wind, None if it is too short to show it; a function is followed straight ahead."""
    speeds, tables = _airspeed(states, air), tables_of(wind)
    if not tables:
        ground = body_to_ned(states[:, ATTITUDE], states[:, VELOCITY])
        met = []
        for k in range(clock.n_steps + 1):
            moved = states.copy()
            moved[:, POSITION] += k * clock.dt * ground
            met.append(np.broadcast_to(air(2 * k, moved).wind, (len(states), 3)))  # type: ignore[union-attr]
        time = clock.dt * np.arange(clock.n_steps + 1)
        tables = [pd.DataFrame(w, columns=[*WIND]).assign(time=time) for w in np.stack(met, axis=1)]
    try:
        return Turbulence.from_wind(tables, speeds if len(tables) > 1 else speeds.mean(), motion.aircraft.span)
    except TooShort:
        return None


def _gusty(
    air: AirAt,
    turbulence: Turbulence,
    rates_alone: bool,
    motion: Motion,
    clock: Clock,
    states: Array,
    n_paths: int,
    random_state: Any,
) -> GustyAir:
    """Return the air (n_paths, n_starts) with gusts of the turbulence, or with their rates alone."""
    seed = check_random_state(random_state).randint(2**31 - 1, size=5)  # other numbers than those of the paths
    n = len(states)
    length, intensity = (np.tile(part, (n, 1)) for part in (turbulence.length, turbulence.intensity))
    drawn = dryden_gusts(
        len(clock.stages), 0.5 * clock.dt, _airspeed(states, air), length, intensity, motion.aircraft.span,
        np.random.default_rng(seed), n_draws=n_paths,
    )  # fmt: skip
    parts = [part.reshape(len(part), -1, n, 3) for part in drawn]
    if rates_alone:
        parts[:2] = (np.zeros_like(part) for part in parts[:2])
    return GustyAir(air, Gusts(*parts))


def _drift_in(met: Turbulence | None, motion: Motion, start_speed: float, *, drawn: bool) -> Drift | None:
    r"""Return the drift in the turbulence that is met; ``drawn``: besides the rates of its gusts.

    Of the variance :math:`\tau^2` that the training flights had, the misfit m is of the function, and the rates of
    their gusts explain g. The rest are other effects of gusts, and errors of regressors that a simulation lacks. It is

    .. math:: m + \min(1, \rho) (\tau^2 - g - m) + \rho g,
              \quad \rho = \frac{\sigma^2 + \sigma_0^2}{\sigma_\mathrm{flown}^2 + \sigma_0^2},

    without the last term where rates are drawn; :math:`\sigma_0` is what sensors show of calm air.
    """
    model = motion.aerodynamics
    drift, flown = model.drift, model.turbulence
    if drift is None or flown is None or met is None:
        return drift
    speed = start_speed if flown.airspeed is None else flown.airspeed
    middle = np.zeros(len(model.regressors)) if model.limits is None else model.limits.mean(axis=0)
    gradient = model.gradient(middle[None])[0]
    slopes = np.zeros((6, 3))
    for k, regressor in enumerate(model.regressors):
        name = regressor.removesuffix(TRUTH_SUFFIX)
        rate = name.removesuffix(HAT)
        if rate in BODY_RATES:
            length = getattr(motion.aircraft, RATE_LENGTHS[rate])
            factor = 1.0 if rate == name else rate_factor(rate, length, np.array(speed))
            slopes[:, BODY_RATES.index(rate)] += gradient[:, k] * factor
    besides = flown.without_rotation(drift, slopes, speed, motion.aircraft.span).variance
    ratio = np.divide(*(np.square(part.intensity).sum() + SENSOR_GUST**2 for part in (met, flown)))
    variance = drift.misfit + min(1.0, ratio) * np.maximum(besides - drift.misfit, 0.0)
    return drift._replace(variance=variance if drawn else variance + ratio * (drift.variance - besides))


def _airspeed(states: Array, air: AirAt) -> Vector:
    """Return the airspeed of starts (n, 13)."""
    here = air(0, states)
    wind = 0.0 if here is None else ned_to_body(states[:, ATTITUDE], np.broadcast_to(here.wind, (len(states), 3)))
    return np.linalg.norm(states[:, VELOCITY] - wind, axis=-1)


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
                state = _step(instant, k, state, now, clock.dt)
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


def _step(instant: Callable, k: int, state: Array, now: Instant, dt: float) -> Array:
    """Return the states one step on."""

    def derivative(t, x):
        stage = round(2 * t / dt)
        return now.derivative if stage == 0 else instant(k, stage, x, now)[0].derivative

    return rk4_step(derivative, 0.0, state, dt)


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
    """Return the standard deviations along trajectories () or (n_starts,), by name, (n_times, ...), to first order.

    Errors of the model at the points passed are jointly Gaussian, with its posterior covariance, and that of a drift.
    """
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
    """Return the standard deviations (n, 18) of `STATES` and `AIR_DATA` along the first n steps of one trajectory."""
    states = record.states[(slice(n), *place)]
    knots = np.unique(np.append(np.arange(0, n, max(1, -(-n // MOST_KNOTS))), n - 1))
    at: Any = (knots, *place)
    wind = None if record.wind is None else Air(record.wind[at])
    slopes = jacobian(
        motion, record.states[at], {name: values[at] for name, values in record.controls.items()}, air=wind
    )
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

    covariances = error_covariances(samples(), [record.time[1]] * (n - 1), start_errors(start, states[0]))
    readouts, air_data = state_readouts(states), slopes.outputs_state[:, :3]
    return np.stack([
        standard_deviations(covariance, np.concatenate([readouts[step], between(air_data, step)]))
        for step, covariance in enumerate(covariances)
    ])  # fmt: skip


def is_control(motion: Motion) -> Callable[[str], bool]:
    """Return the function that finds the controls among the columns of a table, which may be a whole log."""
    if callable(motion.thrust):
        return lambda name: (name in CONTROLS or name not in CHANNELS) and not name.endswith(TRUTH_SUFFIX)
    mixing = motion.aerodynamics.mixing
    known = {*motion.controls, *PROPULSION, *(() if mixing is None else mixing.surfaces)}
    return lambda name: name in known
