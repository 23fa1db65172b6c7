"""Flight logs into one table in the words of the vocabulary: SI, radians, one clock.

>>> from skdgp.io import read_flight, read_flights, FlightReadError
"""

from skdgp.io._errors import FlightReadError
from skdgp.io._read import read_flight, read_flights

__all__ = ["FlightReadError", "read_flight", "read_flights"]
