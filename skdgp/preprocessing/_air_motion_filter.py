r"""The extended Kalman filter of the filter-error method, linearised along its own last pass.

All that is not linear is evaluated for all samples at once, at the filtered states of the pass
before; what remains for the loop over time is a linear filter. At the fixed point the two agree, and
the filter is the extended Kalman filter. Each sample is used twice: its innovation, for the
estimation, is the error of a prediction from earlier samples alone; the update of the state also
knows the recorded motion over the ground. A gust moves the aircraft within the step, so an
innovation that knows this motion would have part of the gust taken out of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Matrix, Vector

CHUNK = 256  # samples whose covariances of all noises are in memory at a time


class Linearisation(NamedTuple):
    """A record of n samples of m sensors, linear in N states and k parameters, about states X."""

    states: Matrix  # (n, N) X, filtered states of the last pass
    predicted: Matrix  # (n - 1, N) of samples 1 to n - 1, from X
    transition: Array  # (n - 1, N, N)
    transition_slopes: Array  # (n - 1, N, k)
    innovation: Matrix  # (n - 1, m) of the past alone, from X
    innovation_states: Array  # (n - 1, m, N) d prediction / d X of the sample before
    innovation_noise: Array  # (n - 1, m, N) d prediction / d state of the same sample
    innovation_slopes: Array  # (n - 1, m, k) d prediction / d parameters
    residual: Matrix  # (n - 1, m) with the recorded motion, from X
    residual_states: Array  # (n - 1, m, N) d prediction / d predicted state
    residual_slopes: Array  # (n - 1, m, k)
    step: Vector  # (n - 1,) [s]
    surface_noise: Array  # (n - 1, N, N) covariance per kappa^2
    weight: Matrix  # (n - 1, m) variance of a sensor in units of its own, huge where not sampled
    response: Matrix  # (n - 1, f) terms of the coefficients in the motion that surfaces cause


class Noise(NamedTuple):
    """Noises, with leading axes for sets of them."""

    rate: Array  # (..., N) of the process [units^2/s]
    decay: Array  # (..., N) 1 / correlation time of states, 0 where the transition has it
    surface: Array  # (...,) kappa^2
    sensor: Array  # (..., m) variances
    start: Array  # (..., N) variances of the first state


class Pass(NamedTuple):
    """One pass of the filter."""

    innovation: Array  # (..., n - 1, m)
    covariance: Array  # (..., n - 1, m, m)
    filtered: Array  # (..., n, N)
    filtered_covariance: Array  # (..., n, N, N)
    predicted_covariance: Array  # (..., n - 1, N, N)
    gain: Array  # (..., n - 1, N, m)


def filtered(linear: Linearisation, noise: Noise, keep: bool = True) -> Pass:
    """Return the filter's pass for noises, with their leading axes; ``keep``: its states and gains."""
    (n, N), m, sets = linear.states.shape, linear.innovation.shape[1], noise.rate.shape[:-1]
    innovation = np.empty((*sets, n - 1, m))
    covariance = np.empty((*sets, n - 1, m, m))
    kept = n if keep else CHUNK + 1
    states, P_kept = np.zeros((*sets, kept, N)), np.zeros((*sets, kept, N, N))
    predicted, gains = np.zeros((*sets, kept, N, N)), np.zeros((*sets, kept, N, m))
    delta = np.zeros((*sets, N, 1))
    P = noise.start[..., None] * np.eye(N)
    R0 = noise.sensor[..., None, :] * np.eye(m)
    eye = np.eye(N)
    for first in range(0, n - 1, CHUNK):
        last = min(first + CHUNK, n - 1)
        at = first if keep else 0
        part = slice(first, last)
        step = linear.step[part]
        decay = np.exp(-step[:, None] * noise.decay[..., None, :])
        Phi = np.where(
            (noise.decay > 0)[..., None, :, None] & (eye > 0),
            decay[..., None],
            linear.transition[..., part, :, :],
        )
        variance = noise.rate[..., None, :] * step[:, None]
        Q = _step_noise(eye, Phi, variance)
        Q += noise.surface[..., None, None, None] * linear.surface_noise[part]
        PhiT = np.swapaxes(Phi, -1, -2)
        H = linear.residual_states[..., part, :, :]
        HT = np.swapaxes(H, -1, -2)
        shift = (linear.predicted - linear.states[1:])[part, :, None]
        residual = linear.residual[part, :, None]
        states[..., at, :] = linear.states[first] + delta[..., 0]
        P_kept[..., at, :, :] = P
        deltas = np.empty((*sets, last - first, N, 1))
        for k in range(last - first):
            deltas[..., k, :, :] = delta
            moved = Phi[..., k, :, :] @ delta
            P = Phi[..., k, :, :] @ P @ PhiT[..., k, :, :] + Q[..., k, :, :]
            predicted[..., at + k, :, :] = P
            G = P @ HT[..., k, :, :]
            S = H[..., k, :, :] @ G + R0 * linear.weight[first + k]
            K = np.swapaxes(np.linalg.solve(S, np.swapaxes(G, -1, -2)), -1, -2)
            P = P - K @ np.swapaxes(G, -1, -2)
            P = 0.5 * (P + np.swapaxes(P, -1, -2))
            delta = shift[k] + moved + K @ (residual[k] - H[..., k, :, :] @ moved)
            P_kept[..., at + k + 1, :, :] = P
            gains[..., at + k, :, :] = K
        D, L = linear.innovation_states[part], linear.innovation_noise[part]
        innovation[..., part, :] = linear.innovation[part] - (D @ deltas)[..., 0]
        before = P_kept[..., at : at + last - first, :, :]
        covariance[..., part, :, :] = D @ before @ np.swapaxes(D, -1, -2)
        covariance[..., part, :, :] += _step_noise(L, D, variance)
        surface = L @ linear.surface_noise[part] @ np.swapaxes(L, -1, -2)
        covariance[..., part, :, :] += noise.surface[..., None, None, None] * surface
        covariance[..., part, :, :] += R0[..., None, :, :] * linear.weight[part, None]
        if keep:
            states[..., first:last, :] = linear.states[part] + deltas[..., 0]
    states[..., -1, :] = linear.states[-1] + delta[..., 0]
    return Pass(
        innovation, covariance, states, P_kept, predicted[..., :-1, :, :], gains[..., :-1, :, :]
    )


