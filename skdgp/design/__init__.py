"""Design of flights: inputs that excite an aircraft, their sequences, and what they teach."""

from skdgp.design._envelope import Envelope
from skdgp.design._flown import FlownPlan
from skdgp.design._information import Information, coefficient_noise, expected_information, posterior_information
from skdgp.design._library import input_bands
from skdgp.design._multisines import Multisine, multisine, orthogonal_multisines
from skdgp.design._plan import Plan
from skdgp.design._planner import plan
from skdgp.design._signals import (
    Chirp,
    Limits,
    Signal,
    Steps,
    chirp,
    doublet,
    three_two_one_one,
)
from skdgp.design._wavetrain import Wavetrain, wavetrain
from skdgp.design._write import write_ardupilot_lua, write_csv, write_px4

__all__ = [
    "Chirp",
    "Envelope",
    "FlownPlan",
    "Information",
    "Limits",
    "Multisine",
    "Plan",
    "Signal",
    "Steps",
    "Wavetrain",
    "chirp",
    "coefficient_noise",
    "doublet",
    "expected_information",
    "input_bands",
    "multisine",
    "orthogonal_multisines",
    "plan",
    "posterior_information",
    "three_two_one_one",
    "wavetrain",
    "write_ardupilot_lua",
    "write_csv",
    "write_px4",
]
