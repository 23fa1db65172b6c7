"""Linear models about a steady flight: A, B, C, D with names, their spread, and modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._flight.checks import check_names
from skdgp._flight.frames import quaternion_to_euler
from skdgp.dynamics._control.jacobian import OUTPUTS, check_settled, jacobian
from skdgp.dynamics._control.modes import mode_table
from skdgp.dynamics._equations.motion import Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, RATES, STANDARD_GRAVITY
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import thrust_control

__all__ = ["LinearModel", "Matrices", "check_paths", "flight_point", "linearize"]

ALL_STATES = ("north", "east", "down", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r")
STATES = ("u", "w", "q", "theta", "v", "p", "r", "phi")
ALONG = {"north", "down", "u", "w", "theta", "q", "airspeed", "alpha", "ax", "az"}
ACROSS = {"east", "v", "phi", "psi", "p", "r", "beta", "ay"}
LATERAL_CONTROLS, LONGITUDINAL_CONTROLS = {"aileron", "rudder"}, {"elevator", "thrust", "throttle", "propeller_speed"}


class Matrices(NamedTuple):
    """A, B, C, D: tables, or arrays with the paths as first axis."""

    A: pd.DataFrame | np.ndarray
    B: pd.DataFrame | np.ndarray
    C: pd.DataFrame | np.ndarray
    D: pd.DataFrame | np.ndarray


@dataclass(frozen=True, eq=False)
class LinearModel:
    r"""Small motions about a flight: :math:`\dot x = A x + B u,\; y = C x + D u`, all of them changes.

    Parameters
    ----------
    A, B, C, D : DataFrame
        Rows and columns carry the names of states, inputs, outputs.
    state : ndarray of shape (13,)
    controls : dict
        Where it was taken.
    paths : Matrices or None
        The same of each path of the posterior, (n_paths, ...).
    """

    A: pd.DataFrame
    B: pd.DataFrame
    C: pd.DataFrame
    D: pd.DataFrame
    state: np.ndarray
    controls: dict
    paths: Matrices | None = None

    @property
    def states(self) -> list[str]:
        """Their names."""
        return list(self.A.columns)

    @property
    def inputs(self) -> list[str]:
        """Their names."""
        return list(self.B.columns)

    @property
    def outputs(self) -> list[str]:
        """Their names."""
        return list(self.C.index)

    @property
    def std(self) -> Matrices:
        """Standard deviations of the entries over the paths, as tables.

        Raises
        ------
        ValueError
            If there are no paths.
        """
        if self.paths is None:
            raise ValueError("Got a linear model without paths: linearize(..., n_paths=100) tells how sure it is.")
        means = (self.A, self.B, self.C, self.D)
        return Matrices(
            *(
                pd.DataFrame(path.std(axis=0, ddof=1), index=mean.index, columns=mean.columns)
                for path, mean in zip(self.paths, means, strict=True)
            )
        )

    def select(self, states: Sequence[str], inputs: Sequence[str], outputs: Sequence[str]) -> LinearModel:
        """Return the part with these states, inputs and outputs; what is left out stands still."""
        for asked, have, what in (
            (states, self.states, "states"), (inputs, self.inputs, "inputs"), (outputs, self.outputs, "outputs")
        ):  # fmt: skip
            check_names(asked, have, f"{what} of the linear model")
        blocks = ((states, states), (states, inputs), (outputs, states), (outputs, inputs))
        tables = [table.loc[list(a), list(b)] for table, (a, b) in zip(self._tables(), blocks, strict=True)]
        paths = None
        if self.paths is not None:
            cut = [
                values[:, table.index.get_indexer(list(a))][:, :, table.columns.get_indexer(list(b))]
                for values, table, (a, b) in zip(self.paths, self._tables(), blocks, strict=True)
            ]
            paths = Matrices(*cut)
        return LinearModel(*tables, self.state, self.controls, paths)

    def longitudinal(self) -> LinearModel:
        """Return the motion in the plane of symmetry, u w q theta, with all inputs but aileron and rudder."""
        return self._without(ACROSS, LATERAL_CONTROLS)

    def lateral(self) -> LinearModel:
        """Return the motion across the plane of symmetry, v p r phi, with all inputs but elevator and thrust."""
        return self._without(ALONG, LONGITUDINAL_CONTROLS)

    def modes(self) -> pd.DataFrame:
        r"""Return a row for each mode: what it is called, how fast it is, how it is damped.

        A pair of roots is :math:`s^2 + 2\zeta\omega s + \omega^2`. Longitudinal modes are told from lateral ones, the
        short period from the phugoid (w and q), the Dutch roll from roll and spiral (v and r, p) by participation
        factors (Perez-Arriaga, Verghese & Schweppe 1982): the share of each state in each mode, whatever its unit. A
        pair that has split into two real roots keeps its name with a number; a roll and a spiral that have become one
        oscillation are the "roll-spiral". Position, height and heading are left out: they integrate.

        Returns
        -------
        DataFrame
            Columns ``eigenvalue`` [1/s], ``frequency`` [rad/s], undamped, ``damping``, ``time_constant`` [s], negative
            where it diverges, ``time_to_half``, ``time_to_double``, ``period`` [s], infinite where there is none. With
            paths also ``frequency_std``, ``damping_std``, and ``time_constant_lower``, ``time_constant_upper``, which
            hold 95 % of the paths: the upper one is infinite where some do not decay.
        """
        return mode_table(self.A.to_numpy(), self.states, None if self.paths is None else self.paths.A)

    def to_scipy(self):
        """Return it as :class:`scipy.signal.StateSpace`, which has no names."""
        from scipy.signal import StateSpace

        return StateSpace(*(table.to_numpy() for table in self._tables()))

    def to_control(self):
        """Return it as :class:`control.StateSpace` of python-control, with names.

        Raises
        ------
        ImportError
            If python-control is absent.
        """
        try:
            import control
        except ImportError as error:
            raise ImportError(
                'to_control() needs python-control, which is not installed: run pip install "skdgp[control]".'
            ) from error
        tables = (table.to_numpy() for table in self._tables())
        return control.ss(*tables, states=self.states, inputs=self.inputs, outputs=self.outputs)

    def _tables(self):
        return self.A, self.B, self.C, self.D

    def _without(self, names, inputs) -> LinearModel:
        return self.select(
            [name for name in self.states if name not in names],
            [name for name in self.inputs if name not in inputs],
            [name for name in self.outputs if name not in names],
        )


def linearize(
    model,
    aircraft: Aircraft,
    point,
    controls: Mapping[str, float] | None = None,
    *,
    states: Sequence[str] = STATES,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    n_paths: int = 0,
    random_state=0,
    thrust="auto",
    gravity: float = STANDARD_GRAVITY,
    density=None,
) -> LinearModel:
    """Linearise an aircraft's motion about a trim, through the slopes of its model.

    Regressors that follow from the loads (alpha_dot, accelerations) are taken along by the implicit function theorem.
    Air is at rest; in steady wind the same holds of the motion relative to the air.

    Parameters
    ----------
    model : Aerodynamics, Pipeline or estimator
        As for :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    point : Trim or array-like of shape (13,)
        Where: a trim, or a state (`STATE_NAMES`) with its ``controls``.
    controls : mapping of str to float, optional
    states : sequence of str
        Of north, east, down, u, v, w [m/s], phi, theta, psi [rad], p, q, r [rad/s]. Those left out stand still: with
        ``"down"`` the density changes with height.
    inputs : sequence of str, optional
        By default the model's controls and what sets the thrust.
    outputs : sequence of str, optional
        Of the states and airspeed, alpha, beta, ax, ay, az; by default all ``states`` and these six.
    n_paths : int
        How many functions of the model's posterior to linearise too, at the same point, for `LinearModel.std` and the
        spread of the modes.
    random_state : int, RandomState instance or None
        Of these.
    thrust, gravity, density
        As for :func:`skdgp.dynamics.simulate`.

    Returns
    -------
    LinearModel

    Raises
    ------
    ValueError
        If a name is unknown, the airspeed is zero, or the model is not defined there.

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
    motion = Motion(model, aircraft, thrust=thrust, gravity=gravity, density=density)
    state, controls = flight_point(motion, point, controls)
    engine = thrust_control(aircraft, thrust)
    known = list(dict.fromkeys([*motion.controls, *([engine] if engine in controls else [])]))
    inputs = known if inputs is None else list(inputs)
    check_names(inputs, controls, "controls of this flight, of which the inputs are chosen,")
    check_names(states, ALL_STATES, "states")
    outputs = list(dict.fromkeys([*states, *OUTPUTS])) if outputs is None else list(outputs)
    check_names(outputs, (*ALL_STATES, *OUTPUTS), "outputs")
    chosen = list(states), inputs, outputs
    paths = None
    if check_paths(n_paths):
        drawn = Motion(
            motion.aerodynamics.sample(n_paths, random_state), aircraft, thrust=thrust, gravity=gravity, density=density
        )
        paths = _matrices(drawn, np.broadcast_to(state, (n_paths, 13)), controls, *chosen)
    tables = _matrices(motion, state, controls, *chosen)
    names = ((states, states), (states, inputs), (outputs, states), (outputs, inputs))
    tables = [pd.DataFrame(t, index=list(a), columns=list(b)) for t, (a, b) in zip(tables, names, strict=True)]
    return LinearModel(*tables, state, controls, paths)


