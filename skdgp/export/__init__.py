"""Models that leave Python: the portable model, its file, and the formats of other programs."""

from skdgp.export._build_up import BuildUp, Table, build_up, write_build_up
from skdgp.export._c import write_c
from skdgp.export._formats import CHOICES, FORMATS, export_model
from skdgp.export._graphs import casadi_function, onnx_model
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import (
    Block,
    LearnedRange,
    PortableFileError,
    PortableModel,
    Readout,
    Regressor,
    load_portable,
    save_portable,
)
from skdgp.export._pipeline import portable_model

__all__ = [
    "CHOICES",
    "FORMATS",
    "Block",
    "BuildUp",
    "LearnedRange",
    "PortableFileError",
    "PortableModel",
    "Readout",
    "Regressor",
    "Table",
    "build_up",
    "casadi_function",
    "export_model",
    "load_portable",
    "onnx_model",
    "portable_model",
    "save_portable",
    "write_build_up",
    "write_c",
    "write_jsbsim",
]
