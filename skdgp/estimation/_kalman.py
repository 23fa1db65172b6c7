r"""Extended Kalman filter and smoother of the filter-error method, linear about the last pass.

The nonlinear functions are evaluated for all samples at once, at the states X of the pass before
(``_air_linearization.py``); the loop over time is a linear filter of the deviation x from X,

.. math:: x_{k+1} = \Phi_k x_k + c_k + w_k, \quad y_k = H_k (x_{k+1} - c_k) + v_k, \quad
          w_k \sim N(0, Q_k), \quad v_k \sim N(0, R_k),

where c is the state that X predicts less X there, and y the error of the sensors at that predicted
state. Its step predicts and corrects (Kalman 1960; Jategaonkar 2015, chapter 5):

.. math:: P^- = \Phi P \Phi^T + Q, \quad S = H P^- H^T + R, \quad K = P^- H^T S^{-1}, \quad
          P = P^- - K H P^-.

At the fixed point of the passes this is the extended Kalman filter. Each sample is used twice. The
update of the state, above, also uses the recorded motion over the ground: y is the residual of a
prediction with it. For the estimation a sample has an innovation, the error of a prediction from
earlier samples alone. About X it is :math:`\epsilon_k`, and

.. math:: e_k = \epsilon_k - D_k x_k, \quad S_k^e = D_k P D_k^T + Q_k^e + R_k,

where the noise :math:`Q^e` of the step reaches the sensors by D from its beginning, and by L from its
end. A gust moves the aircraft within the step, so an innovation that knows the recorded motion would
lack part of the gust.

Parameters and instruments :math:`\theta` add :math:`\Theta_k \theta` to the state after a step, and
:math:`E_k \theta` and :math:`F_k \theta` to the predictions behind :math:`\epsilon_k` and :math:`y_k`. With the
slopes Z of the filtered states at given gains, an innovation has the slopes
:math:`\partial e_k / \partial \theta = -(D_k Z_k + E_k)`, where

.. math:: Z_{k+1} = (I - K_k H_k) (\Phi_k Z_k + \Theta_k) - K_k F_k.

Errors of the surfaces are :math:`\kappa` times their change within a step. They add to Q and R.

n samples, N states, m sensors, q slopes by the parameters of a flight and the instruments, s sets of
noises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import lapack

from skdgp._compute.linalg import matrix_vector
from skdgp._compute.typing import Array, Matrix, Vector

STEPS_IN_MEMORY = 256  # whose matrices are in memory at a time


class Linearization(NamedTuple):
    """A record of n samples of m sensors, linear in N states, about states X.

    Errors of the predictions behind each step are measured less predicted.
    """

    states: Matrix  # (n, N) X, filtered states of the last pass
    predicted: Matrix  # (n - 1, N) states of samples 1 to n - 1, from X
    Phi: Array  # (n - 1, N, N) predicted state by the state before
    past_error: Matrix  # (n - 1, m) epsilon, of a prediction from the past alone
    D: Array  # (n - 1, m, N) its prediction by the state before
    L: Array  # (n - 1, m, N) by a push at the end of the step
    path_error: Matrix  # (n - 1, m) y, of a prediction with the recorded motion
    H: Array  # (n - 1, m, N) its prediction by the predicted state
    time_step: Vector  # (n - 1,) length of each step [s]
    surface_noise: Array  # (n - 1, N, N) covariance of the states by surfaces, per kappa^2
    surface_reading_variance: Matrix  # (n - 1, m) variance of the sensors by surfaces, per kappa^2
    missing: Matrix  # (n - 1, m) variance that is added to a sensor's: huge where not sampled
    vibration: Matrix  # (m, m) covariance of the sensors by vibration

    def part(self, first: int, last: int) -> Linearization:
        """Return the steps ``first`` to ``last`` - 1, with the state after them."""
        whole = self._asdict()
        of_steps = {name: values[first:last] for name, values in whole.items()}
        ends = {"states": self.states[first : last + 1], "vibration": self.vibration}
        return Linearization(**of_steps | ends)

    def middle(self, n_steps: int) -> Linearization:
        """Return the linearization of at most ``n_steps`` steps in the middle."""
        first = max(len(self.time_step) - n_steps, 0) // 2
        return self.part(first, first + n_steps)


class Slopes(NamedTuple):
    """Slopes of k steps by q parameters and instruments."""

    Theta: Array  # (k, N, q) of the states after each step
    E: Array  # (k, m, q) of the prediction behind epsilon
    F: Array  # (k, m, q) of the prediction behind y


class Noise(NamedTuple):
    """s sets of noises."""

    density: Matrix  # (s, N) of the white noise that drives the states [units^2/s]
    decay: Matrix  # (s, N) 1 / correlation time of states, 0 where the transition has it
    surface: Vector  # (s,) kappa^2
    sensor: Matrix  # (s, m) variances
    start: Matrix  # (s, N) variances of the first state


class Innovations(NamedTuple):
    """Innovations of the past alone at s sets of noises, or at one."""

    values: Array  # (n - 1, s, m)
    covariance: Array  # (n - 1, s, m, m)


class Pass(NamedTuple):
    """One pass of the filter at one set of noises."""

    innovations: Innovations  # (n - 1, m), (n - 1, m, m)
    states: Matrix  # (n, N)
    covariance: Array  # (n, N, N)
    predicted_covariance: Array  # (n - 1, N, N)
    gain: Array  # (n - 1, N, m)


class _FilterMatrices(NamedTuple):
    """Matrices of the linear filter, a few steps k at s sets of noises."""

    Phi: Array  # (k, s, N, N)
    Q: Array  # (k, s, N, N)
    c: Array  # (k, N, 1) predicted less expansion point
    H: Array  # (k, m, N)
    R: Array  # (k, s, m, m)
    y: Array  # (k, m, 1)

    def step(self, x: Array, P: Array, k: int) -> tuple[Array, Array, Array, Array]:
        """Return filtered state and covariance, predicted covariance and gain of sample k + 1."""
        Phi, H = self.Phi[k], self.H[k]
        x = Phi @ x
        P_predicted = Phi @ P @ Phi.mT + self.Q[k]
        PHt = P_predicted @ H.T
        S = H @ PHt + self.R[k]
        K = _gain(S, PHt)
        x = self.c[k] + x + K @ (self.y[k] - H @ x)
        P = P_predicted - K @ PHt.mT
        return x, 0.5 * (P + P.mT), P_predicted, K

    def of_one_set(self) -> _FilterMatrices:
        """Return the matrices of the first set, without the axis of the sets."""
        return self._replace(Phi=self.Phi[:, 0], Q=self.Q[:, 0], R=self.R[:, 0])


def _gain(S: Array, PHt: Array) -> Array:
    """Return P H^T S^-1; of one set of noises by LAPACK itself, as NumPy takes twice the time."""
    if S.ndim > 2:
        transposed: Any = np.linalg.solve(S, PHt.mT)
        return transposed.mT
    _, transposed, failed = lapack.dposv(S, PHt.T, lower=1)
    if failed:
        raise np.linalg.LinAlgError("An innovation covariance is not positive definite.")
    return transposed.T


class _Steps(NamedTuple):
    """Filtered steps k of a pass at s sets of noises."""

    innovations: Innovations  # of the past alone
    x: Array  # (k, s, N, 1) deviations from the expansion point
    P: Array  # (k, s, N, N)
    P_predicted: Array  # (k, s, N, N)
    gain: Array  # (k, s, N, m)


def filtered(linear: Linearization, noise: Noise) -> Pass:
    """Return the filter's pass at one set of noises."""
    steps = _filtered_steps(linear, noise, *_start(noise))
    states = linear.states.copy()
    states[1:] += steps.x[:, 0, :, 0]
    e, S = steps.innovations
    return Pass(
        innovations=Innovations(e[:, 0], S[:, 0]),
        states=states,
        covariance=np.concatenate([[np.diag(noise.start[0])], steps.P[:, 0]]),
        predicted_covariance=steps.P_predicted[:, 0],
        gain=steps.gain[:, 0],
    )


