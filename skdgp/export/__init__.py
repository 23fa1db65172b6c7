"""Models that leave Python: the portable model, its file, and the formats of other programs; an environment."""

from skdgp.export._ardupilot import write_ardupilot, write_gazebo
from skdgp.export._build_up import BuildUp, Table, build_up, write_build_up
from skdgp.export._c import write_c
from skdgp.export._dave_ml import write_dave_ml
from skdgp.export._fmu import write_fmu
from skdgp.export._formats import FORMATS, export_model
from skdgp.export._graphs import casadi_function, onnx_model
from skdgp.export._gymnasium import gymnasium_env
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
    "gymnasium_env",
    "load_portable",
    "onnx_model",
    "portable_model",
    "save_portable",
    "write_ardupilot",
    "write_build_up",
    "write_c",
    "write_dave_ml",
    "write_fmu",
    "write_gazebo",
    "write_jsbsim",
]
