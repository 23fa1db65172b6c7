r"""Linear models with standard deviations: derivatives of the motion, matrices, modes; stability derivatives.

Most flights do not tell alpha_dot from q and beta_dot from r (Klein & Morelli 2006, section 5.1). A
model without them gives their effect to the regressors that they follow from. With
:math:`\dot\alpha = S x` of the motion that the loads of the model cause without gravity, a slope by
x holds :math:`C_{\dot\alpha} S`. A tail in the downwash gives :math:`C_{\dot\alpha} = C_q\,
d\epsilon/d\alpha` (Etkin & Reid 1996, section 5.5). The downwash is not known here, so
:math:`C_{\dot\alpha}` is zero with a standard deviation of `SHARES` of :math:`C_q`, and of
:math:`C_r` for beta_dot. The square of :math:`C_q` is the model's, plus the square of its
deviation by method: where gusts make it vanish, :math:`C_{\dot\alpha}` need not vanish.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment
from sklearn.base import BaseEstimator
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import (
    BODY_VELOCITY,
    CHANNELS,
    COEFFICIENTS,
    EULER,
    LENGTHS,
    POSITION,
    RATE_LENGTHS,
    rate_factor,
)
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import (
    air_data_slopes,
    air_velocity,
    cross,
    euler_per_rotation,
    euler_to_quaternion,
    quaternion_to_euler,
)
from skdgp.dynamics._aerodynamics import Aerodynamics
from skdgp.dynamics._aircraft import Aircraft, errors_of_sizes
from skdgp.dynamics._motion import Instant, Motion, check_settled
from skdgp.dynamics._rigid_body import ATTITUDE, RATES, thrust_control
from skdgp.dynamics._servos import Servos
from skdgp.dynamics._trim import Trim

# Rates of change, and the rates whose slopes theirs are shares of
LAGS = {"alpha_dot": "q", "beta_dot": "r"}
SHARES = np.array([0.4, 0.2])
STATES = (*POSITION, *BODY_VELOCITY, *EULER, *RATE_NAMES)  # States of the rigid body
SERVO_STATE = "{}_position"  # Name of the state that is the deflection of a surface with a servo
OUTPUTS = ("airspeed", "alpha", "beta", "ax", "ay", "az")
ANGLES = slice(1, 3)  # Places of alpha and beta in `OUTPUTS`
# Of differences of the mechanics [m, rad or rad/s]; velocities and controls step by a fraction of
# themselves
POSITION_STEP, ANGLE_STEP, FRACTION = 1.0, 1e-3, 1e-3
# Of the central difference of fourth order
WEIGHTS = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}


def jacobian(
    motion: Motion,
    state: Array,
    controls: Mapping,
    inputs: Sequence[str] = (),
    lag: Lag | None = None,
) -> tuple[Array, Array, Instant]:
    r"""Return d state_dot (..., 12, 12 + k), d outputs (..., 6, 12 + k) by `STATES` and inputs, and the instant.

    The states are (..., 13), as of `Motion.at`, the inputs k of the controls. The
    motion is mechanics :math:`\dot x = F(x, u, C)` around a model :math:`C = c(X)` of
    regressors :math:`X = G(x, u, C)`, which depend on C where they follow from the loads
    (alpha_dot, ax, ...). So

    .. math:: dC = (I - c_X G_C)^{-1} c_X (G_x dx + G_u du), \quad d\dot x = F_x dx + F_u du + F_C dC

    with the slopes of the model :math:`c_X`, and differences of F and G, exact to some 1e-10.
    ``controls`` are as of :meth:`Motion.at`. Where the aerodynamics are paths, these are the
    first axis of ``state``. A ``lag`` adds coefficients by alpha_dot and beta_dot, to first order.
    """
    state = np.asarray(state, dtype=float)
    instant = motion.at(state, controls)
    F, G, H = _mechanics(motion, state, controls, tuple(inputs), instant)
    slopes = motion.aerodynamics.gradient(instant.regressors)
    n = len(STATES) + len(inputs)
    change: np.ndarray = slopes @ G[..., :n]
    gain: np.ndarray = np.eye(6)
    if motion.implicit:
        gain = np.linalg.inv(np.eye(6) - slopes @ G[..., n:])
        change = gain @ change
    if lag is not None:
        rate = F[..., :n] + F[..., n:] @ change
        by_angles = lag.missing * (H[..., ANGLES, : len(STATES)] @ rate)
        change = change + gain @ lag.slopes @ (by_angles - lag.relation @ G[..., :n])
    rate = F[..., :n] + F[..., n:] @ change
    return rate, H[..., :n] + H[..., n:] @ change, instant


def _mechanics(
    motion: Motion, state: Array, controls: Mapping, inputs: tuple[str, ...], instant: Instant
) -> tuple[Array, Array, Array]:
    """Return d (state_dot, regressors, outputs) / d (state, inputs, coefficients), the coefficients being given."""
    frozen: Any = copy.copy(motion)
    shape = state.shape[:-1]
    n = len(STATES)
    k = len(inputs)
    x = np.concatenate(
        [state[..., :6], quaternion_to_euler(state[..., ATTITUDE]), state[..., RATES]], axis=-1
    )
    u = {name: np.broadcast_to(np.asarray(v, dtype=float), shape) for name, v in controls.items()}
    steps = np.full((*shape, n + k + 6), FRACTION)
    steps[..., :3] = POSITION_STEP
    steps[..., 3:6] = FRACTION * instant.airspeed[..., None]
    steps[..., 6:n] = ANGLE_STEP
    for j, name in enumerate(inputs):
        steps[..., n + j] = FRACTION * (1.0 + np.abs(u[name]))
    slopes = np.zeros(())
    for move, weight in WEIGHTS.items():
        moves = move * steps[..., None] * np.eye(n + k + 6)
        C = instant.coefficients[..., None, :] + moves[..., n + k :]
        frozen.aerodynamics = lambda X, C=C: C
        moved = {name: np.repeat(v[..., None], n + k + 6, axis=-1) for name, v in u.items()}
        for j, name in enumerate(inputs):
            moved[name] = moved[name] + moves[..., n + j]
        there = x[..., None, :] + moves[..., :n]
        attitude = euler_to_quaternion(*np.moveaxis(there[..., 6:9], -1, 0))
        states = np.concatenate([there[..., :6], attitude, there[..., 9:]], axis=-1)
        slopes = slopes + weight * _responses(frozen.at(states, moved), there, motion)
    slopes = np.swapaxes(slopes / steps[..., None], -1, -2)
    d = len(motion.regressors)
    return slopes[..., :n, :], slopes[..., n : n + d, :], slopes[..., n + d :, :]


def _responses(instant: Instant, x: Array, motion: Motion) -> Array:
    """Return the rates of change of `STATES`, the regressors, and `OUTPUTS`."""
    euler_rate = euler_per_rotation(x[..., 6], x[..., 7]) @ x[..., 9:, None]
    air = np.stack([instant.airspeed, instant.alpha, instant.beta], axis=-1)
    rate = instant.derivative
    parts = [rate[..., :6], euler_rate[..., 0], rate[..., RATES], instant.regressors, air]
    return np.concatenate([*parts, instant.force / motion.aircraft.mass], axis=-1)


class Lag(NamedTuple):
    """What alpha_dot and beta_dot may change of C: slopes @ (missing * rates - relation @ regressors)."""

    slopes: Array  # One standard deviation of the slopes of C by them [s/rad], (..., 6, 2)
    # S, their slopes by the regressors, less their slopes as regressors themselves, (..., 2, d)
    relation: Array
    missing: Array  # Whether they are no regressors, (2, 1)

    @property
    def errors(self) -> Array:
        """Errors of the slopes of C, (..., 6, d, 2)."""
        return -np.einsum("...ij,...jk->...ikj", self.slopes, self.relation)


def lag_of(motion: Motion, now: Instant, slopes: Array, scatter: ArrayLike = 0.0) -> Lag:
    """Return what alpha_dot and beta_dot may change at a flight, by the slopes (..., 6, d) of the model.

    ``scatter`` is the standard deviation of these slopes by method.
    """
    velocity = air_velocity(now.airspeed, now.alpha, now.beta)
    pressure = (
        0.5 * now.density * now.airspeed**2 * motion.aircraft.wing_area / motion.aircraft.mass
    )
    acceleration = np.asarray(pressure)[..., None, None] * slopes[..., :3, :]
    by_rate = np.zeros((*slopes.shape[:-1], 2))
    as_regressors = np.zeros((*slopes.shape[:-2], 2, slopes.shape[-1]))
    size = np.copysign(np.hypot(slopes, scatter), slopes)
    for k, name in enumerate(motion.regressors):
        if name not in RATE_LENGTHS:
            continue
        unit = np.broadcast_to(
            1.0 / motion.factor(k, now.airspeed), np.shape(now.airspeed)
        )  # of the regressor [rad/s]
        if name in LAGS:
            as_regressors[..., list(LAGS).index(name), k] = unit
            continue
        acceleration[..., k] -= (
            cross(np.eye(3)["pqr".index(name)] * np.ones_like(velocity), velocity) * unit[..., None]
        )
        if name in LAGS.values():
            by_rate[..., list(LAGS.values()).index(name)] = size[..., k] / unit[..., None]
    missing = np.array([[name not in motion.regressors] for name in LAGS])
    return Lag(
        SHARES * by_rate,
        air_data_slopes(velocity)[..., 1:, :] @ acceleration - as_regressors,
        missing,
    )


# States of the modes along and across the plane of symmetry
LONGITUDINAL, LATERAL = ("u", "w", "q", "theta"), ("v", "p", "r", "phi")


@dataclass(frozen=True, eq=False)
class LinearModel:
    r"""Linear model of small deviations from a flight condition: :math:`\dot x = A x + B u,\; y = C x + D u`.

    Rows and columns of the tables A, B, C, D carry the names of states, inputs, outputs.
    """

    A: Any
    B: Any
    C: Any
    D: Any
    paths: LinearModel | None = (
        None  #: A, B, C, D of each path of the posterior, arrays (n_paths, ...)
    )

    def modes(self) -> pd.DataFrame:
        r"""Return a row for each mode: its name, how fast it is, how it is damped.

        A pair of roots is :math:`s^2 + 2\zeta\omega s + \omega^2`. Modes are named by participation
        factors (Perez-Arriaga, Verghese & Schweppe 1982), the share of each state in each mode. A
        pair that has split into two real roots keeps its name with a number; a roll and a spiral
        that have become one oscillation are the "roll-spiral". Position and heading are left out.

        Returns
        -------
        DataFrame
            Columns ``eigenvalue`` [1/s], ``frequency`` [rad/s], undamped, ``damping``,
            ``time_constant`` [s], negative where it diverges, ``time_to_half``, ``time_to_double``,
            ``period`` [s], infinite where there is none. With paths also ``frequency_std``,
            ``damping_std``, and ``time_constant_lower``, ``time_constant_upper``, which hold 95 %
            of the paths: the upper one is infinite where some do not decay.
        """
        states = [*map(str, self.A)]
        families = [family for family in (LONGITUDINAL, LATERAL) if set(family) <= set(states)]
        core = [name for family in families for name in family] or states
        rows = [states.index(name) for name in core]
        eigenvalues, left, right = eig(self.A.to_numpy()[np.ix_(rows, rows)], left=True)
        participation = np.abs(left.conj() * right)
        participation = pd.DataFrame(participation / participation.sum(axis=0), core)
        named = _named(_units(eigenvalues), participation, eigenvalues)
        roots = {name: eigenvalues[list(unit)] for name, unit in named.items()}
        table = pd.DataFrame.from_dict({name: _row(root) for name, root in roots.items()}, "index")
        if self.paths is None:
            return table
        drawn: Any = np.linalg.eigvals(self.paths.A[:, rows][:, :, rows])
        # in the order of the eigenvalues that they lie nearest to
        drawn = [x[linear_sum_assignment(np.abs(eigenvalues[:, None] - x))[1]] for x in drawn]
        values = np.array([[_values(x[list(unit)]) for unit in named.values()] for x in drawn])
        table["frequency_std"], table["damping_std"] = values[..., :2].std(axis=0, ddof=1).T
        least, most = np.quantile(values[..., 2], [0.025, 0.975], axis=0)
        with np.errstate(divide="ignore"):
            table["time_constant_lower"] = np.where(most > 0, 1.0 / most, -np.inf)
            table["time_constant_upper"] = np.where(least > 0, 1.0 / least, np.inf)
        return table


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
) -> LinearModel:
    r"""Return the linear model of an aircraft's motion about a trim, through the slopes of its model.

    Regressors that follow from the loads (alpha_dot, accelerations) are included by the implicit
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
        :func:`skdgp.dynamics.stability_derivatives` names.
    random_state : int, RandomState instance or None
        Of the paths.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; of the air, density and gravity count.

    Returns
    -------
    LinearModel
        Its states are north, east, down [m], u, v, w [m/s], phi, theta, psi [rad], p, q, r [rad/s];
        its inputs the model's controls and the one that sets the thrust; its outputs the states and
        airspeed, alpha, beta, ax, ay, az. Inputs of surfaces are commands, as for
        :func:`skdgp.dynamics.simulate`: where the model has a ``servo_lag`` T, the deflection of
        each surface is a further state behind r, such as elevator_position [rad], with
        :math:`T \dot\delta = u - \delta`.

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
    motion = Motion(model, aircraft, thrust=thrust, air=air)
    state, controls = flight_point(motion, point, controls)
    engine = thrust_control(aircraft, thrust)
    inputs = list(dict.fromkeys([*motion.controls, *([engine] if engine in controls else [])]))
    paths = None
    if check_paths(n_paths):
        drawn = _drawn(motion, state, controls, n_paths, random_state)
        paths = _matrices(*drawn, controls, inputs)
    mean = _matrices(motion, state, None, controls, inputs)
    surfaces = Servos.of(motion).surfaces
    states = [*STATES, *(SERVO_STATE.format(name) for name in inputs if name in surfaces)]
    names = product([states, [*states, *OUTPUTS]], [states, inputs])
    matrices = (mean.A, mean.B, mean.C, mean.D)
    A, B, C, D = (pd.DataFrame(values, *pair) for values, pair in zip(matrices, names, strict=True))
    return LinearModel(A, B, C, D, paths)


