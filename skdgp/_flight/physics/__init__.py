"""Checks of physics: laws that relate channels of every flight, and the flights that contradict them.

A law is a regression of one signal y on another, x, both computed from channels of a flight, with
the admissible slopes: 1 where kinematics make both equal, of one sign where aerodynamics give it, as
lift grows with alpha. Two channels are exchanged if each explains the response of the other better.

Equalities compare changes and integrals over windows, so that no noisy signal is differentiated. The checks
report: they never change a flight.

In the order of the computation: channels at one rate (``_signals.py``), y and x by the equations of
flight (``_equations.py``), the slope and its error (``_regression.py``), laws and their judgement
(``_laws.py``), the list of all (``_list.py``), and the channels that are probably wrong
(``_contradictions.py``). Sizes of the aircraft have laws of their own, numbers between limits
(``_sizes.py``).
"""

from skdgp._flight.physics._contradictions import confirmed_channels, find_contradictions
from skdgp._flight.physics._regression import Regression, estimated_slope
from skdgp._flight.physics._sizes import question_of_sizes, sizes_in_flight

__all__ = [
    "Regression",
    "confirmed_channels",
    "estimated_slope",
    "find_contradictions",
    "question_of_sizes",
    "sizes_in_flight",
]
