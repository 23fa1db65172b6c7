"""The aircraft half: what is flown, how it moves, and what its flights say about its aerodynamics.

Body axes x forward, y right, z down; moments about the centre of gravity; SI units and radians.
The seam to the learning half is a table: flights in, the six coefficients out, and back.
"""

from skdgp.dynamics._aerodynamics import Aerodynamics, as_aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._atmosphere import Atmosphere, standard_atmosphere, standard_density
from skdgp.dynamics._derivatives import stability_derivatives
from skdgp.dynamics._frames import (
    air_data,
    air_velocity,
    body_to_ned,
    euler_to_matrix,
    euler_to_quaternion,
    gravity_in_body_axes,
    ned_to_body,
    quaternion_rate,
    quaternion_to_euler,
    quaternion_to_matrix,
)
from skdgp.dynamics._gusts import dryden_wind
from skdgp.dynamics._integrate import rk4, rk4_step
from skdgp.dynamics._inverse import aerodynamic_coefficients
from skdgp.dynamics._linearize import LinearModel, linearize
from skdgp.dynamics._loads import aerodynamic_loads, external_loads, propeller_loads, propulsive_loads
from skdgp.dynamics._propeller import Propeller
from skdgp.dynamics._replay import replay, replay_errors
from skdgp.dynamics._rigid_body import STATE_NAMES, rigid_body_derivative
from skdgp.dynamics._simulate import simulate
from skdgp.dynamics._simulator import Simulator
from skdgp.dynamics._thrust_line import ThrustLine
from skdgp.dynamics._thrust_table import ThrustTable
from skdgp.dynamics._trajectory import SimulationWarning, trajectory_bands
from skdgp.dynamics._trim import Trim, trim

__all__ = [
    "STATE_NAMES",
    "Aerodynamics",
    "Aircraft",
    "Atmosphere",
    "LinearModel",
    "Propeller",
    "SimulationWarning",
    "Simulator",
    "ThrustLine",
    "ThrustTable",
    "Trim",
    "aerodynamic_coefficients",
    "aerodynamic_loads",
    "air_data",
    "air_velocity",
    "as_aerodynamics",
    "body_to_ned",
    "dryden_wind",
    "euler_to_matrix",
    "euler_to_quaternion",
    "external_loads",
    "gravity_in_body_axes",
    "linearize",
    "ned_to_body",
    "propeller_loads",
    "propulsive_loads",
    "quaternion_rate",
    "quaternion_to_euler",
    "quaternion_to_matrix",
    "replay",
    "replay_errors",
    "rigid_body_derivative",
    "rk4",
    "rk4_step",
    "simulate",
    "stability_derivatives",
    "standard_atmosphere",
    "standard_density",
    "trajectory_bands",
    "trim",
]
