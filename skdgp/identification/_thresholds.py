"""Limits of the judgements of a model."""

from __future__ import annotations

from typing import NamedTuple


class Thresholds(NamedTuple):
    """What counts as good enough (docs/judging.md, with the sources)."""

    # Largest error over the spread of the coefficients: Theil's coefficient is then 0.27, and 0.25
    # to 0.3 count as good agreement (Jategaonkar 2006, chapter 11).
    error: float = 0.5
    coverage: float = 0.90  # smallest share of measured values in a 95 % band (guess)
    # Smallest share of measured values in a 95 % band of each coefficient for a controller: bands of
    # derivatives are of the same model (guess)
    held: float = 0.80
    widest: float = 0.99  # larger share, which marks bands as too wide (guess)
    # Largest half-width of a 95 % band over its value: a gain margin of 6 dB (MIL-F-9490D) bears
    # half the gain.
    band: float = 0.5
    seconds: float = 1.0  # shortest simulation that is of use [s] (guess)
    # Least seconds and rows for each regressor to learn from: below, the uses are unknown (guesses)
    flown: float = 30.0
    rows: float = 10.0
    tie: float = 0.02  # errors that differ by less than this share are equal (guess)


THRESHOLDS = Thresholds()
