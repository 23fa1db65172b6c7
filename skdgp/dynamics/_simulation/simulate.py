"""Simulation of a model, as one trajectory or as an ensemble drawn from its posterior."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS, TRUTH_SUFFIX
from skdgp.dynamics._equations.motion import CONTROLS, Motion
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY
from skdgp.dynamics._simulation.fly import fly
from skdgp.dynamics._simulation.schedules import (
    PROPULSION,
    Clock,
    control_schedule,
    tables_of,
    warn_of_clocks,
    wind_schedule,
)
from skdgp.dynamics._simulation.spread import linear_std
from skdgp.dynamics._simulation.starts import as_starts, initial_states, perturbed
from skdgp.dynamics._simulation.trajectory import trajectory_table, warn_of
from skdgp.dynamics._vehicle.aircraft import Aircraft

__all__ = ["simulate"]


def simulate(
    model,
    aircraft: Aircraft,
    x0,
    controls,
    dt: float = 0.02,
    *,
    duration: float | None = None,
    wind=None,
    n_paths: int | None = None,
    random_state=0,
    return_std: bool = False,
    initial_std: Mapping[str, float] | None = None,
    thrust: str | Callable | None = "auto",
    density: float | Callable | None = None,
    gravity: float = STANDARD_GRAVITY,
    hold: bool = False,
) -> pd.DataFrame:
    r"""Fly the aircraft by its learned aerodynamics: RK4 over the six degrees of freedom.

    At every stage the regressors are rebuilt from the simulated state as the pipeline builds them from a log, the
    model gives the coefficients, and Newton's and Euler's equations the rest (`rigid_body_derivative`). Regressors
    that follow from the loads (alpha_dot, beta_dot, p_dot, q_dot, r_dot, ax, ay, az) are found by fixed point.

    Parameters
    ----------
    model : Pipeline, estimator or Aerodynamics
        What gives the coefficients: see :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
        Mass, inertia, reference lengths, thrust line and propeller.
    x0 : mapping, Series, DataFrame, Trim, list of Trim or array-like of shape (13,) or (n_starts, 13)
        The start, or several that are flown together. By name: a row of a flight, or ``airspeed``, ``alpha``, ``beta``,
        ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``, ``altitude``, ...; what is not given is zero.
    controls : DataFrame, list of DataFrame, mapping or callable
        Elevator, aileron, rudder [rad], elevons, throttle and what else the model knows, and what tells the thrust. A
        table with ``time`` [s], its first row the start (linear between rows; a list: one for each start); constants
        by name; or a function (t, state) to values by name, where ``state`` is a mapping of the vocabulary's names,
        ``state["phi"]``, to arrays: a feedback law.
    dt : float, default=0.02
        Time step [s].
    duration : float, optional
        [s]; by default as long as the tables.
    wind : array-like (3,), DataFrame or callable, optional
        Velocity of the air, north, east, down [m/s]: constant; a table with ``time``, ``wind_north``, ``wind_east``,
        ``wind_down``; or a function (t, position (..., 3)).
    n_paths : int, optional
        Fly so many functions drawn from the posterior instead of its mean: each path has its own aerodynamics for the
        whole flight, as the aircraft has. Their spread is the uncertainty of the trajectory.
    random_state : int or RandomState, default=0
        Of the paths.
    return_std : bool, default=False
        Whether to add columns ``airspeed_std``, ``phi_std``, ... of the mean's trajectory: standard deviations by the
        joint posterior of the coefficients along it, to first order. Cheap, and right while errors are small: some
        seconds; ``n_paths`` is right for longer.
    initial_std : mapping of str to float, optional
        Standard deviations of the start, for paths or ``return_std``: by name ("u", "v", "w", "v_north", ..., "phi",
        ...). Those of angles alone leave the velocity over the ground as it is, which is how it is measured.
    thrust : "auto", callable or None, default="auto"
        "auto": the controls thrust_x ... thrust_n [N], [N m], or thrust [N] along the thrust line, or the propeller at
        propeller_speed [rad/s] or throttle. A function (controls, airspeed, density) to newtons along the thrust
        line. None: a glider.
    density : float or callable, optional
        [kg/m^3], or a function of altitude [m]; by default the standard atmosphere.
    gravity : float, default=9.80665
        [m/s^2].
    hold : bool, default=False
        Whether a function is asked once a step and its answer held, as a flight computer does; else at every stage.

    Returns
    -------
    pandas.DataFrame
        A flight table: ``time``, position, velocities, angles, rates, airspeed, alpha, beta, altitude, density, ``ax``,
        ``ay``, ``az``, ``p_dot``, ``q_dot``, ``r_dot``, controls and coefficients; ``beyond``, the regressor that is
        farthest outside of what was flown, or ""; ``ended``, why the trajectory is over, or "" while it is not: its
        rows are then NaN. Several starts have a column ``start``, paths also ``path``; ``flight`` names each.

    Raises
    ------
    ValueError
        If the start is not finite, controls are missing or end early, nothing tells the thrust, a regressor cannot be
        rebuilt, or the model lacks a coefficient or has no posterior to draw from.

    Warns
    -----
    SimulationWarning
        If a trajectory ends before its time (it diverged, lost its airspeed, or no fixed point was found), or leaves
        what the model was learned from.
    UserWarning
        If a start, the controls and the wind carry times that do not begin together, or a start does not fit its wind.

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
    commands = control_schedule(controls, clock, _is_control(motion), len(starts), hold=hold)
    states = initial_states(starts, None if air is None else lambda at: air(0, at).wind)
    if n_paths is not None:
        motion.aerodynamics = motion.aerodynamics.sample(n_paths, random_state)
        states = perturbed(states, initial_std, n_paths, random_state)
        if return_std:
            raise ValueError("Got n_paths and return_std=True, but expected one of them: paths spread by themselves.")
    elif initial_std is not None and not return_std:
        raise ValueError("Got initial_std without n_paths or return_std=True: nothing would show it.")
    elif len(states) == 1:
        states = states[0]
    record = fly(motion, commands, air, clock, states)
    warn_of(record, motion)
    std = linear_std(record, motion, initial_std) if return_std else {}
    return trajectory_table(record, motion, _first_times(controls, len(starts)), std)


def _is_control(motion: Motion) -> Callable[[str], bool]:
    """Return what tells which columns of a table are controls: a whole flight log may be given."""
    if callable(motion.thrust):
        return lambda name: (name in CONTROLS or name not in CHANNELS) and not name.endswith(TRUTH_SUFFIX)
    mixing = motion.aerodynamics.mixing
    known = {*motion.controls, *PROPULSION, *(() if mixing is None else mixing.surfaces)}
    return lambda name: name in known


def _first_times(controls, n_starts) -> np.ndarray:
    first = [table["time"].iloc[0] for table in tables_of(controls)]
    return np.broadcast_to(np.array(first or [0.0], dtype=float), (n_starts,))
