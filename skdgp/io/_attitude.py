"""Attitude as quaternions and as angles: what is averaged or interpolated must not jump."""

from __future__ import annotations

import numpy as np


def to_quaternions(angles: np.ndarray) -> np.ndarray:
    """Return quaternions (w, x, y, z), body to north-east-down, (n, 4), of phi, theta, psi [rad], (n, 3).

    Stevens, Lewis & Johnson (2016), Aircraft Control and Simulation, equation 1.8-18.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles.T / 2), np.sin(angles.T / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.column_stack([w, x, y, z])


def to_angles(quaternions: np.ndarray) -> np.ndarray:
    """Return phi, theta, psi [rad], (n, 3), of quaternions of any length; the same reference, equation 1.8-16."""
    w, x, y, z = quaternions.T
    size = w**2 + x**2 + y**2 + z**2
    size = np.where(size > 0, size, np.nan)
    phi = np.arctan2(2 * (w * x + y * z), size - 2 * (x**2 + y**2))
    theta = np.arcsin(np.clip(2 * (w * y - z * x) / size, -1.0, 1.0))
    psi = np.arctan2(2 * (w * z + x * y), size - 2 * (y**2 + z**2))
    angles = np.column_stack([phi, theta, psi])
    angles[np.isnan(size)] = np.nan
    return angles


def without_sign_changes(quaternions: np.ndarray) -> np.ndarray:
    """Return the same attitudes with signs such that neighbours are near each other; NaN rows stay."""
    known = np.isfinite(quaternions).all(axis=1)
    some = quaternions[known]
    turns = np.cumsum(np.r_[0, (some[1:] * some[:-1]).sum(axis=1) < 0])
    result = quaternions.copy()
    result[known] = some * np.where(turns % 2, -1.0, 1.0)[:, None]
    return result