def check_paths(n_paths: int) -> int:
    """Return the number of paths, none or enough to have a spread."""
    if n_paths < 0 or n_paths == 1:
        raise ValueError(
            f"Got n_paths={n_paths!r}, but expected 0 or at least 2: one path has no spread."
        )
    return n_paths


def flight_point(
    motion: Motion, point: Any, controls: Mapping | None
) -> tuple[Array, dict[str, float]]:
    """Return state (13,) and controls of a trim, or of a state and its controls."""
    if isinstance(point, Sequence) and any(hasattr(item, "state") for item in point):
        raise TypeError(
            f"Got {len(point)} trims, but expected one: [linearize(model, aircraft, t) for t in "
            f"trims]."
        )
    state = np.array(getattr(point, "state", point), dtype=float)
    controls = getattr(point, "controls", None) if controls is None else controls
    if state.shape != (13,) or not np.isfinite(state).all():
        raise ValueError(
            f"Got a point of shape {state.shape} or with values that are not finite, but expected "
            f"a Trim or a state of "
            "13 finite numbers (STATE_NAMES)."
        )
    if controls is None:
        raise ValueError(
            f"Got a state without controls, but expected controls={{name: value}} of "
            f"{motion.controls}."
        )
    if not np.linalg.norm(state[3:6]) > 0:
        raise ValueError(
            "Got a state at rest, but expected an airspeed > 0: coefficients are loads over rho "
            "V^2 / 2."
        )
    return state, {name: float(value) for name, value in motion.mixed(controls).items()}


