"""Models in the formats of other tools."""

from skdgp.export._ardupilot import write_ardupilot, write_gazebo
from skdgp.export._build_up import BuildUp, Table, build_up
from skdgp.export._dave_ml import write_dave_ml
from skdgp.export._jsbsim import write_jsbsim

__all__ = ["BuildUp", "Table", "build_up", "write_ardupilot", "write_dave_ml", "write_gazebo", "write_jsbsim"]
