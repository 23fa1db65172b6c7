"""Flight-path reconstruction."""

from skdgp.preprocessing._reconstruction.reconstruction import FlightPathReconstruction

__all__ = ["FlightPathReconstruction"]
