"""Linear models of the motion about a flight condition, with standard deviations.

In the order of the computation: `jacobian` has the slopes of the motion, on the tangent of the aerodynamic
model; `_with_servos` puts the servos before the controls, and cuts A, B, C and D.

A ``state`` (..., 13) is as of `STATE_NAMES`, with a quaternion; x (..., 12) are `LINEAR_STATES`, with Euler
angles; u (..., k) the inputs, z = (x, u), and C (..., 6) the coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy.linalg import block_diag
from sklearn.base import BaseEstimator

from skdgp._compute.linalg import matrix_vector
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import AIR_DATA, BODY_VELOCITY, EULER, POSITION, SPECIFIC_FORCE
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import (
    air_data_slopes,
    air_velocity,
    cross,
    euler_per_rotation,
    euler_to_quaternion,
    quaternion_to_euler,
)
from skdgp._flight.tables import by_name, check_number, check_numbers
from skdgp.dynamics._aerodynamics import (
    Aerodynamics,
    as_aerodynamics,
    central_difference,
    separate_generator,
)
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._modes import mode_table
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, RATES, dynamic_pressure, thrust_control
from skdgp.dynamics._servos import IDEAL, Servos
from skdgp.dynamics._trim import Trim

# States of a linear model, with Euler angles in place of the quaternion of `STATE_NAMES`
LINEAR_STATES = (*POSITION, *BODY_VELOCITY, *EULER, *RATE_NAMES)
OUTPUTS = (*AIR_DATA, *SPECIFIC_FORCE)
AIR_ANGLES = slice(1, 3)  # Places of alpha and beta in `OUTPUTS`
EULER_ANGLES = slice(6, 9)  # Places of phi, theta, psi in `LINEAR_STATES`


# Step of the differences of the mechanics over 1 + the size of a quantity, in SI units
STEP = 1e-3


# Rates of the air angles, and the rotations with similar slopes, in the same order
ANGLE_RATES = ("alpha_dot", "beta_dot")
ROTATIONS = ("q", "r")
# Standard deviation of the slopes by alpha_dot and beta_dot over those by q and r; a guess, for a
# tail in the downwash
RELATIVE_STD = np.array([0.4, 0.2])
# K, S and M of `unsteady_terms`
UnsteadyTerms: TypeAlias = tuple[Array, Array, Array]


class Matrices(NamedTuple):
    """A, B, C and D of linear models, arrays (..., :, :), and the delays of their servos, (...) [s]."""

    A: Array
    B: Array
    C: Array
    D: Array
    delay: Array


@dataclass(frozen=True, eq=False)
class LinearModel:
    r"""Linear model of small deviations from a flight condition: :math:`\dot x = A x + B u,\; y = C x + D u`.

    Rows and columns of the tables A, B, C, D carry the names of states, inputs, outputs. Delays are
    not in them: their response is exactly :math:`e^{-s \tau}`.
    """

    A: Any
    B: Any
    C: Any
    D: Any
    airspeed: float  #: Of the flight [m/s]
    density: float  #: Of its air [kg/m^3]
    #: A, B, C, D and delay of the servos of each path of the posterior, arrays (n_paths, ...)
    paths: Matrices | None = None
    delay: float = 0.0  #: Of the commands before they are logged [s]
    servos: Servos = IDEAL  #: Behind the logged commands; their lag is in A and B

    def modes(self) -> pd.DataFrame:
        r"""Return a row for each mode: its name, how fast it is, how it is damped.

        A pair of roots is :math:`s^2 + 2\zeta\omega s + \omega^2`. Modes are named by participation
        factors (Perez-Arriaga, Verghese & Schweppe 1982), the share of each state in each mode. A
        pair that has split into two real roots keeps its name with a number; a roll and a spiral
        that have become one oscillation are the "roll-spiral". Position and heading are left out.
        Raises ValueError if A lacks one of the other states.

        Returns
        -------
        DataFrame
            Columns ``eigenvalue`` [1/s], ``frequency`` [rad/s], undamped, ``damping``,
            ``time_constant`` [s], negative where it diverges; ln 2 times it is the time to half or
            double amplitude; ``period`` [s], infinite where there is none. With paths also
            ``frequency_std``, ``damping_std``, and ``time_constant_lower``, ``time_constant_upper``,
            which hold 95 % of the paths: the upper one is infinite where some do not decay.
        """
        return mode_table(self.A, None if self.paths is None else self.paths.A)


def linearize(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    point: Any,
    controls: Mapping[str, float] | None = None,
    *,
    n_paths: int = 0,
    random_state: Seed = 0,
    thrust: str | None = "auto",
    air: Any = None,
    delay: float = 0.0,
    perturbation: str | None = "flown",
) -> LinearModel:
    r"""Return the linear model of an aircraft's motion about a trim, through the slopes of its model.

    Regressors that follow from the loads (alpha_dot, beta_dot) are included by the implicit
    function theorem. Air is at rest; in steady wind the same holds for the motion relative to the
    air. Raises ValueError if the airspeed is zero, or the model is not defined there.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    point : Trim or array-like of shape (13,)
        A trim, or a state (`STATE_NAMES`) with its ``controls``.
    controls : mapping of str to float, optional
    n_paths : int
        Number of posterior functions to linearise too, at the same point, for ``paths`` and the spread
        of the modes; with the other errors that
        :func:`skdgp.dynamics.stability_derivatives` names, of the log too, and with the errors of
        lag and delay of the servos.
    random_state : int, RandomState instance or None
        Of the paths.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; of the air, density and gravity count.
    delay : float
        Of the commands before they are logged [s], from sampling and computing, for
        :func:`skdgp.control.margins`. The delay of the servos comes on top of it.
    perturbation : {"flown", None}
        Slopes of the model over the flown perturbation, or local ones, as for
        :func:`skdgp.dynamics.stability_derivatives`.

    Returns
    -------
    LinearModel
        Its states are north, east, down [m], u, v, w [m/s], phi, theta, psi [rad], p, q, r [rad/s];
        its inputs the model's controls and the one that sets the thrust; its outputs the states and
        airspeed, alpha, beta, ax, ay, az. Inputs of surfaces are commands, as for
        :func:`skdgp.dynamics.simulate`: where the servos have a lag T, the deflection of each
        surface is a further state, such as elevator_position [rad]. It follows
        :math:`T \dot\delta = u - \delta`. The delay of the servos is in ``servos``; the limit of
        their rate has no part in a linear model.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, linearize, trim
    >>> def linear(X):
    ...     alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    ...     lift = 0.3 + 4.5 * alpha
    ...     return np.stack([-0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
    ...                      -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
    ...                      0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    >>> model = Aerodynamics(linear, names)
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> linearised = linearize(model, aircraft, trim(model, aircraft, 20.0))
    >>> linearised.modes()[["frequency", "damping"]].round(2)
                  frequency  damping
    short period      10.11     0.76
    phugoid            0.46     0.10
    Dutch roll         4.98     0.25
    roll              19.51     1.00
    spiral             0.05    -1.00
    """
    check_number("delay", delay, is_open=False, unit="s")
    check_paths(n_paths)
    motion = Motion(as_aerodynamics(model).over(perturbation), aircraft, thrust=thrust, air=air)
    state, controls = flight_point(motion, point, controls)
    now = motion.at(state, controls)
    inputs = list(motion.controls)
    engine = thrust_control(aircraft, thrust)
    if engine in controls and engine not in inputs:
        inputs.append(engine)
    servos = motion.aerodynamics.servos
    are_lagging = [servos.lag > 0 and name in motion.surfaces for name in inputs]
    mean = _matrices(motion, state, controls, inputs, are_lagging, servos.lag, servos.delay)
    paths = None
    if n_paths:
        drawn, unsteady = _drawn(motion, now, n_paths, random_state)
        lags, delays = servos.drawn(n_paths, separate_generator(random_state, 7))
        states = np.tile(state, (n_paths, 1))
        paths = _matrices(drawn, states, controls, inputs, are_lagging, lags, delays, unsteady)
    positions = [f"{name}_position" for name in compress(inputs, are_lagging)]
    names = [*LINEAR_STATES, *positions]
    outputs = [*names, *OUTPUTS]
    return LinearModel(
        A=pd.DataFrame(mean.A, names, names),
        B=pd.DataFrame(mean.B, names, inputs),
        C=pd.DataFrame(mean.C, outputs, names),
        D=pd.DataFrame(mean.D, outputs, inputs),
        paths=paths,
        airspeed=float(now.airspeed),
        density=float(now.density),
        delay=float(delay),
        servos=servos,
    )


def _matrices(
    motion: Motion,
    state: Array,
    controls: Mapping,
    inputs: Sequence[str],
    are_lagging: Sequence[bool],
    lag: Array | float,
    delay: Array | float,
    unsteady: UnsteadyTerms | None = None,
) -> Matrices:
    """Return A, B, C, D at states (..., 13), behind servos of lags and delays (...), of inputs that lag."""
    x_dot_z, y_z = jacobian(motion, state, controls, inputs, unsteady)
    if not np.isfinite(x_dot_z).all():
        raise ValueError(
            "Got slopes of the model that are not finite at this point: it is not defined there."
        )
    matrices = _with_servos(x_dot_z, y_z, are_lagging, np.asarray(lag))
    return Matrices(*matrices, np.asarray(delay))


def jacobian(
    motion: Motion,
    state: Array,
    controls: Mapping,
    inputs: Sequence[str] = (),
    unsteady: UnsteadyTerms | None = None,
) -> tuple[Array, Array]:
    r"""Return the slopes d x_dot (..., 12, 12 + k) and d outputs (..., 6, 12 + k) by z.

    The states are (..., 13), as of `Motion.at`, the inputs k of the controls, which are numbers.
    Where the aerodynamics are paths, these are the first axis of ``state``.

    The coefficients are on the tangent of the model, of slopes :math:`c_X`,

    .. math:: C = C_0 + c_X (X - X_0) + \delta.

    Regressors X that follow from the loads (alpha_dot, beta_dot) are the fixed point of the motion.
    Slopes by :math:`z = (x, u)` and :math:`\delta` are differences. Unsteady terms are
    :math:`\delta = K (M \text{rates} - S X)`, of the motion without them, to first order.
    """
    state = np.asarray(state, dtype=float)
    now = motion.at(state, controls)
    slopes = np.swapaxes(motion.aerodynamics.gradient(now.regressors), -1, -2)
    n_states, n = len(LINEAR_STATES), len(LINEAR_STATES) + len(inputs)

    def tangent(X: Array) -> Array:
        change = X - now.regressors[..., None, :]
        return now.coefficients[..., None, :] + change @ slopes

    def moved(z: Array) -> Array:
        """Return x_dot, outputs and regressors as one vector (..., 12 + 6 + d) of (x, u, delta)."""
        x, u, delta = np.split(z, [n_states, n], axis=-1)
        at = {**controls, **by_name(inputs, u)}
        then = motion.at(_with_quaternion(x), at, drift=delta, model=tangent)
        air = np.stack([then.airspeed, then.alpha, then.beta], axis=-1)
        specific_force = then.force / motion.aircraft.mass
        return np.concatenate([_x_dot(x, then), air, specific_force, then.regressors], axis=-1)

    u = np.broadcast_to([controls[name] for name in inputs], (*state.shape[:-1], len(inputs)))
    z = np.concatenate([_with_euler_angles(state), u, np.zeros((*state.shape[:-1], 6))], axis=-1)
    by_all = central_difference(moved, z, STEP * (1.0 + np.abs(z)))
    by_z, by_delta = np.split(by_all, [n], axis=-1)
    x_dot_z, y_z, X_z = np.split(by_z, [n_states, n_states + len(OUTPUTS)], axis=-2)
    if unsteady is not None:
        K, S, M = unsteady
        rates = y_z[..., AIR_ANGLES, :n_states] @ x_dot_z
        by_z = by_z + by_delta @ K @ (M * rates - S @ X_z)
    return by_z[..., :n_states, :], by_z[..., n_states : n_states + len(OUTPUTS), :]


def _with_euler_angles(state: Array) -> Array:
    """Return x (..., 12) of states (..., 13)."""
    angles = quaternion_to_euler(state[..., ATTITUDE])
    return np.concatenate([state[..., :6], angles, state[..., RATES]], axis=-1)


def _with_quaternion(x: Array) -> Array:
    """Return the states (..., 13) of x (..., 12)."""
    angles = np.moveaxis(x[..., EULER_ANGLES], -1, 0)
    return np.concatenate([x[..., :6], euler_to_quaternion(*angles), x[..., 9:]], axis=-1)


def _x_dot(x: Array, now: Instant) -> Array:
    """Return the rates of change of x (..., 12): the rates of the angles for those of the quaternion."""
    phi, theta, _ = np.moveaxis(x[..., EULER_ANGLES], -1, 0)
    angles_dot = matrix_vector(euler_per_rotation(phi, theta), x[..., 9:])
    derivative = now.derivative
    return np.concatenate([derivative[..., :6], angles_dot, derivative[..., RATES]], axis=-1)


def _with_servos(
    x_dot_z: Array, y_z: Array, lagging: Sequence[bool], lag: Array
) -> tuple[Array, Array, Array, Array]:
    r"""Return A, B, C, D of the motion by commands, from slopes (..., m, 12 + k) by rigid body and controls.

    The surfaces have the deflections :math:`\delta` and the commands :math:`E u`. The states are
    :math:`(x, \delta)`, with :math:`T \dot\delta = E u - \delta`. The aircraft gets the controls
    :math:`E^T \delta + (I - E^T E) u`. Outputs are the states, and then the outputs of the aircraft.
    """
    n, k = len(LINEAR_STATES), len(lagging)
    E = np.eye(k)[lagging]
    m = len(E)
    # rows of these matrices are linear in (x, delta, u)
    states = np.eye(n + m, n + m + k)
    controls = np.hstack([E.T, np.eye(k) - E.T @ E])
    x_and_controls = block_diag(np.eye(n), controls)
    delta_dot = np.hstack([np.zeros((m, n)), -np.eye(m), E]) / lag[..., None, None]
    rates = np.concatenate([x_dot_z @ x_and_controls, delta_dot], axis=-2)
    same = np.broadcast_to(states, (*lag.shape, *states.shape))
    outputs = np.concatenate([same, y_z @ x_and_controls], axis=-2)
    A, B = np.split(rates, [n + m], axis=-1)
    C, D = np.split(outputs, [n + m], axis=-1)
    return A, B, C, D


def _drawn(
    motion: Motion, now: Instant, n_paths: int, random_state: Seed
) -> tuple[Motion, UnsteadyTerms | None]:
    """Return the motion with functions drawn from the posterior in place of the model, and their unsteady terms."""
    model = motion.aerodynamics
    motion_of_paths = motion.with_aerodynamics(model.sample(n_paths, random_state))
    if model.learned is None:
        return motion_of_paths, None
    at_point = np.tile(now.regressors, (n_paths, 1))
    K, S, M = unsteady_terms(motion, now, motion_of_paths.aerodynamics.gradient(at_point))
    # slopes by alpha_dot and beta_dot of each path
    draws = separate_generator(random_state).standard_normal((n_paths, 1, 2))
    return motion_of_paths, (draws * K, S, M)


def flight_point(
    motion: Motion, point: Any, controls: Mapping | None
) -> tuple[Array, dict[str, float]]:
    """Return state (13,) and controls of a trim, or of a state and its controls."""
    if isinstance(point, Trim):
        controls = point.controls if controls is None else controls
        point = point.state
    state = check_numbers("point", point, 13, unit="STATE_NAMES, or a Trim")
    if not np.linalg.norm(state[3:6]) > 0:
        raise ValueError(
            "Got a state at rest, but expected an airspeed > 0: coefficients are loads over rho V^2 / 2."
        )
    return state, {name: float(value) for name, value in motion.mixed(controls or {}).items()}


def check_paths(n_paths: int) -> None:
    """Raise ValueError at a number of paths that have no spread."""
    if n_paths < 0 or n_paths == 1:
        raise ValueError(
            f"Got n_paths={n_paths!r}, but expected 0 or at least 2: one path has no spread."
        )


def unsteady_terms(motion: Motion, now: Instant, slopes: Array) -> UnsteadyTerms:
    r"""Return gain K (..., 6, 2), relation S (..., 2, d), mask M (2, 1) of the merged effects of alpha_dot, beta_dot.

    They change C by K (M rates - S regressors). Most flights do not tell alpha_dot from q
    and beta_dot from r (Klein & Morelli 2006, section 5.1). A model without them gives their effect to the
    regressors that they follow from. With :math:`\dot\alpha = S x` of the motion that the loads of the model cause
    without gravity, a slope by x holds :math:`C_{\dot\alpha} S`. A tail in the downwash gives
    :math:`C_{\dot\alpha} = C_q\, d\epsilon/d\alpha` (Etkin & Reid 1996, section 5.5). The downwash is not known
    here, so :math:`C_{\dot\alpha}` is zero with a standard deviation, K, of `RELATIVE_STD` of :math:`C_q`, and of
    :math:`C_r` for beta_dot, by the slopes (..., 6, d) of each function drawn from the posterior: where gusts make
    :math:`C_q` of the mean vanish, :math:`C_{\dot\alpha}` need not vanish. M says whether they are no regressors;
    where they are, S has their own slopes subtracted.

    .. math:: \dot V = F_A(x) / m - \omega(x) \times V
    """
    aircraft = motion.aircraft
    units = 1.0 / motion.factors(now.airspeed)  # channel over regressor: 2 V / b [1/s] of p_hat
    velocity = air_velocity(now.airspeed, now.alpha, now.beta)
    force_per_slope = dynamic_pressure(now.airspeed, now.density) * aircraft.wing_area
    acceleration = (force_per_slope / aircraft.mass)[..., None, None] * slopes[..., :3, :]
    std = np.zeros((*slopes.shape[:-1], 2))
    for k, name in enumerate(motion.regressors):
        if name in RATE_NAMES:
            axis = np.eye(3)[RATE_NAMES.index(name)] * np.ones_like(velocity)
            acceleration[..., k] -= cross(axis, velocity) * units[..., k, None]
        if name in ROTATIONS:
            j = ROTATIONS.index(name)
            std[..., j] = RELATIVE_STD[j] * slopes[..., k] / units[..., k, None]
    relation = air_data_slopes(velocity)[..., 1:, :] @ acceleration
    is_regressor = np.array(ANGLE_RATES)[:, None] == motion.regressors
    relation -= is_regressor * units[..., None, :]
    return std, relation, ~is_regressor.any(axis=1, keepdims=True)