def _drawn(
    motion: Motion, state: Array, controls: Mapping, n_paths: int, random_state: Seed
) -> tuple[Motion, Array, Lag | None]:
    """Return the motion of functions drawn from the posterior, its states, and what alpha_dot and beta_dot change."""
    model, drawn, lag = motion.aerodynamics, copy.copy(motion), None
    drawn.aerodynamics = model.sample(n_paths, random_state)
    if model.slope_errors is not None:
        now = motion.at(state, controls)
        errors = model.slope_errors(now.regressors[None])
        scatter = 0.0 if errors is None else np.linalg.norm(errors.method[0], axis=-1)
        lag = lag_of(motion, now, model.gradient(now.regressors), scatter)
        # other numbers than for the paths
        seed = check_random_state(random_state).randint(2**31 - 1, size=4)
        rng = np.random.default_rng(seed)
        lag = lag._replace(slopes=lag.slopes * rng.standard_normal((n_paths, 1, 2)))
        added: Array = np.zeros((n_paths, *lag.slopes.shape[-2:-1], len(motion.regressors)))
        for part in () if errors is None else (errors.random[0], errors.method[0]):
            added = added + np.moveaxis(
                part @ rng.standard_normal((part.shape[-1], n_paths)), -1, 0
            )
        slopes: Any = drawn.aerodynamics.slopes
        drawn.aerodynamics.slopes = lambda X: slopes(X) + added[:, None]
    return drawn, np.broadcast_to(state, (n_paths, 13)), lag