def _step_noise(late: Array, early: Array, variance: Array) -> Array:
    """Return the covariance (..., k, k) that a step's white noise of ``variance`` (..., N) makes.

    By Simpson's rule, from the derivatives (..., k, N) by noise ``late`` and ``early`` in the step.
    """
    half = 0.5 * (late + early)
    squares = [(G * variance[..., None, :]) @ np.swapaxes(G, -1, -2) for G in (late, half, early)]
    return (squares[0] + 4 * squares[1] + squares[2]) / 6


def innovation_slopes(linear: Linearisation, run: Pass) -> Array:
    """Return d innovation / d parameters (n - 1, m, k), the gains being given."""
    Z = state_slopes(linear, run)
    return -(linear.innovation_states @ Z[:-1] + linear.innovation_slopes)


def state_slopes(linear: Linearisation, run: Pass) -> Array:
    """Return d filtered states / d parameters (n, N, k), the gains of one set being given."""
    KH = np.eye(linear.states.shape[1]) - run.gain @ linear.residual_states
    T = KH @ linear.transition
    B = KH @ linear.transition_slopes - run.gain @ linear.residual_slopes
    Z = np.zeros((len(T) + 1, *B.shape[1:]))
    for k in range(len(T)):
        Z[k + 1] = T[k] @ Z[k] + B[k]
    return Z


def smoothed(linear: Linearisation, run: Pass) -> tuple[Matrix, Array]:
    """Return the states given all samples (n, N), and their covariances (Rauch, Tung & Striebel 1965)."""
    change, P = run.filtered - linear.states, run.filtered_covariance
    predicted = linear.predicted + (linear.transition @ change[:-1, :, None])[..., 0]
    C = P[:-1] @ np.swapaxes(linear.transition, -1, -2)
    C = np.swapaxes(np.linalg.solve(run.predicted_covariance, np.swapaxes(C, -1, -2)), -1, -2)
    states, covariance = run.filtered.copy(), P.copy()
    for k in range(len(C) - 1, -1, -1):
        states[k] += C[k] @ (states[k + 1] - predicted[k])
        covariance[k] += C[k] @ (covariance[k + 1] - run.predicted_covariance[k]) @ C[k].T
    return states, covariance
