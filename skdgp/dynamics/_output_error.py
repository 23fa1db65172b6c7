"""Output error: a model of coefficients corrected so that free flight fits recorded states."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import t as student
from sklearn.utils import check_random_state

from skdgp._compute.linalg import eigen_root
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp._flight.channels import EULER
from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_codes
from skdgp._flight.frames import wrapped
from skdgp._mechanics.aerodynamics import Aerodynamics, as_aerodynamics
from skdgp._mechanics.air import as_air
from skdgp._mechanics.aircraft import Aircraft
from skdgp._mechanics.error_covariance import checked_std
from skdgp._mechanics.loads import Thrust
from skdgp._mechanics.motion import Motion
from skdgp._mechanics.record import Clock, channels, fly_record
from skdgp.dynamics._inputs import as_starts, control_schedule, initial_states, perturbed
from skdgp.dynamics._simulate import is_control
from skdgp.dynamics._wind import wind_schedule

SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Factors of the prior covariance that are tried; the first is so small that it shows the direction
alone.
"""
CONFIDENCE = 0.9
"""Of Student's one-sided test that a correction predicts flights left out better."""
SUPPORT = 60
"""Points of the flights at which the affine part of the posterior is taken."""
SURE = 1e-6
"""Directions of the affine part with a smaller share of the largest standard deviation are left as
they are.
"""
N_DRIFTS, KEPT = 150, 0.9
"""Drifts from which the covariance of the states is estimated, and the share of it that is kept off
the diagonal.
"""
MOST_STEPS = 6
SLOPE_STEP = 0.3
"""Of finite differences, in prior standard deviations."""
N_TIMES = 5
"""Times of a segment at which states are compared, evenly spaced, the last at the end of the
shortest.
"""
SMALLEST_GAIN = 0.01
"""Relative decrease of the loss below which iterations end."""


class OutputError(NamedTuple):
    """Result of `fit_output_error`."""

    model: Aerodynamics
    """The corrected model, or the given one where no correction predicts segments held out better.
    """
    correction: Matrix
    """Of the coefficients: by a constant and by standardised regressors, (6, 1 + d)."""
    prior_scale: float
    """Factor of the prior covariance; 0 where there is no correction."""
    held_out: pd.Series
    """Mean squared errors of states held out, white, by factor; 0: without a correction."""
    loss: tuple[float, float]
    """Mean squared errors of all states, white, before and after."""