def check_paths(n_paths: int) -> int:
    """Return the number of paths, none or enough to have a spread."""
    if n_paths < 0 or n_paths == 1:
        raise ValueError(f"Got n_paths={n_paths!r}, but expected 0 or at least 2: one path has no spread.")
    return n_paths


def flight_point(motion: Motion, point, controls) -> tuple[np.ndarray, dict]:
    """Return state (13,) and controls of a trim, or of a state and its controls."""
    if isinstance(point, Sequence) and any(hasattr(one, "state") for one in point):
        raise TypeError(f"Got {len(point)} trims, but expected one: [linearize(model, aircraft, t) for t in trims].")
    state = np.array(getattr(point, "state", point), dtype=float)
    controls = getattr(point, "controls", None) if controls is None else controls
    if state.shape != (13,) or not np.isfinite(state).all():
        raise ValueError(
            f"Got a point of shape {state.shape} or with values that are not finite, but expected a Trim or a state of "
            "13 finite numbers (STATE_NAMES)."
        )
    if controls is None:
        raise ValueError(f"Got a state without controls, but expected controls={{name: value}} of {motion.controls}.")
    if not np.linalg.norm(state[3:6]) > 0:
        raise ValueError("Got a state at rest, but expected an airspeed > 0: coefficients are loads over rho V^2 / 2.")
    return state, {name: float(value) for name, value in motion.mixed(controls).items()}


