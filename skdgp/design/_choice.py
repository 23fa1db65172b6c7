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
        """Return the mean of minus the logarithm of the errors of the goal."""
        fisher = self.known.copy()
        for k in chosen:
            fisher += self.informations[k]
        scale = np.sqrt(np.diag(fisher))
        inverse = np.linalg.inv(fisher / np.outer(scale, scale))
        variances = np.diag(inverse) / scale**2
        return float(-0.5 * np.mean(np.log(variances[self.places])))

    def fits(self, chosen: Sequence[int]) -> bool:
        """Return whether a sequence fits into the time."""
        return bool(self.seconds[list(chosen)].sum() <= self.time + self.rounding)

    def filled(self, chosen: list[int]) -> list[int]:
        """Return manoeuvres, and more with the largest gain per second until the time is used."""
        n = len(self.seconds)
        while True:
            longer = [[*chosen, k] for k in range(n) if self.fits([*chosen, k])]
            if not longer:
                return chosen
            before = self.gain(chosen)
            rates = [
                (self.gain(sequence) - before) / self.seconds[sequence[-1]] for sequence in longer
            ]
            chosen = longer[int(np.argmax(rates))]

    def exchanged(self, chosen: list[int]) -> list[int]:
        """Return the best sequence with one manoeuvre replaced by another."""
        best = chosen
        largest = self.gain(chosen) + self.worth_exchange
        for place in range(len(chosen)):
            for k in range(len(self.seconds)):
                exchanged = [*chosen[:place], k, *chosen[place + 1 :]]
                if self.fits(exchanged) and self.gain(exchanged) > largest:
                    best = exchanged
                    largest = self.gain(exchanged)
        return best

    def best(self) -> list[int]:
        """Return the places of the manoeuvres: greedy, with exchanges while they help."""
        chosen = self.filled([])
        while True:
            better = self.filled(self.exchanged(chosen))
            if better == chosen:
                return chosen
            chosen = better
