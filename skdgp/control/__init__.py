"""Control: margins of an autopilot's loops around linear models, gains that have them, and flights in its simulator."""

from skdgp.control._ardupilot import Flown, fly
from skdgp.control._ardupilot import full_outputs as full_outputs
from skdgp.control._loops import Loop
from skdgp.control._margins import margins, suggest_gains
from skdgp.control._parameters import autopilot_loops, read_parameters

__all__ = [
    "Flown",
    "Loop",
    "autopilot_loops",
    "fly",
    "margins",
    "read_parameters",
    "suggest_gains",
]
