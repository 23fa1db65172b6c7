"""Models that leave Python: the portable model, its file, and the formats of other programs."""

from skdgp.export._casadi import casadi_function
from skdgp.export._formats import FORMATS as FORMATS
from skdgp.export._formats import export_model, save_portable
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import PortableModel
from skdgp.export._pipeline import portable_model

__all__ = [
    "PortableModel",
    "casadi_function",
    "export_model",
    "portable_model",
    "save_portable",
    "write_jsbsim",
]
