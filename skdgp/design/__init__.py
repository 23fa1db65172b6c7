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
from skdgp.design._card import write_flight_card
from skdgp.design._check import PlanCheck
from skdgp.design._envelope import Envelope
from skdgp.design._library import PlanSettings
from skdgp.design._planner import Plan, plan
from skdgp.design._script import ardupilot_script, surface_mixes

__all__ = [
    "Envelope",
    "Multisine",
    "Plan",
    "PlanCheck",
    "PlanSettings",
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
