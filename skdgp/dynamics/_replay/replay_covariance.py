"""The covariance of a replay: linear, along the flown path.

Errors: position and velocity NED, small body rotation t (R_true = R (1 + [t x])), rates w. With f the specific
force, R the rotation body to NED and e_f, e_m the errors of specific force and moment,

    position' = velocity,  velocity' = R (e_f - f x t),  t' = w - omega x t,
    I w' = (I omega) x w - omega x (I w) + e_m.

Coefficient errors are L z with L L^T their covariance at a sample and z six independent sequences of unit
variance, z_k+1 = c z_k + sqrt(1 - c^2) white, c = exp(-dt / correlation_time).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import cross_matrix, euler_per_rotation, euler_to_matrix
from skdgp.dynamics._vehicle.aircraft import Aircraft

__all__ = ["REPLAYED", "covariance_factor", "replayed_std"]

REPLAYED = ("north", "east", "down", "v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r")
P, V, T, W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


def replayed_std(
    flown: np.ndarray,
    steps: np.ndarray,
    specific_force: np.ndarray,
    load_factor: np.ndarray,
    aircraft: Aircraft,
    correlation_time: float,
    initial_std: Mapping[str, float],
) -> np.ndarray:
    """Return the standard deviations (n_windows, n_samples, 12) of the replayed states.

    Parameters
    ----------
    flown : ndarray of shape (n_windows, n_samples, 12)
        The replayed states, named in `REPLAYED`.
    steps : ndarray of shape (n_windows, n_samples - 1)
        Time steps [s]; 0 pads short windows.
    specific_force : ndarray of shape (n_windows, n_samples, 3)
        All force but gravity, over mass, body axes [m/s^2].
    load_factor : ndarray of shape (n_windows, n_samples, 6, 6)
        Force and moment errors [N, N m] per unit of z.
    aircraft : Aircraft
        Mass and inertia.
    correlation_time : float
        [s], 0 to infinity.
    initial_std : mapping of str to float
        Standard deviations of the first state, by name.
    """
    covariance = np.zeros((len(flown), 18, 18))
    covariance[:, :12, :12] = _initial_covariance(flown[:, 0], initial_std)
    covariance[:, 12:, 12:] = np.eye(6)
    std = np.empty(flown.shape)
    std[:, 0] = _state_std(covariance, flown[:, 0])
    rate, gain = _linearised(flown[:, 0], specific_force[:, 0], load_factor[:, 0], aircraft)
    for k in range(steps.shape[1]):
        old = rate, gain
        rate, gain = _linearised(flown[:, k + 1], specific_force[:, k + 1], load_factor[:, k + 1], aircraft)
        transition, noise = _transition(*old, rate, gain, steps[:, k, None, None], correlation_time)
        covariance = transition @ covariance @ transition.swapaxes(1, 2) + noise @ noise.swapaxes(1, 2)
        std[:, k + 1] = _state_std(covariance, flown[:, k + 1])
    return std


def covariance_factor(std: ArrayLike, n_samples: int) -> np.ndarray:
    """Return L (n, 6, 6) with L L^T the covariance of the coefficients, of std (n, 6) or covariance (n, 6, 6)."""
    values = np.asarray(std, dtype=float)
    if values.shape not in ((n_samples, 6), (n_samples, 6, 6)):
        raise ValueError(
            f"Got std of shape {values.shape}, but expected ({n_samples}, 6), standard deviations of "
            f"{', '.join(COEFFICIENTS)} at each sample, or ({n_samples}, 6, 6), their covariances."
        )
    if values.ndim == 2:
        if (values < 0).any():
            raise ValueError("Got negative values in std, but expected standard deviations >= 0.")
        return values[:, :, None] * np.eye(6)
    # A symmetric square root: continuous from sample to sample, and defined where a covariance is singular.
    good = np.isfinite(values).all(axis=(1, 2))
    factor = np.full_like(values, np.nan)
    eigenvalues, vectors = np.linalg.eigh(values[good])
    if (eigenvalues < -1e-8 * np.abs(eigenvalues).max(axis=1, initial=0.0, keepdims=True)).any():
        raise ValueError("Got covariances with negative eigenvalues in std, but expected positive semi-definite ones.")
    factor[good] = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None]) @ vectors.swapaxes(1, 2)
    return factor


def _linearised(states, specific_force, load_factor, aircraft) -> tuple[np.ndarray, np.ndarray]:
    """Return A (n, 12, 12) and G (n, 12, 6) of error' = A error + G z."""
    rotation, omega = euler_to_matrix(*states[:, T].T), states[:, W]
    rate, gain = np.zeros((len(states), 12, 12)), np.zeros((len(states), 12, 6))
    rate[:, P, V] = np.eye(3)
    rate[:, V, T] = -rotation @ cross_matrix(specific_force)
    rate[:, T, T] = -cross_matrix(omega)
    rate[:, T, W] = np.eye(3)
    inertia = aircraft.inertia
    rate[:, W, W] = aircraft.inertia_inverse @ (cross_matrix(omega @ inertia) - cross_matrix(omega) @ inertia)
    gain[:, V] = rotation @ load_factor[:, :3] / aircraft.mass
    gain[:, W] = aircraft.inertia_inverse @ load_factor[:, 3:]
    return rate, gain


def _transition(old_rate, old_gain, rate, gain, dt, correlation_time) -> tuple[np.ndarray, np.ndarray]:
    """Return the step matrices of (error, z): the mean's (n, 18, 18) and the white noise's (n, 18, 6)."""
    step = 0.5 * dt * (old_rate + rate)
    memory = np.exp(-dt / correlation_time) if correlation_time > 0 else np.zeros_like(dt)
    transition, noise = np.zeros((len(dt), 18, 18)), np.zeros((len(dt), 18, 6))
    transition[:, :12, :12] = np.eye(12) + step + 0.5 * step @ step
    transition[:, :12, 12:] = 0.5 * dt * (transition[:, :12, :12] @ old_gain + memory * gain)
    transition[:, 12:, 12:] = memory * np.eye(6)
    fresh = np.sqrt(1.0 - memory**2)
    noise[:, :12], noise[:, 12:] = 0.5 * dt * fresh * gain, fresh * np.eye(6)
    return transition, noise


def _initial_covariance(states, initial_std: Mapping[str, float]) -> np.ndarray:
    unknown = sorted(set(initial_std) - set(REPLAYED))
    if unknown:
        raise ValueError(f"Got initial_std of {unknown}, but expected names of {list(REPLAYED)}.")
    to_error = np.zeros((len(states), 12, 12)) + np.eye(12)
    to_error[:, T, T] = np.linalg.inv(euler_per_rotation(states[:, 6], states[:, 7]))
    scaled = to_error * np.array([float(initial_std.get(name, 0.0)) for name in REPLAYED])
    return scaled @ scaled.swapaxes(1, 2)


def _state_std(covariance, states) -> np.ndarray:
    variance = np.einsum("nii->ni", covariance)[:, :12].copy()
    to_euler = euler_per_rotation(states[:, 6], states[:, 7])
    variance[:, T] = np.einsum("nij,njk,nik->ni", to_euler, covariance[:, T, T], to_euler)
    return np.sqrt(np.maximum(variance, 0.0))  # rounding may carry a variance of nothing below zero
