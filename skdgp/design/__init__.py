"""Design of flights: inputs that excite an aircraft, and plans of manoeuvres with expected standard deviations."""

from skdgp._flight.excitation import (
    Multisine,
    Steps,
    Wavetrain,
    doublet,
    multisine,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)
from skdgp.design._envelope import Envelope
from skdgp.design._manoeuvres import RATE as RATE
from skdgp.design._planner import Plan, plan
from skdgp.design._script import ardupilot_script
from skdgp.design._script import surface_mixes as surface_mixes

__all__ = [
    "Envelope",
    "Multisine",
    "Plan",
    "Steps",
    "Wavetrain",
    "ardupilot_script",
    "doublet",
    "multisine",
    "orthogonal_multisines",
    "plan",
    "three_two_one_one",
    "wavetrain",
]