def _matrices(
    motion: Motion,
    state: Array,
    lag: Lag | None,
    controls: Mapping,
    inputs: Sequence[str],
) -> LinearModel:
    rate, output, instant = jacobian(motion, state, controls, inputs, lag)
    check_settled(instant)
    if not np.isfinite(rate).all():
        raise ValueError(
            "Got slopes of the model that are not finite at this point: it is not defined there."
        )
    n = len(STATES)
    return _with_servos(
        rate[..., :n], rate[..., n:], output[..., :n], output[..., n:], inputs, Servos.of(motion)
    )


def _with_servos(
    A: Array, B: Array, C: Array, D: Array, inputs: Sequence[str], servos: Servos
) -> LinearModel:
    r"""Return the linear model of which the inputs of surfaces are commands.

    The deflections :math:`\delta = E u` of the surfaces are further states, with
    :math:`T \dot\delta = E u - \delta`. Outputs are the states, and then the outputs of C and D.

    .. math:: \begin{pmatrix} A & B E^T \\ 0 & -I / T \end{pmatrix}, \quad
        \begin{pmatrix} B (I - E^T E) \\ E / T \end{pmatrix}, \quad
        \begin{pmatrix} I & 0 \\ 0 & I \\ C & D E^T \end{pmatrix}, \quad
        \begin{pmatrix} 0 \\ 0 \\ D (I - E^T E) \end{pmatrix}
    """
    moved = np.array([name in servos.surfaces for name in inputs], dtype=bool)
    E = np.eye(len(inputs))[moved]
    at_once = np.eye(len(inputs)) - E.T @ E
    n = A.shape[-1]
    s = len(E)
    T = servos.lag if s else 1.0

    def zeros(rows: int, columns: int) -> Array:
        return np.zeros((*A.shape[:-2], rows, columns))

    def repeated(matrix: Array) -> Array:
        return np.broadcast_to(matrix, (*A.shape[:-2], *matrix.shape))

    states = repeated(np.eye(n + s))
    return LinearModel(
        A=np.block([[A, B @ E.T], [zeros(s, n), repeated(-np.eye(s) / T)]]),
        B=np.block([[B @ at_once], [repeated(E / T)]]),
        C=np.concatenate([states, np.block([[C, D @ E.T]])], axis=-2),
        D=np.concatenate([zeros(n + s, len(inputs)), D @ at_once], axis=-2),
    )


