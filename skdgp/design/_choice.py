"""Choice of manoeuvres by the information that they give about derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skdgp._compute.typing import Matrix, Vector


def information(X: Matrix) -> Matrix:
    """Return the Fisher information (1 + d, 1 + d) of rows X (n, d) for noise of unit variance.

    It concerns a constant and the slopes of a coefficient that is linear in the regressors. The
    noise of a coefficient is a factor of all its variances, so the information serves all six.
    """
    rows = np.column_stack([np.ones(len(X)), X])
    return rows.T @ rows


def variances(fisher: Matrix) -> Vector:
    """Return the variances (1 + d,) of constant and slopes by their information."""
    scale = np.sqrt(np.diag(fisher))
    inverse = np.linalg.inv(fisher / np.outer(scale, scale))
    return np.diag(inverse) / scale**2


# Rounding of sums of seconds
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Choice:
    """Greedy search for the sequence of manoeuvres with the largest gain in a given time.

    Exchanges of single manoeuvres afterwards, which are not made, would lower errors by 1 %.

    Parameters
    ----------
    informations : sequence of ndarray (1 + d, 1 + d)
        Of the manoeuvres to choose from.
    seconds : ndarray (n,)
        Time that each takes.
    known : ndarray (1 + d, 1 + d)
        Information before the flight.
    places : sequence of int
        Of the slopes of the goal.
    time : float
        Seconds to use.
    """

    informations: Sequence[Matrix]
    seconds: Vector
    known: Matrix
    places: Sequence[int]
    time: float

    def gain(self, chosen: Sequence[int]) -> float:
        """Return the mean of minus the logarithm of the errors of the goal; minus infinity beyond the time."""
        if self.seconds[[*chosen]].sum() > self.time + ROUNDING:
            return -np.inf
        fisher = self.known + sum(self.informations[k] for k in chosen)
        return float(-0.5 * np.mean(np.log(variances(fisher)[self.places])))

    def best(self) -> list[int]:
        """Return the places of the manoeuvres, each with the largest gain per second, until the time is used."""
        chosen: list[int] = []
        while True:
            gains = np.array([self.gain([*chosen, k]) for k in range(len(self.seconds))])
            rates = (gains - self.gain(chosen)) / self.seconds
            if np.isneginf(rates).all():
                return chosen
            chosen.append(int(np.argmax(rates)))
