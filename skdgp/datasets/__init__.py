"""Example data with known truth, made by this package's own dynamics; nothing is downloaded."""

from skdgp.datasets._example_flights import load_example_flights

__all__ = ["load_example_flights"]
