"""Example data with known truth, simulated by `skdgp.dynamics`; nothing is downloaded."""

from skdgp.datasets._example_flights import load_example_flights

__all__ = ["load_example_flights"]
