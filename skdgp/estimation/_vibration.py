r"""Vibration of the inertial sensors: readings that all six share, and that are no motion.

A propeller or an engine shakes all accelerometers and gyros at one frequency. With phases
:math:`\delta_i` and sizes :math:`a_i`, an oscillation :math:`a_i \sin(\varphi(t) + \delta_i)` is in two
directions of the six readings, those of sine and cosine, whatever its frequency, and whatever the
sampling folds this to. The other four directions are free of it.

Both the third differences of the readings and the readings less those of the path over the ground show it,
fast vibration the former and slow vibration the latter. In units of usual noises their
covariance C has the eigenvalues :math:`\lambda_1 \le ... \le \lambda_6`. Readings vibrate where two are large,
:math:`\lambda_5 > \lambda_{min}`, and above the others, :math:`\lambda_5 > r \lambda_4`, and where two directions
make most of every channel. These are the
two common factors of the third differences (Lawley & Maxwell 1971), or eigenvectors of what the path shows.
With vanes, `skdgp._flight.smoothing` instead leaves out the frequencies of a vibration.
"""

from __future__ import annotations

import numpy as np
from sklearn.decomposition import FactorAnalysis

from skdgp._compute.linalg import constant_columns
from skdgp._compute.typing import Matrix, Vector
from skdgp.estimation._sensors import AIR_NOISE, third_differences

USUAL = np.array([AIR_NOISE[name][0] for name in ("ax", "ay", "az", "gyro", "gyro", "gyro")])
"""Usual noises of the inertial sensors (6,) [SI]."""
DIRECTIONS = 2
"""Directions of an oscillation."""


def vibration_covariance(readings: Matrix, off_path: Matrix, rate: float) -> Matrix:
    """Return the covariance (6, 6) of the vibration of readings (n, 6) [SI]; zero where they do not vibrate.

    It is as large as the readings in the directions of the vibration, which also contain motion: vibration
    is not white, and slow parts of it are larger than of white noise of its variance.

    Parameters
    ----------
    readings : ndarray (n, 6)
        Of accelerometers and gyros.
    off_path : ndarray (k, 6)
        The readings by the path over the ground less those of the sensors.
    rate : float
        Of the samples [Hz]; slow ones do not tell vibration from motion.
    """
    none = np.zeros((6, 6))
    # least rate of samples [Hz]: at slower ones third differences show motion too; of 12 flights without
    # vibration 3 were taken for it at 25 Hz, none at 50 Hz
    if rate < 40.0:
        return none
    scaled = readings / USUAL
    differences = third_differences(scaled)
    fast, _ = _principal(differences)
    slow, directions = _principal(off_path / USUAL)
    is_fast = fast[-2] >= slow[-2]
    fourth, fifth, _ = (fast if is_fast else slow)[-3:]
    # variance of vibration in its second direction, over the usual noise: 18 flights that vibrate have 13 and
    # more, in 18 others fast motion has up to 5
    # the same over the third direction: 2.7 and more; errors of the attitude are alike in three, 1.5 at most
    if fifth < max(10.0, 2.0 * fourth):
        return none
    if not _is_shared(differences if is_fast else off_path):
        return none
    if is_fast:
        # gusts shake az, and little else: one channel alone is no vibration
        B = FactorAnalysis(DIRECTIONS, svd_method="lapack").fit(differences).components_.T
    else:
        B = directions[:, -DIRECTIONS:] * np.sqrt(slow[-DIRECTIONS:] - fourth)
    plane, _ = np.linalg.qr(B)
    whole = np.var(scaled @ plane, axis=0).sum()
    return np.outer(USUAL, USUAL) * (B @ B.T) * whole / np.sum(B**2)


def _is_shared(values: Matrix) -> bool:
    """Return whether two directions make most of all channels of values (n, 6), none of which is constant."""
    if constant_columns(values).any():
        return False
    correlations = np.corrcoef(values.T)
    # sum of the two largest eigenvalues of their correlations, of 6: 4.1 and more where an oscillation is in all,
    # 2.1 of separate noises
    return bool(np.linalg.eigvalsh(correlations)[-DIRECTIONS:].sum() >= 3.5)


def _principal(values: Matrix) -> tuple[Vector, Matrix]:
    """Return eigenvalues of the covariance of values (n, 6), ascending, and eigenvectors."""
    eigenvalues, eigenvectors = np.linalg.eigh(np.cov(values.T))
    return eigenvalues, eigenvectors


def without_vibration(readings: Matrix, vibration: Matrix) -> Matrix:
    """Return readings (n, 6) [SI] without those in the directions of a vibration (6, 6)."""
    _, directions = np.linalg.eigh(vibration / np.outer(USUAL, USUAL))
    B = directions[:, -DIRECTIONS:]
    scaled = readings / USUAL
    return USUAL * (scaled - scaled @ B @ B.T)
