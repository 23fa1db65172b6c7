"""Flight dynamics: the aircraft, its equations of motion, and its aerodynamic coefficients.

Body axes x forward, y right, z down; moments about the centre of gravity; SI units and radians.
The interface to a regressor is a flight table and a table of the six coefficients.
"""

from skdgp._flight.atmosphere import Atmosphere, standard_atmosphere, standard_density
from skdgp._flight.frames import (
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
from skdgp._mechanics.aerodynamics import Aerodynamics, as_aerodynamics
from skdgp._mechanics.air import Air, Turbulence, dryden_wind
from skdgp._mechanics.aircraft import Aircraft
from skdgp._mechanics.engines import Propeller, ThrustLine
from skdgp._mechanics.estimate import ScaleFactor
from skdgp._mechanics.loads import (
    aerodynamic_loads,
    external_loads,
    propeller_loads,
    propulsive_loads,
)
from skdgp._mechanics.rigid_body import STATE_NAMES, rigid_body_derivative, rk4, rk4_step
from skdgp.dynamics._derivatives import stability_derivatives
from skdgp.dynamics._inputs import FlightComputer
from skdgp.dynamics._inverse import aerodynamic_coefficients
from skdgp.dynamics._linearize import LinearModel, linearize
from skdgp.dynamics._replay import replay, replay_errors
from skdgp.dynamics._simulate import SimulationWarning, Simulator, simulate, trajectory_bands
from skdgp.dynamics._trim import Trim, trim

__all__ = [
    "STATE_NAMES",
    "Aerodynamics",
    "Air",
    "Aircraft",
    "Atmosphere",
    "FlightComputer",
    "LinearModel",
    "Propeller",
    "ScaleFactor",
    "SimulationWarning",
    "Simulator",
    "ThrustLine",
    "Trim",
    "Turbulence",
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