def _matrices(motion: Motion, state, controls, states, inputs, outputs) -> Matrices:
    found = jacobian(motion, state, controls, inputs=inputs)
    check_settled(found.instant)
    if not np.isfinite(found.state).all():
        raise ValueError("Got slopes of the model that are not finite at this point: it is not defined there.")
    rate, change = _in_euler_angles(found.state, state)
    rows, all_outputs = [ALL_STATES.index(name) for name in states], (*ALL_STATES, *OUTPUTS)
    seen = [all_outputs.index(name) for name in outputs]
    C = np.concatenate([np.broadcast_to(np.eye(12), rate.shape), found.outputs_state @ change], axis=-2)
    B = np.array(found.controls)
    D = np.concatenate([np.zeros_like(B), found.outputs_controls], axis=-2)
    return Matrices(rate[..., rows, :][..., rows], B[..., rows, :], C[..., seen, :][..., rows], D[..., seen, :])


def _in_euler_angles(rate, state) -> tuple[np.ndarray, np.ndarray]:
    """Return A of the states with Euler angles, and d error / d state, of A of the states with small rotations."""
    phi, theta, _ = np.moveaxis(quaternion_to_euler(state[..., ATTITUDE]), -1, 0)
    _, q, r = np.moveaxis(state[..., RATES], -1, 0)
    sin, cos, tan, sec = np.sin(phi), np.cos(phi), np.tan(theta), 1.0 / np.cos(theta)
    change = np.zeros_like(rate) + np.eye(12)
    change[..., 6, 6], change[..., 6, 8] = 1.0, -np.sin(theta)
    change[..., 7, 7], change[..., 7, 8] = cos, sin * np.cos(theta)
    change[..., 8, 7], change[..., 8, 8] = -sin, cos * np.cos(theta)
    rate = rate @ change
    yaw, pitch = q * sin + r * cos, q * cos - r * sin
    rate[..., 6:9, :] = 0.0
    rate[..., 6, 6], rate[..., 6, 7] = tan * pitch, yaw * sec**2
    rate[..., 7, 6] = -yaw
    rate[..., 8, 6], rate[..., 8, 7] = pitch * sec, yaw * sec * tan
    rate[..., 6, 9], rate[..., 6, 10], rate[..., 6, 11] = 1.0, sin * tan, cos * tan
    rate[..., 7, 10], rate[..., 7, 11] = cos, -sin
    rate[..., 8, 10], rate[..., 8, 11] = sin * sec, cos * sec
    return rate, change
