"""Example data with known truth, simulated by `skdgp.dynamics`; nothing is downloaded.

Names imported as themselves are not part of the public interface: benchmarks use them.
"""

from skdgp.datasets._example_flights import COMMANDS as COMMANDS
from skdgp.datasets._example_flights import FLIGHT_PLANS as FLIGHT_PLANS
from skdgp.datasets._example_flights import load_example_flights
from skdgp.datasets._example_flights import measure as measure

__all__ = ["load_example_flights"]
