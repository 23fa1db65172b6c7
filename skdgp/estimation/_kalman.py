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

Errors of the surfaces are :math:`\kappa` times their change within a step. They add to Q and R. Matrices of s sets
of noises have the set as the third of four axes, so that one product serves all.

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

# Whose slopes fit into the cache of a processor (guess). The sandwich of the scores is over these stretches, too:
# with 256 to 1024 steps its standard deviations differ by at most 13 % (means over derivatives, five flights)
STEPS_AT_A_TIME = 128


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
    added: Array  # (n - 1, m, m) covariance of the sensors by vibration; huge variance where not sampled

    def part(self, first: int, last: int) -> Linearization:
        """Return the steps ``first`` to ``last`` - 1, with the state after them."""
        whole = self._asdict()
        of_steps = {name: values[first:last] for name, values in whole.items()}
        return Linearization(**of_steps | {"states": self.states[first : last + 1]})

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


class Pass(NamedTuple):
    """One pass of the filter at one set of noises."""

    innovations: Matrix  # (n - 1, m) of the past alone
    innovation_covariance: Array  # (n - 1, m, m)
    states: Matrix  # (n, N)
    covariance: Array  # (n, N, N)
    predicted_covariance: Array  # (n - 1, N, N)
    gain: Array  # (n - 1, N, m)
    path_covariance: Array  # (n - 1, m, m) S, of the predictions with the recorded motion


def filtered(linear: Linearization, noise: Noise) -> Pass:
    """Return the filter's pass at one set of noises."""
    Phi = linear.Phi
    Q, R, R_past = (covariances[:, :, 0] for covariances in _covariances(linear, noise))
    R = R + linear.added
    n, m, N = linear.H.shape
    P = np.empty((n + 1, N, N))
    P_predicted = np.empty((n, N, N))
    K = np.empty((n, N, m))
    S = np.empty((n, m, m))
    P[0] = np.diag(noise.start[0])
    steps = zip(Phi, Q, linear.H, R, strict=True)
    for k, (Phi_k, Q_k, H_k, R_k) in enumerate(steps):
        predicted = Phi_k @ P[k] @ Phi_k.T + Q_k
        PHt = predicted @ H_k.T
        S_k = H_k @ PHt + R_k
        gain = _gain(S_k, PHt)
        corrected = predicted - gain @ PHt.T
        P[k + 1] = 0.5 * (corrected + corrected.T)
        P_predicted[k], S[k], K[k] = predicted, S_k, gain
    # deviations from the expansion point
    push = linear.predicted - linear.states[1:] + matrix_vector(K, linear.path_error)
    T = Phi - K @ (linear.H @ Phi)
    x = propagated(T, push[..., None])[..., 0]
    return Pass(
        innovations=linear.past_error - matrix_vector(linear.D, x[:-1]),
        innovation_covariance=linear.D @ P[:-1] @ linear.D.mT + R_past + linear.added,
        states=linear.states + x,
        covariance=P,
        predicted_covariance=P_predicted,
        gain=K,
        path_covariance=S,
    )


def _gain(S: Matrix, PHt: Matrix) -> Matrix:
    """Return P H^T S^-1, by LAPACK itself, as NumPy takes twice the time."""
    _, transposed, failed = lapack.dposv(S, PHt.T, lower=1)
    if failed:
        raise np.linalg.LinAlgError("An innovation covariance is not positive definite.")
    return transposed.T


def propagated(T: Array, push: Array, start: Any = 0.0) -> Array:
    """Return x (k + 1, N, q) of x_{k+1} = T_k x_k + push_k, from its start."""
    x = np.empty((len(T) + 1, *push.shape[1:]))
    x[0] = start
    x[1:] = push
    for k in range(len(T)):
        x[k + 1] += T[k] @ x[k]
    return x


def _covariances(linear: Linearization, noise: Noise) -> tuple[Array, Array, Array]:
    """Return Q (n - 1, N, s, N), R (n - 1, m, s, m), and R with the noise of the step before (n - 1, m, s, m).

    They are linear in the density, surface and sensor noise; other noises are not contained. The noise of a step
    reaches the sensors through its end as well.
    """
    density = noise.density * linear.time_step[:, None, None]
    L = linear.L
    surface = noise.surface[:, None]
    by_surfaces = surface * linear.surface_noise[:, :, None]
    Q = _step_noise(np.eye(L.shape[2])[None], linear.Phi, density) + by_surfaces
    variance = noise.sensor + surface * linear.surface_reading_variance[:, None]
    R = variance.mT[..., None] * np.eye(L.shape[1])[:, None]
    through_end = surface * (L @ linear.surface_noise @ L.mT)[:, :, None]
    return Q, R, R + _step_noise(L, linear.D, density) + through_end


def _step_noise(late: Array, early: Array, variance: Array) -> Array:
    """Return the covariances (n - 1, k, s, k) that a step's white noise of ``variance`` (n - 1, s, N) makes.

    The mean of G V G^T by Simpson's rule, for derivatives G (n - 1, k, N) that change linearly from
    ``early`` to ``late`` in the step: (L V (2 L + E)^T + E V (2 E + L)^T) / 6.
    """
    V = variance[:, None]
    by_late = _times(late[:, :, None] * V, (2 * late + early).mT)
    by_early = _times(early[:, :, None] * V, (2 * early + late).mT)
    return (by_late + by_early) / 6