def fit_output_error(
    model: Any,
    aircraft: Aircraft,
    flights: Sequence[pd.DataFrame],
    noise: Mapping[str, float],
    *,
    dt: float = 0.02,
    air: Any = None,
    thrust: Thrust = "auto",
    random_state: Seed = 0,
) -> OutputError:
    r"""Correct a model so that its free flight from recorded starts fits the recorded states.

    The method of output error (Jategaonkar 2015, chapter 4), with the model's posterior as prior
    and its drift as process noise. The correction of the coefficients is affine in the regressors,
    :math:`\Phi(x) \theta`. It minimises

    .. math:: \sum_s r_s^T C_s^{-1} r_s + \theta^T (k P)^{-1} \theta

    by Gauss-Newton steps: r are the recorded less the simulated states of a segment at five times,
    C the covariance of both by ``noise`` and the drift, and P the prior covariance of the affine
    part of the model's errors. The factor k is the one that predicts best when each flight is left
    out in turn (each segment of a single flight), to first order. **The model is returned as it is
    where a correction does not predict these better**: where Student's one-sided test of the gains
    of a small correction (k = 0.1) does not show it with 90 % confidence.

    Paths of the corrected model are those of the model, with their affine part drawn anew from
    :math:`N(\theta, (\sum_s J_s^T C_s^{-1} J_s + (k P)^{-1})^{-1})`.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`, with a posterior.
    flights : sequence of DataFrame
        Segments of 1 to 10 s, with ``time``, the states, the controls, and what is needed of a
        start; a column ``flight`` names their flights. May be the flights that the model was
        learned from.
    noise : mapping of str to float
        Standard deviations of the recorded states that are fitted, and of the start: u, v, w or
        v_north, v_east, v_down, phi, theta, psi, p, q, r, perhaps north, east, down.
    dt : float, default=0.02
        Time step [s].
    air, thrust
        As for :func:`skdgp.dynamics.simulate`; a list of winds has one for each segment, no gusts
        are drawn.
    random_state : int or RandomState, default=0
        Of the drifts.

    Returns
    -------
    OutputError

    Raises
    ------
    ValueError
        If the model has no posterior, there are fewer than two segments, or none is flown to its
        end; those that are not are left out with a warning.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, fit_output_error, simulate
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> def coefficients(X, Cm_alpha=-0.4):
    ...     alpha, beta, p, q, r, elevator = X.T
    ...     return np.stack([-0.02 + 2 * alpha**2, -0.4 * beta, -0.2 - 4.5 * alpha, -0.05 * beta - 0.4 * p + 0.1 * r,
    ...                      0.02 + Cm_alpha * alpha - 8 * q - 0.8 * elevator, 0.08 * beta - 0.1 * r], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator"]
    >>> def sampler(n_paths, random_state):                             # of a posterior that is sure but of Cm_alpha
    ...     slopes = np.random.default_rng(random_state).normal(-0.4, 0.1, n_paths)
    ...     return lambda X: np.stack([coefficients(x, slope) for x, slope in zip(X, slopes)]), None
    >>> def covariance(X):
    ...     root = np.kron(np.eye(6)[4], 0.1 * X[:, 0])
    ...     return np.outer(root, root)
    >>> model = Aerodynamics(coefficients, names, sampler=sampler, covariance=covariance)
    >>> truth = Aerodynamics(lambda X: coefficients(X, -0.5), names)
    >>> starts = [{"airspeed": 12.0, "alpha": alpha, "altitude": 100.0} for alpha in (0.0, 0.05, 0.1)]
    >>> flown = [simulate(truth, glider, start, {"elevator": -0.01}, duration=2.0, thrust=None) for start in starts]
    >>> fitted = fit_output_error(model, glider, flown, {"theta": 0.001, "q": 0.005}, thrust=None)
    >>> (fitted.model.gradient([0.05, 0, 0, 0, 0, 0])[4, 0]).round(2)
    np.float64(-0.5)
    """
    aerodynamics = as_aerodynamics(model)
    if not aerodynamics.is_uncertain:
        raise ValueError(
            f"Got a model without a posterior ({aerodynamics!r}), but expected one to be the prior."
        )
    if len(flights) < 2:
        raise ValueError(
            f"Got {len(flights)} segment, but expected at least two: cut the flight into seconds."
        )
    problem = _Problem(aerodynamics, aircraft, list(flights), noise, dt, random_state, air, thrust)
    z = np.zeros(problem.root.shape[1])
    residuals, slopes = problem.linear(z)
    left_out, before = _left_out(problem, residuals, slopes), float(np.mean(residuals**2))
    held_out = left_out.mean()
    gain = left_out[0.0] - left_out[SCALES[0]]
    if len(gain) < 2 or gain.mean() <= student.ppf(
        CONFIDENCE, len(gain) - 1
    ) * gain.std() / np.sqrt(len(gain)):
        return OutputError(aerodynamics, np.zeros(problem.shape), 0.0, held_out, (before, before))
    scale = min(SCALES, key=lambda k: float(held_out[k]))
    z, residuals, slopes = _minimum(problem, residuals, slopes, scale)
    theta = (problem.root @ z).reshape(problem.shape)
    _, H = _step(residuals, slopes, scale, z)
    root = problem.root @ np.linalg.inv(np.linalg.cholesky(H)).T
    model = problem.correction.corrected(theta, root)
    return OutputError(model, theta, scale, held_out, (before, float(np.mean(residuals**2))))


