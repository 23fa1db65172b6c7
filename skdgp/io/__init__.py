"""Reading of flight logs into one flight table: standard column names, SI units, radians, one clock.

>>> from skdgp.io import read_flight, inspect_log
"""

from skdgp.io._autopilot import AUTOPILOTS, is_log
from skdgp.io._log import (
    EQUIVALENT,
    FULL_THROW,
    QUATERNION,
    Log,
    Rule,
    Servo,
    Topic,
    read_servos,
    reversed_of,
)
from skdgp.io._read import LogSummary, inspect_log, names_servos, read_flight
from skdgp.io._tables import FlightReadError

__all__ = [
    "AUTOPILOTS",
    "EQUIVALENT",
    "FULL_THROW",
    "QUATERNION",
    "FlightReadError",
    "Log",
    "LogSummary",
    "Rule",
    "Servo",
    "Topic",
    "inspect_log",
    "is_log",
    "names_servos",
    "read_flight",
    "read_servos",
    "reversed_of",
]
