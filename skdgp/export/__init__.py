"""Models that leave Python: the portable model, its file, and the formats of other programs."""

from skdgp.export._model import Block, Envelope, PortableModel, Readout, Regressor
from skdgp.export._pipeline import portable_model

__all__ = ["Block", "Envelope", "PortableModel", "Readout", "Regressor", "portable_model"]
