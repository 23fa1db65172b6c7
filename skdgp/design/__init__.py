"""Design of flights: inputs that excite an aircraft, plans of manoeuvres, and their promises."""

from skdgp._excitation import (
    Multisine,
    Steps,
    Wavetrain,
    doublet,
    multisine,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)
from skdgp.design._manoeuvres import Envelope
from skdgp.design._planner import Plan, PlanCheck, plan
from skdgp.design._write import ardupilot_script, surface_mixes, write_flight_card

__all__ = [
    "Envelope",
    "Multisine",
    "Plan",
    "PlanCheck",
    "Steps",
    "Wavetrain",
    "ardupilot_script",
    "doublet",
    "multisine",
    "orthogonal_multisines",
    "plan",
    "surface_mixes",
    "three_two_one_one",
    "wavetrain",
    "write_flight_card",
]
