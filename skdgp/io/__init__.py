"""Reading of flight logs into one flight table: standard column names, SI units, radians, one clock.

Names imported as themselves are not part of the public interface: other rooms use them.

>>> from skdgp.io import read_flight, inspect_log
"""

from skdgp.io._autopilot import AUTOPILOTS
from skdgp.io._autopilot import is_log as is_log
from skdgp.io._log import FULL_THROW as FULL_THROW
from skdgp.io._log import Log, Rule, Topic
from skdgp.io._log import read_servos as read_servos
from skdgp.io._read import LogSummary, inspect_log, read_flight
from skdgp.io._tables import FlightReadError

__all__ = [
    "AUTOPILOTS",
    "FlightReadError",
    "Log",
    "LogSummary",
    "Rule",
    "Topic",
    "inspect_log",
    "read_flight",
]
