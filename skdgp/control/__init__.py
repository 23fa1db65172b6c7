"""Control: margins of an autopilot's loops around linear models, gains that have them, and flights in its simulator."""

from skdgp.control._ardupilot import Flown, FlySettings, fly, full_outputs
from skdgp.control._loops import Loop, autopilot_loops, read_parameters
from skdgp.control._margins import MarginSettings, margins, suggest_gains

__all__ = [
    "Flown",
    "FlySettings",
    "Loop",
    "MarginSettings",
    "autopilot_loops",
    "fly",
    "full_outputs",
    "margins",
    "read_parameters",
    "suggest_gains",
]