def innovations(linear: Linearization, noise: Noise) -> Innovations:
    """Return the innovations at all sets of noises."""
    values = []
    covariance = []
    x, P = _start(noise)
    for first in range(0, len(linear.time_step), STEPS_IN_MEMORY):
        steps = _filtered_steps(linear.part(first, first + STEPS_IN_MEMORY), noise, x, P)
        values.append(steps.innovations.values)
        covariance.append(steps.innovations.covariance)
        x, P = steps.x[-1], steps.P[-1]
    return Innovations(np.concatenate(values), np.concatenate(covariance))


def _start(noise: Noise) -> tuple[Array, Array]:
    """Return deviation and covariance of the first sample."""
    x = np.zeros((*noise.start.shape, 1))
    return x, noise.start[:, :, None] * np.eye(x.shape[1])


def _filtered_steps(linear: Linearization, noise: Noise, x: Array, P: Array) -> _Steps:
    """Return some steps of the filter, from deviation and covariance of the sample before."""
    matrices = _filter_matrices(linear, noise)
    R = matrices.R
    n, m, N = matrices.H.shape
    xs = np.empty((n + 1, *x.shape))
    Ps = np.empty((n + 1, *P.shape))
    P_predicted = np.empty((n, *P.shape))
    gain = np.empty((n, len(P), N, m))
    xs[0], Ps[0] = x, P
    sets: int | slice = slice(None)
    if len(P) == 1:  # NumPy takes longer for a stack of one matrix
        sets = 0
        matrices = matrices.of_one_set()
    for k in range(n):
        step = matrices.step(xs[k, sets], Ps[k, sets], k)
        xs[k + 1, sets], Ps[k + 1, sets], P_predicted[k, sets], gain[k, sets] = step
    past = _past_innovations(linear, noise, R, xs[:-1], Ps[:-1])
    return _Steps(past, xs[1:], Ps[1:], P_predicted, gain)


