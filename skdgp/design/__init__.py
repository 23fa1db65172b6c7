"""Design of flights: inputs that excite an aircraft, their sequences, what they teach, and what was flown of them."""

from skdgp._excitation import (
    Chirp,
    Limits,
    Multisine,
    Signal,
    Steps,
    Wavetrain,
    chirp,
    doublet,
    multisine,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)
from skdgp.design._card import write_flight_card
from skdgp.design._envelope import Envelope
from skdgp.design._flown import FlownPlan, flown_plan
from skdgp.design._information import (
    Information,
    coefficient_noise,
    expected_information,
    posterior_information,
)
from skdgp.design._library import input_bands
from skdgp.design._plan import Plan
from skdgp.design._planner import Known, Pilot, plan
from skdgp.design._write import (
    ardupilot_script,
    surface_mixes,
    write_ardupilot_lua,
    write_csv,
    write_px4,
)

__all__ = [
    "Chirp", "Envelope", "FlownPlan", "Information", "Known", "Limits", "Multisine", "Pilot", "Plan", "Signal", "Steps",
    "Wavetrain", "ardupilot_script", "chirp", "coefficient_noise", "doublet", "expected_information", "flown_plan",
    "input_bands", "multisine", "orthogonal_multisines", "plan", "posterior_information", "surface_mixes",
    "three_two_one_one", "wavetrain", "write_ardupilot_lua", "write_csv", "write_flight_card", "write_px4",
]  # fmt: skip
