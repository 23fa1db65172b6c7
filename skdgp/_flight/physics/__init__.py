"""Checks of physics: relations between channels that hold in every flight, and the flights that contradict them.

A check is a regression of one signal y on another, x, both computed from channels of a flight:

- equality: kinematics make both equal, so the slope is 1;
- sign: aerodynamics give the sign of the slope, as lift grows with alpha;
- exchange: y is explained better by the channel of another axis than by its own.

Equalities compare changes and integrals over windows, so that no noisy signal is differentiated. The checks
report: they never change a flight.

In the order of the computation: channels at one rate (``_signals.py``), y and x by the equations of
flight (``_equations.py``), the slope and its error (``_regression.py``), the judgement of a slope
(``_checks.py``), the list of all checks (``_list.py``), and the channels that are probably wrong
(``_contradictions.py``). Sizes of the aircraft have laws of their own, numbers between limits
(``_sizes.py``).
"""

from skdgp._flight.physics._contradictions import find_contradictions
from skdgp._flight.physics._regression import Regression, estimated_slope
from skdgp._flight.physics._sizes import question_of_sizes, sizes_in_flight

__all__ = [
    "Regression",
    "estimated_slope",
    "find_contradictions",
    "question_of_sizes",
    "sizes_in_flight",
]
