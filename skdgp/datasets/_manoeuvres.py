"""Inputs of flight-test manoeuvres: functions of time that a pilot or an autopilot adds to the controls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["doublet", "multisine", "pulse", "three_two_one_one"]


def pulse(time: ArrayLike, start: float, width: float, amplitude: float) -> np.ndarray:
    """Return ``amplitude`` during ``width`` seconds from ``start`` on, else 0."""
    since = np.asarray(time, dtype=float) - start
    return amplitude * ((since >= 0) & (since < width))


def doublet(time: ArrayLike, start: float, width: float, amplitude: float) -> np.ndarray:
    """Return one pulse up and one down, each ``width`` seconds long."""
    return pulse(time, start, width, amplitude) - pulse(time, start + width, width, amplitude)


def three_two_one_one(time: ArrayLike, start: float, width: float, amplitude: float) -> np.ndarray:
    """Return the 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    Its spectrum is wide and holds little at zero frequency (Jategaonkar, Flight Vehicle System Identification,
    2nd edition, 2015, section 2.3).
    """
    signal, sign = 0.0, 1.0
    for units in (3, 2, 1, 1):
        signal = signal + pulse(time, start, units * width, sign * amplitude)
        start, sign = start + units * width, -sign
    return signal


def multisine(time: ArrayLike, start: float, stop: float, harmonics: ArrayLike, rms: float) -> np.ndarray:
    """Return a sum of sines of equal power with Schroeder phases between ``start`` and ``stop``, else 0.

    Harmonics k of the frequency 1 / (stop - start), phases -pi i (i - 1) / n for the i-th of n, which keep the
    peaks low. Disjoint harmonics on several controls make their inputs orthogonal, so all are flown at once
    (Morelli, AIAA 2003-5700).

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0.0, 20.0, 2000, endpoint=False)
    >>> aileron, rudder = (multisine(time, 0.0, 20.0, np.arange(k, 40, 2), rms=0.05) for k in (2, 3))
    >>> float(aileron.std().round(3)), bool(abs(aileron @ rudder) < 1e-9)
    (0.05, True)
    """
    harmonics = np.asarray(harmonics, dtype=float)
    order = np.arange(1, len(harmonics) + 1)
    since = (np.asarray(time, dtype=float) - start) / (stop - start)
    phases = -np.pi * order * (order - 1) / len(order)
    waves = np.sin(2.0 * np.pi * since[:, None] * harmonics + phases)
    return rms * np.sqrt(2.0 / len(order)) * waves.sum(axis=1) * ((since >= 0) & (since < 1))