def _units(eigenvalues: np.ndarray) -> list[tuple[int, ...]]:
    """Return pairs of conjugate eigenvalues, positive imaginary part first, and single real ones."""
    units: list[tuple[int, ...]] = []
    for k, value in enumerate(eigenvalues):
        if value.imag > 0:
            units.append((k, int(np.argmin(np.abs(eigenvalues - value.conj())))))
        elif value.imag == 0:
            units.append((k,))
    return units


def _named(
    units: list[tuple[int, ...]], participation: pd.DataFrame, eigenvalues: Array
) -> dict[str, tuple[int, ...]]:
    """Return the units by name, of the participation of the states in each eigenvalue."""

    def part(names, unit):
        return participation.loc[list(names), list(unit)].to_numpy().sum()

    def split(units, names, size):
        """Return the units, ``size`` eigenvalues, with the largest participation of these states, and the others."""
        every = (subset for number in range(1, size + 1) for subset in combinations(units, number))
        complete = (subset for subset in every if sum(map(len, subset)) == size)
        best = max(complete, key=lambda subset: sum(part(names, unit) for unit in subset))
        return best, [unit for unit in units if unit not in best]

    named: dict[str, tuple[int, ...]] = {}
    states = set(participation.index)
    if set(LONGITUDINAL) <= states:
        along, units = split(units, LONGITUDINAL, 4)
        short, long = split(along, ("w", "q"), 2)
        named |= _numbered("short period", short, eigenvalues)
        named |= _numbered("phugoid", long, eigenvalues)
    if set(LATERAL) <= states:
        dutch, slow = split(units, ("v", "r"), 2)
        slow.sort(key=lambda unit: -part(("p",), unit))
        names = ("roll", "spiral") if len(slow) == 2 else ("roll-spiral",)
        named |= _numbered("Dutch roll", dutch, eigenvalues) | dict(zip(names, slow, strict=True))
    return named or _numbered("mode", units, eigenvalues)


def _numbered(name: str, units: Sequence, eigenvalues: np.ndarray) -> dict[str, tuple[int, ...]]:
    """Return a single unit by its name; several with numbers, the fastest first."""
    units = sorted(units, key=lambda unit: -abs(eigenvalues[unit[0]]))
    names = [f"{name} {k}" for k in range(1, len(units) + 1)] if len(units) > 1 else [name]
    return dict(zip(names, units, strict=True))


def _values(roots: np.ndarray) -> tuple[float, float, float]:
    """Return frequency, damping and rate of decay of a root, or of two as s^2 + 2 zeta omega s + omega^2."""
    decay = float(-roots.real.mean())
    frequency = float(np.abs(np.prod(roots)) ** (1.0 / len(roots)))
    return frequency, decay / frequency if frequency > 0 else 0.0, decay