def _filter_matrices(linear: Linearization, noise: Noise) -> _FilterMatrices:
    """Return the matrices of the steps."""
    h = linear.time_step[:, None, None]
    Phi = np.repeat(linear.Phi[:, None], len(noise.density), axis=1)
    decaying = np.flatnonzero(noise.decay[0] > 0)
    Phi[:, :, decaying, decaying] = np.exp(-h * noise.decay[:, decaying])
    Q = _step_noise(np.eye(Phi.shape[-1]), Phi, noise.density * h)
    Q += noise.surface[:, None, None] * linear.surface_noise[:, None]
    sensor = noise.sensor + linear.missing[:, None]
    sensor = sensor + noise.surface[:, None] * linear.surface_reading_variance[:, None]
    shift = linear.predicted - linear.states[1:]
    return _FilterMatrices(
        Phi=Phi,
        Q=Q,
        c=shift[:, :, None],
        H=linear.H,
        R=sensor[..., None] * np.eye(sensor.shape[-1]) + linear.vibration,
        y=linear.path_error[:, :, None],
    )


def _past_innovations(
    linear: Linearization, noise: Noise, R: Array, x: Array, P: Array
) -> Innovations:
    """Return the errors of predictions from the filtered sample before, and their covariances.

    The noise of the step reaches the sensors through its end as well.
    """
    D = linear.D[:, None]
    L = linear.L[:, None]
    e = linear.past_error[:, None, :, None] - D @ x
    S = D @ P @ D.mT + R
    S += _step_noise(L, D, noise.density * linear.time_step[:, None, None])
    S += noise.surface[:, None, None] * (L @ linear.surface_noise[:, None] @ L.mT)
    return Innovations(e[..., 0], S)


def surface_covariance(linear: Linearization, noise: Noise) -> Array:
    """Return the part (n - 1, m, m) of the innovations' covariance that errors of the surfaces cause."""
    L = linear.L
    of_readings = linear.surface_reading_variance[..., None] * np.eye(L.shape[1])
    return noise.surface[0] * (L @ linear.surface_noise @ L.mT + of_readings)


def _step_noise(late: Array, early: Array, variance: Array) -> Array:
    """Return the covariance (..., k, k) that a step's white noise of ``variance`` (..., N) makes.

    The mean of G V G^T by Simpson's rule, for derivatives G (..., k, N) that change linearly from
    ``early`` to ``late`` in the step: (L V (2 L + E)^T + E V (2 E + L)^T) / 6.
    """
    V = variance[..., None, :]
    by_late = (late * V) @ (2 * late + early).mT
    by_early = (early * V) @ (2 * early + late).mT
    return (by_late + by_early) / 6


def parameter_slopes(
    linear: Linearization, filter_pass: Pass, slopes: Callable[[slice], Slopes]
) -> Iterator[tuple[slice, Array, Array]]:
    """Yield some steps, and the slopes of innovations (k, m, q) and of filtered states after the steps (k, N, q).

    By parameters and instruments at given gains; ``slopes`` are of the predictions.
    """
    end: Array | float = 0.0
    for first in range(0, len(linear.time_step), STEPS_IN_MEMORY):
        steps = slice(first, first + STEPS_IN_MEMORY)
        Theta, E, F = slopes(steps)
        gain = filter_pass.gain[steps]
        correction = np.eye(Theta.shape[1]) - gain @ linear.H[steps]  # I - K H
        T = correction @ linear.Phi[steps]
        Z = np.empty((len(T) + 1, *Theta.shape[1:]))
        Z[0] = end
        Z[1:] = correction @ Theta - gain @ F  # (I - K H) Theta - K F
        for k in range(len(T)):
            Z[k + 1] += T[k] @ Z[k]
        yield steps, -(linear.D[steps] @ Z[:-1] + E), Z[1:]
        end = Z[-1]


def smoothed(linear: Linearization, filter_pass: Pass) -> tuple[Matrix, Array]:
    """Return the states given all samples (n, N), and their covariances (Rauch, Tung & Striebel 1965)."""
    Phi = linear.Phi
    change = filter_pass.states - linear.states
    predicted = linear.predicted + matrix_vector(Phi, change[:-1])
    P_predicted = filter_pass.predicted_covariance
    PhiP = Phi @ filter_pass.covariance[:-1]
    C = np.linalg.solve(P_predicted, PhiP).mT  # gain of the smoother
    x = filter_pass.states.copy()
    P = filter_pass.covariance.copy()
    for k in reversed(range(len(C))):
        x[k] += C[k] @ (x[k + 1] - predicted[k])
        P[k] += C[k] @ (P[k + 1] - P_predicted[k]) @ C[k].T
    return x, P
