"""Control: loops of autopilots around linear models, their margins with probabilities, and gains that have them."""

from skdgp.control._loops import Loop, autopilot_loops, read_parameters
from skdgp.control._margins import MarginSettings, margins, suggest_gains

__all__ = [
    "Loop",
    "MarginSettings",
    "autopilot_loops",
    "margins",
    "read_parameters",
    "suggest_gains",
]