def _row(roots: np.ndarray) -> dict[str, Any]:
    frequency, damping, decay = _values(roots)
    return {
        "eigenvalue": roots[0],
        "frequency": frequency,
        "damping": damping,
        "time_constant": 1.0 / decay if decay else np.inf,
        "time_to_half": np.log(2.0) / decay if decay > 0 else np.inf,
        "time_to_double": -np.log(2.0) / decay if decay < 0 else np.inf,
        "period": 2.0 * np.pi / abs(roots[0].imag) if roots[0].imag else np.inf,
    }


ROWS = (*COEFFICIENTS, "CL", "CD")
# Columns whose squares add up to the square of ``std``
PARTS = ("std_posterior", "std_random", "std_method")
NORMAL_95 = 1.959963984540054


def stability_derivatives(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    point: Trim | Sequence[Trim] | ArrayLike,
    controls: Mapping[str, ArrayLike] | None = None,
    *,
    n_paths: int = 200,
    random_state: Seed = 0,
    thrust: str | None = "auto",
    air: Any = None,
    added: ArrayLike | None = None,
) -> pd.DataFrame:
    r"""Return the coefficients and their derivatives at a flight, or at several, with their standard deviations.

    Derivatives by rates are by the non-dimensional ones, :math:`pb/2V`, :math:`qc/2V`,
    :math:`rb/2V`, :math:`\dot\alpha c/2V`, :math:`\dot\beta b/2V`, whatever regressors the model
    has (Stevens, Lewis & Johnson 2016, section 2.3). Lift and drag are

    .. math:: C_L = C_X \sin\alpha - C_Z \cos\alpha, \quad C_D = -C_X \cos\alpha - C_Z \sin\alpha, \quad
        C_{L_\alpha} = C_{X_\alpha} \sin\alpha - C_{Z_\alpha} \cos\alpha - C_D.

    Other coefficients and rates are in body axes. Raises ValueError if the model is not defined
    there, or rows are added to a model that does not hold its own.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    point : Trim, array-like of shape (13,), or several
        Trims, or states (`STATE_NAMES`) with their ``controls``.
    controls : mapping of str to float or array-like of shape (n,), optional
    n_paths : int
        Number of posterior functions that give the standard deviations, each with a relative error
        of 1 / sqrt(2 n_paths); 0: no deviations. A model without a posterior has none.
    random_state : int, RandomState instance or None
        Of the paths.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; they matter for regressors that follow from the
        loads.
    added : array-like of shape (k, d), optional
        Regressors of rows that are flown next, as :func:`skdgp.design.plan` chooses them. Standard
        deviations are then those expected of a model learned from these rows too.

    Returns
    -------
    DataFrame
        A row for each coefficient (``CL``) and derivative (``CL_alpha``, ``Cm_q``, ``Cn_rudder``),
        with columns ``value``, ``std``, ``lower`` and ``upper`` (95 %), ``coefficient``,
        ``regressor``, and ``per``, the unit of the regressor. Several points have an outer level
        ``point``, and columns ``airspeed``, ``alpha``, ``beta``. Of a model learned from flights,
        ``std`` is the root of the sum of the squares of

        - ``std_posterior``: over functions drawn from the posterior,
        - ``std_random``: errors correlated between samples and between outputs, estimated block by
          block,
        - ``std_method``: difference to the slopes of a polynomial with past regressors as
          instruments, what third powers change, and how far noise of the regressors may flatten a
          slope.

        Compact models lack ``std_random`` and ``std_method``.

        ``std_merged`` is how far derivatives by alpha_dot and beta_dot alone may differ from what
        the model merges with others, see the notes; ``merged`` names the larger one.

        Where sizes of the aircraft have ``deviations``, ``std_aircraft`` is what their errors make
        of the values, and ``aircraft`` names the largest. These are shared. Neither is part of
        ``std``: trim, modes and simulations with the same aircraft hardly depend on them. Compare
        derivatives with other sources by all three.

    Notes
    -----
    A model without alpha_dot and beta_dot gives their effect to the rates, as far as they went
    together in the flights: its Cm_q lies between Cm_q and Cm_q + Cm_alpha_dot (Klein & Morelli
    2006, section 5.1; docs/control.md). ``std_merged`` is for derivatives by alpha_dot of 0 +- 0.4
    times those by q, as of a tail in the downwash, and by beta_dot of 0 +- 0.2 times those by r.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, stability_derivatives
    >>> def linear(X):
    ...     alpha, q, elevator = X.T
    ...     zero = 0 * alpha
    ...     return np.stack([-0.04 + 0.3 * alpha, zero, -0.3 - 4.5 * alpha - 0.4 * elevator, zero,
    ...                      0.02 - 0.6 * alpha - 0.12 * q - elevator, zero], axis=-1)
    >>> glider = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.5)
    >>> state = np.array([0, 0, -100, 20, 0, 0, 1, 0, 0, 0, 0, 0, 0])
    >>> table = stability_derivatives(Aerodynamics(linear, ["alpha", "q", "elevator"]), glider, state,
    ...                               {"elevator": 0.0}, thrust=None)
    >>> table.loc[["CL", "CL_alpha", "CD", "Cm_q", "Cm_elevator"], "value"].round(3).to_dict()
    {'CL': 0.3, 'CL_alpha': 4.46, 'CD': 0.04, 'Cm_q': -9.6, 'Cm_elevator': -1.0}
    """
    motion = Motion(model, aircraft, thrust=thrust, air=air)
    if added is not None and motion.aerodynamics.slope_errors is None:
        raise ValueError(
            "Got rows that are added to a model without its own, but expected one that holds the "
            "rows it was learned from: give a pipeline of identify."
        )
    states, controls, single = _points(motion, point, controls)
    now = motion.at(states, controls)
    check_settled(now)
    X, frame = now.regressors, _Frame(motion, now)
    values = frame(now.coefficients, motion.aerodynamics.gradient(X))
    if not np.isfinite(values).all():
        raise ValueError(
            "Got coefficients or slopes that are not finite: the model is not defined there."
        )
    parts: dict[str, Array] = {}
    if check_paths(n_paths) and motion.aerodynamics.is_uncertain:
        parts = _deviations(motion, now, frame, n_paths, random_state, added)
    tables = [
        frame.table(values[k], {name: part[k] for name, part in parts.items()})
        for k in range(len(states))
    ]
    if aircraft.deviations:
        _add_errors_of_aircraft(tables, motion, now, frame)
    if single:
        return tables[0]
    for k, table in enumerate(tables):
        for place, name in enumerate(("airspeed", "alpha", "beta")):
            table.insert(place, name, float(getattr(now, name)[k]))
    return pd.concat(tables, keys=range(len(tables)), names=["point", None])