class _Correction:
    """A model plus a correction that is affine in the regressors: mean, paths and covariance."""

    def __init__(self, before: Aerodynamics, regressors: Matrix):
        """``regressors`` (n, d) are those of the flights: they set the units, and where the model is affine."""
        self.before = before
        self.middle, scale = regressors.mean(axis=0), regressors.std(axis=0)
        self.unit = np.where(scale > 0, scale, 1.0)
        self.support = regressors[np.linspace(0, len(regressors) - 1, SUPPORT).astype(int)]
        self.affine = np.linalg.pinv(self.basis(self.support))

    def basis(self, X: Array) -> Array:
        """Return Phi (..., 1 + d): a constant and the standardised regressors."""
        return np.concatenate([np.ones((*X.shape[:-1], 1)), (X - self.middle) / self.unit], axis=-1)

    def affine_root(self) -> Matrix:
        """Return R (6 (1 + d), r) with the covariance R R^T of the affine part of the model's errors."""
        A = np.kron(np.eye(6), self.affine)
        root = eigen_root(A @ self.before.covariance(self.support) @ A.T)
        size = np.linalg.norm(root, axis=0)
        return root[:, size > SURE * size.max()]

    def paths(self, theta: Array) -> Aerodynamics:
        """Return the mean with a correction (n_paths, 6, 1 + d) for each path, to be sampled."""

        def values(X):
            mean = self.before.function(X.reshape(-1, X.shape[-1])).reshape(*X.shape[:-1], 6)
            return mean + np.einsum("p...d,pcd->p...c", self.basis(X), theta)

        model = copy.copy(self.before)
        model._sampler = lambda n_paths, random_state: (values, None)
        return model

    def corrected(self, theta: Matrix, root: Matrix) -> Aerodynamics:
        """Return the model with the correction theta (6, 1 + d), whose covariance is ``root @ root.T``."""
        model = copy.copy(self.before)
        self.theta, self.root = theta, root
        model.function, model._gradient = self._values, self._slopes
        model._sampler, model._covariance = self._sample, self._covariance
        model.function_errors = None  # its flights tell the affine part
        return model

    def _values(self, X: Array) -> Array:
        return self.before.function(X) + self.basis(X) @ self.theta.T

    def _slopes(self, X: Array) -> Array:
        return self.before.gradient(X) + self.theta[:, 1:] / self.unit

    def _sample(self, n_paths: int, random_state: Any) -> tuple[Any, Any]:
        """Return paths of the model with their affine part replaced by that of the correction."""
        drawn = self.before.sample(n_paths, random_state)
        gradient = drawn._gradient
        at = np.broadcast_to(self.support, (n_paths, *self.support.shape))
        error = np.swapaxes(
            self.affine @ (drawn.function(at) - self.before.function(self.support)), 1, 2
        )
        seed = check_random_state(random_state).randint(
            2**31 - 1, size=6
        )  # other numbers than those of the paths
        z = np.random.default_rng(seed).standard_normal((n_paths, self.root.shape[1]))
        theta = self.theta + (z @ self.root.T).reshape(-1, *self.theta.shape) - error

        def values(X):
            return drawn.function(X) + np.einsum("p...d,pcd->p...c", self.basis(X), theta)

        if gradient is None:
            return values, None
        return values, lambda X: gradient(X) + (theta[..., 1:] / self.unit)[:, None]

    def _covariance(self, X: Matrix) -> Matrix:
        n, both = len(X), np.vstack([X, self.support])
        joint = self.before.covariance(both)
        lift = np.hstack(
            [np.eye(n), -self.basis(X) @ self.affine]
        )  # of errors without their affine part
        A, spread = np.kron(np.eye(6), lift), np.kron(np.eye(6), self.basis(X)) @ self.root
        return A @ joint @ A.T + spread @ spread.T


