"""Choice of manoeuvres by the information that they give about derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

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


@dataclass(frozen=True, eq=False)
class Choice:
    """Search for the sequence of manoeuvres with the largest gain in a given time.

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
    #: Least increase of the gain that justifies an exchange of manoeuvres
    worth_exchange: ClassVar[float] = 1e-6
    #: Rounding of sums of seconds
    rounding: ClassVar[float] = 1e-6

    def gain(self, chosen: Sequence[int]) -> float:
        """Return the mean of minus the logarithm of the errors of the goal; minus infinity beyond the time."""
        if self.seconds[[*chosen]].sum() > self.time + self.rounding:
            return -np.inf
        fisher = self.known + sum(self.informations[k] for k in chosen)
        return float(-0.5 * np.mean(np.log(variances(fisher)[self.places])))

    def filled(self, chosen: list[int]) -> list[int]:
        """Return manoeuvres, and more with the largest gain per second until the time is used."""
        gains = np.array([self.gain([*chosen, k]) for k in range(len(self.seconds))])
        rates = (gains - self.gain(chosen)) / self.seconds
        if np.isneginf(rates).all():
            return chosen
        return self.filled([*chosen, int(np.argmax(rates))])

    def exchanged(self, chosen: list[int]) -> list[int]:
        """Return the best sequence with one manoeuvre replaced by another."""
        best = chosen
        largest = self.gain(chosen) + self.worth_exchange
        for place in range(len(chosen)):
            for k in range(len(self.seconds)):
                sequence = [*chosen]
                sequence[place] = k
                gain = self.gain(sequence)
                if gain > largest:
                    best = sequence
                    largest = gain
        return best

    def best(self) -> list[int]:
        """Return the places of the manoeuvres: greedy, with exchanges while they help."""
        chosen = self.filled([])
        better = self.filled(self.exchanged(chosen))
        while better != chosen:
            chosen = better
            better = self.filled(self.exchanged(chosen))
        return chosen