def _deviations(
    motion: Motion,
    now: Instant,
    frame: _Frame,
    n_paths: int,
    random_state: Seed,
    added: ArrayLike | None,
) -> dict[str, Array]:
    """Return the columns of the table that say what deviations are made of, (n, rows, 1 + columns) each."""
    X, model = now.regressors, motion.aerodynamics
    drawn, regressors = model.sample(n_paths, random_state), np.broadcast_to(X, (n_paths, *X.shape))
    posterior = frame(drawn(regressors), drawn.gradient(regressors)).std(axis=0, ddof=1)
    if model.slope_errors is None:
        return {"std_posterior": posterior}
    errors = model.slope_errors(X)
    if errors is not None and added is not None:
        # A posterior narrows as least squares does; with too few rows no promise is made.
        then = model.slope_errors(X, np.asarray(added, dtype=float))
        white = frame.errors(_each_output(errors.white))
        ratio = np.ones_like(white)
        np.divide(frame.errors(_each_output(then.white)), white, out=ratio, where=white > 0)
        posterior = posterior * ratio
        errors = then
    scatter = 0.0 if errors is None else np.linalg.norm(errors.method, axis=-1)
    lag = frame.errors(lag_of(motion, now, model.gradient(X), scatter).errors, apart=True)
    source = np.where(lag.any(axis=0), 1 + lag.argmax(axis=0), 0)
    parts = {"std_posterior": posterior, "std_merged": np.hypot(*lag), "merged": source}
    if errors is not None:
        parts["std_random"] = frame.errors(errors.random)
        parts["std_method"] = frame.errors(errors.method)
    return parts


def _each_output(std: Array) -> Array:
    """Return errors (n, 6, d, 6) of slopes that are independent between outputs, of standard deviations (n, 6, d)."""
    return std[..., None] * np.eye(6)[:, None]


def _add_errors_of_aircraft(
    tables: list[pd.DataFrame], motion: Motion, now: Instant, frame: _Frame
) -> None:
    """Add what errors of the aircraft's sizes make of the values, and the largest of these errors."""
    aircraft, deviations = motion.aircraft, motion.aircraft.deviations or {}
    slopes = motion.aerodynamics.gradient(now.regressors)
    values = np.concatenate([now.coefficients[..., None], slopes], axis=-1)
    errors = errors_of_sizes(deviations, aircraft.inertia, tuple(motion.regressors), values)
    sizes = np.abs([frame(error[..., 0], error[..., 1:]) for error in errors])
    causes = np.array(list(deviations))
    for k, table in enumerate(tables):
        by_cause = sizes[:, k].reshape(len(causes), -1)
        table["std_aircraft"] = np.sqrt(np.sum(by_cause**2, axis=0))
        table["aircraft"] = np.where(by_cause.any(axis=0), causes[by_cause.argmax(axis=0)], "")