class _Problem:
    """Recorded segments, the states that a correction gives, their slopes and their covariance."""

    def __init__(self, aerodynamics, aircraft, flights, noise, dt, random_state, air, thrust):
        self.noise = {name: std for name, std in checked_std(noise).items() if std > 0}
        self.names, self.aerodynamics = list(self.noise), aerodynamics
        if not self.names:
            raise ValueError(
                f"Got noise={dict(noise)!r}, but expected standard deviations > 0 of states to "
                f"fit, by name."
            )
        for flight in flights:
            check_columns(flight, ["time", *self.names], what="segment")
            if not np.isfinite(flight[self.names].to_numpy(float)).all():
                raise ValueError(
                    f"Got a segment with missing values in {self.names}, but expected numbers: "
                    f"fill them."
                )
        air = as_air(air)
        self.motion = Motion(aerodynamics, aircraft, thrust=thrust, air=air)
        self.clock = Clock.of(dt, min(float(np.ptp(flight["time"])) for flight in flights), [])
        self.steps = np.linspace(0, self.clock.n_steps, N_TIMES + 1).round().astype(int)[1:]
        self.air = wind_schedule(air.wind, self.clock, len(flights))
        self.commands = control_schedule(flights, self.clock, is_control(self.motion), len(flights))
        starts = as_starts(pd.concat([flight.iloc[:1] for flight in flights], ignore_index=True))
        self.starts = initial_states(starts, lambda at: self.air(0, at))
        self.recorded = np.stack([self._at_times(flight) for flight in flights])
        codes, names = flight_codes(
            [flight["flight"].iloc[0] if "flight" in flight else 0 for flight in flights]
        )
        self.units = codes if len(names) > 1 else np.arange(len(flights))
        record = self._record(aerodynamics, self.starts)
        self.flown = record.end > self.clock.n_steps
        if not self.flown.any():
            raise ValueError(
                f"Got {len(flights)} segments of {self.clock.n_steps * dt:g} s, none of which the "
                f"model flies to its "
                "end: cut shorter ones, or look at starts, controls, wind and thrust."
            )
        if not self.flown.all():
            warnings.warn(
                f"{np.count_nonzero(~self.flown)} of {len(flights)} segments are left out: the "
                f"model does not fly them "
                "to their end. Cut shorter ones.",
                stacklevel=3,
            )
        met = record.regressors[:, self.flown]
        self.correction = _Correction(aerodynamics, met.reshape(-1, met.shape[-1]))
        self.root = self.correction.affine_root()  # theta = root @ z, with z ~ N(0, k)
        self.whitening = self._whitening(random_state)

    def _at_times(self, flight: pd.DataFrame) -> Matrix:
        """Return the recorded states at the times, (n_times, n_states)."""
        time = flight["time"].to_numpy(float)
        at = time[0] + self.clock.dt * self.steps
        values = flight[self.names].to_numpy(float).T
        turned = [
            np.unwrap(v) if name in EULER else v for name, v in zip(self.names, values, strict=True)
        ]
        return np.stack([np.interp(at, time, v) for v in turned], axis=-1)

    def _record(self, model: Aerodynamics, states: Array, drifts: Array | None = None) -> Any:
        self.motion.aerodynamics = model
        return fly_record(self.motion, self.commands, self.air, self.clock, states, drifts)

    def _flown(self, theta: Array, seed: Seed = 0, *, disturbed: bool = False) -> Array:
        """Return the states (n_paths, n_segments, n_times, n_states) with corrections (n_paths, 6, 1 + d).

        ``disturbed``: by errors of the start and by drifts.
        """
        model = self.correction.paths(theta).sample(len(theta))
        states = perturbed(self.starts, self.noise if disturbed else None, len(theta), seed)
        drift = self.aerodynamics.drift if disturbed else None
        drifts = None if drift is None else drift.draw(self.clock.stages, states.shape[:-1], seed)
        found = channels(self._record(model, states, drifts).states[self.steps])
        return np.moveaxis(np.stack([found[name] for name in self.names], axis=-1), 0, 2)

    def _off(self, one: Array, other: Array) -> Array:
        """Return differences of states, those of angles on the circle."""
        off = one - other
        turns = np.isin(self.names, EULER)
        off[..., turns] = wrapped(off[..., turns])
        return off

    def _whitening(self, random_state: Seed) -> Array:
        """Return W (n_segments, m, m) with W C W^T = 1, for the m states of a segment at all times."""
        drawn = self._flown(np.zeros((N_DRIFTS, *self.shape)), random_state, disturbed=True)
        errors = self._off(drawn, self._flown(np.zeros((1, *self.shape)))).reshape(
            N_DRIFTS, len(self.starts), -1
        )
        found = []
        for each in np.moveaxis(errors[:, self.flown], 1, 0):
            each = each[np.isfinite(each).all(axis=1)]
            C = KEPT * (each.T @ each) / len(each)
            C += np.diag(
                (1 / KEPT - 1) * np.diag(C)
                + np.tile(np.square([*self.noise.values()]), len(self.steps))
            )
            found.append(np.linalg.inv(np.linalg.cholesky(C)))
        return np.stack(found)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of a correction."""
        return 6, self.correction.basis(self.correction.middle).size

    def white(self, off: Array) -> Array:
        """Return differences of states, (..., n_segments, n_times, n_states), with unit covariance, (..., s, m)."""
        off = off[..., self.flown, :, :]
        return np.einsum("sij,...sj->...si", self.whitening, off.reshape(*off.shape[:-2], -1))

    def linear(self, z: Vector) -> tuple[Any, Any]:
        """Return residuals (s, m) and slopes of the states by z (s, m, r), white."""
        theta = (self.root @ np.column_stack([z, z[:, None] + SLOPE_STEP * np.eye(len(z))])).T
        states = self._flown(theta.reshape(-1, *self.shape))
        slopes = self.white(self._off(states[1:], states[:1])) / SLOPE_STEP
        return self.white(self._off(self.recorded, states[0])), np.moveaxis(
            np.nan_to_num(slopes), 0, -1
        )


def _step(residuals: Array, slopes: Array, scale: float, z: Vector) -> tuple[Any, Any]:
    """Return the minimum of |residuals - slopes (x - z)|^2 + |x|^2 / scale, and half its Hessian."""
    r, J = residuals.ravel(), slopes.reshape(-1, slopes.shape[-1])
    H = J.T @ J + np.eye(J.shape[1]) / scale
    return np.linalg.solve(H, J.T @ (r + J @ z)), H


def _left_out(problem: _Problem, residuals: Array, slopes: Array) -> pd.DataFrame:
    """Return the mean squared residuals of units left out in turn, by factor of the prior covariance: first order."""
    units, zero = problem.units[problem.flown], np.zeros(slopes.shape[-1])
    rows = []
    for out in (units == unit for unit in np.unique(units)):
        found = {scale: _step(residuals[~out], slopes[~out], scale, zero)[0] for scale in SCALES}
        off = {0.0: residuals[out]} | {
            scale: residuals[out] - slopes[out] @ z for scale, z in found.items()
        }
        rows.append({scale: float(np.mean(each**2)) for scale, each in off.items()})
    return pd.DataFrame(rows)


def _minimum(
    problem: _Problem, residuals: Array, slopes: Array, scale: float
) -> tuple[Vector, Array, Array]:
    """Return the best z by Gauss-Newton steps from zero, halved where they go too far; residuals and slopes there."""
    z = np.zeros(slopes.shape[-1])
    loss = float(np.sum(residuals**2))
    for _ in range(MOST_STEPS):
        best, last = _step(residuals, slopes, scale, z)[0], loss
        for share in (1.0, 0.5, 0.25):
            trial = z + share * (best - z)
            found = problem.linear(trial)
            if (value := float(np.sum(found[0] ** 2) + trial @ trial / scale)) < loss:
                z, (residuals, slopes), loss = trial, found, value
                break
        if loss > (1 - SMALLEST_GAIN) * last:
            break
    return z, residuals, slopes