def _times(values: Array, matrices: Array) -> Array:
    """Return the products (n, a, s, b) of s sets of matrices (n, a, s, N) and ones of all sets (n, N, b)."""
    n, a, s, N = values.shape
    return (values.reshape(n, a * s, N) @ matrices).reshape(n, a, s, -1)


def both_sides(A: Array, values: Array) -> Array:
    """Return A V A^T (n, a, s, a) of s sets of matrices V (n, N, s, N)."""
    n, N, s, _ = values.shape
    left = (A @ values.reshape(n, N, s * N)).reshape(n, -1, s, N)
    return _times(left, A.mT)


def _propagated_covariances(T: Array, push: Array, start: Array) -> Array:
    """Return P (n, N, s, N) with P[k + 1] = T[k] P[k] T[k]^T + push[k], s sets, from the ``start`` (N, s, N)."""
    N = len(start)
    P = np.concatenate([start[None], push])
    for k in range(len(T)):
        left = (T[k] @ P[k].reshape(N, -1)).reshape(-1, N)
        P[k + 1] += (left @ T[k].T).reshape(start.shape)
    return P


def noise_slopes(
    linear: Linearization, filter_pass: Pass, noise: Noise, change: Noise
) -> Iterator[tuple[slice, Array, Array]]:
    r"""Yield some steps, and slopes of the innovations (k, m, s) and of their covariances (k, m, s, m) by s numbers.

    The ``noise`` of the pass has the slopes ``change`` (s,). With :math:`A = I - K H`, :math:`T = A \Phi`, covariance
    and mean of the filtered states have the slopes (Gupta & Mehra 1974)

    .. math:: P'_{k+1} = T P'_k T^T + A V A^T + K R' K^T, \quad
              V = Q' + \Phi' P \Phi^T + \Phi P \Phi'^T, \\
              x'_{k+1} = T x'_k + A (\Phi' x_k + (\Phi P'_k \Phi^T + V) H^T u) - K R' u, \quad
              u = S^{-1} (y - H \Phi x_k),

    with :math:`Q'` at the given :math:`\Phi`, which neglects terms of the order of the step over the time of decay.
    """
    N, s = linear.Phi.shape[1], len(change.start)
    dP_start = change.start.T[..., None] * np.eye(N)[:, None]  # (N, s, N)
    dx_start = np.zeros((N, s))
    deviations = filter_pass.states - linear.states
    for first in range(0, len(linear.time_step), STEPS_AT_A_TIME):
        steps = slice(first, first + STEPS_AT_A_TIME)
        part = linear.part(first, first + STEPS_AT_A_TIME)
        Phi, H, K = part.Phi, part.H, filter_pass.gain[steps]
        x = deviations[:-1][steps]
        error = part.path_error - matrix_vector(H, matrix_vector(Phi, x))
        u: Any = np.linalg.solve(filter_pass.path_covariance[steps], error[..., None])
        Htu = H.mT @ u
        dQ, dR, dR_past = _covariances(part, change)
        dPhi = _transition_slopes(part.time_step[:, None, None], noise, change)
        turned = dPhi[..., None] * (filter_pass.covariance[:-1][steps] @ Phi.mT)[:, :, None]
        V = dQ + turned + turned.swapaxes(1, 3)
        A = np.eye(N) - K @ H
        T = A @ Phi
        dP = _propagated_covariances(T, both_sides(A, V) + both_sides(K, dR), dP_start)
        by_process = _times(V, Htu)[..., 0]
        by_sensors = K @ _times(dR, u)[..., 0]
        through_gain = Phi @ _times(dP[:-1], Phi.mT @ Htu)[..., 0] + by_process
        push = A @ (dPhi * x[..., None] + through_gain) - by_sensors
        dx = propagated(T, push, dx_start)
        yield steps, -(part.D @ dx[:-1]), both_sides(part.D, dP[:-1]) + dR_past
        dP_start, dx_start = dP[-1], dx[-1]


def _transition_slopes(h, noise, change):
    """Return the slopes of the diagonal of Phi over steps h (k, 1, 1), (k, N, s)."""
    return (-h * np.exp(-h * noise.decay) * change.decay).mT


def parameter_slopes(
    linear: Linearization, filter_pass: Pass, slopes: Callable[[slice], Slopes]
) -> Iterator[tuple[slice, Array, Array]]:
    """Yield some steps, and the slopes of innovations (k, m, q) and of filtered states after the steps (k, N, q).

    By parameters and instruments at given gains; ``slopes`` are of the predictions.
    """
    end: Array | float = 0.0
    for first in range(0, len(linear.time_step), STEPS_AT_A_TIME):
        steps = slice(first, first + STEPS_AT_A_TIME)
        Theta, E, F = slopes(steps)
        gain = filter_pass.gain[steps]
        A = np.eye(Theta.shape[1]) - gain @ linear.H[steps]  # I - K H
        Z = propagated(A @ linear.Phi[steps], A @ Theta - gain @ F, end)
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