class _Frame:
    """Conversion of coefficients and slopes in body axes to rows and columns of the table of derivatives."""

    def __init__(self, motion: Motion, now: Instant):
        # what turns CX CY CZ Cl Cm Cn into the rows, (n, rows, 6)
        self.turn = np.zeros((len(now.alpha), len(ROWS), 6))
        self.turn[:, :6] = np.eye(6)
        sine, cosine = np.sin(now.alpha), np.cos(now.alpha)
        self.turn[:, 6, 0], self.turn[:, 6, 2] = sine, -cosine  # CL
        self.turn[:, 7, 0], self.turn[:, 7, 2] = -cosine, -sine  # CD
        self.columns = list(motion.regressors)
        # slopes by the conventional quantities over slopes by the model's regressors, (n, d)
        self.scale = np.ones((len(now.airspeed), len(self.columns)))
        for k, name in enumerate(self.columns):
            if name in LENGTHS:
                length = getattr(motion.aircraft, LENGTHS[name])
                usual = rate_factor(name, length, now.airspeed)
                self.scale[:, k] = motion.factor(k, now.airspeed) / usual
        units = {name: channel.unit for name, channel in CHANNELS.items()}
        self.units = units | dict.fromkeys(LENGTHS, "rad") | dict(motion.aerodynamics.units)

    def __call__(self, coefficients: Array, slopes: Array) -> Array:
        """Return values and derivatives, (..., n, rows, 1 + columns), of C (..., n, 6) and slopes (..., n, 6, d)."""
        C = self.turn @ coefficients[..., None]
        S = self.turn @ (slopes * self.scale[:, None, :])
        if "alpha" in self.columns:
            lift, drag, k = (
                *(ROWS.index(name) for name in ("CL", "CD")),
                self.columns.index("alpha"),
            )
            S[..., lift, k] -= C[..., drag, 0]
            S[..., drag, k] += C[..., lift, 0]
        return np.concatenate([C, S], axis=-1)

    def errors(self, errors: Array, apart: bool = False) -> Array:
        """Return the standard deviation (n, rows, 1 + columns) of errors of slopes (n, 6, d, k), or of each error."""
        parts = np.abs(
            [self(np.zeros(part.shape[:2]), part) for part in np.moveaxis(errors, -1, 0)]
        )
        return parts if apart else np.sqrt(np.sum(parts**2, axis=0))

    def table(self, values: Array, parts: dict[str, Array]) -> pd.DataFrame:
        """Return the table of one point, of values and parts of their deviations (rows, 1 + columns)."""
        names = ["", *self.columns]
        pairs = [(row, name) for row in ROWS for name in names]
        table = pd.DataFrame(
            {"value": values.ravel()}, index=[f"{row}_{name}".rstrip("_") for row, name in pairs]
        )
        columns = {name: part.ravel() for name, part in parts.items()}
        if columns:
            table["std"] = np.sqrt(sum(columns[name] ** 2 for name in PARTS if name in columns))
            table["lower"] = table["value"] - NORMAL_95 * table["std"]
            table["upper"] = table["value"] + NORMAL_95 * table["std"]
        table["coefficient"], table["regressor"] = ([pair[k] for pair in pairs] for k in (0, 1))
        table["per"] = [self.units.get(name, "") for _, name in pairs]
        if "merged" in columns:
            lags = np.array(["", *LAGS])[columns.pop("merged").astype(int)]
            merged = [  # the derivative that a derivative may hold a share of
                f"{row}_{LAGS[lag] if name == lag else lag}" if lag else ""
                for (row, name), lag in zip(pairs, lags.tolist(), strict=True)
            ]
            table = table.assign(**columns, merged=merged)
        return table


def _points(
    motion: Motion, point: Any, controls: Mapping[str, ArrayLike] | None
) -> tuple[Array, dict[str, Array], bool]:
    """Return states (n, 13), controls by name (n,), and whether it is a single point."""
    is_single = isinstance(point, Trim) or (np.ndim(point) == 1 and not isinstance(point[0], Trim))
    points = [point] if is_single else list(point)
    columns = {
        name: np.broadcast_to(value, len(points)) for name, value in (controls or {}).items()
    }
    flights = [
        flight_point(motion, item, {name: x[k] for name, x in columns.items()} or None)
        for k, item in enumerate(points)
    ]
    states = np.stack([state for state, _ in flights])
    names = flights[0][1]
    return states, {n: np.array([row[n] for _, row in flights]) for n in names}, is_single
