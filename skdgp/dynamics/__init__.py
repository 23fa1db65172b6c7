"""Flight dynamics: the aircraft, its equations of motion, and its aerodynamic coefficients.

Body axes x forward, y right, z down; moments about the centre of gravity; SI units and radians.
The interface to a regressor is a flight table and a table of the six coefficients.
"""

from skdgp._flight.frames import (
    air_data,
    air_velocity,
    body_to_ned,
    euler_to_matrix,
    euler_to_quaternion,
    gravity_in_body_axes,
    ned_to_body,
    quaternion_to_euler,
    quaternion_to_matrix,
    standard_density,
)
from skdgp.dynamics._aerodynamics import Aerodynamics, as_aerodynamics, scaling_of
from skdgp.dynamics._air import Air, GustyAir, LocalAir
from skdgp.dynamics._aircraft import Aircraft, check_aircraft
from skdgp.dynamics._derivatives import stability_derivatives
from skdgp.dynamics._dryden import dryden_gusts
from skdgp.dynamics._estimated_sizes import KINDS, QUANTITIES
from skdgp.dynamics._inputs import Clock, FlightComputer
from skdgp.dynamics._integrate import REASONS, Record, channels, fly_record
from skdgp.dynamics._inverse import aerodynamic_coefficients
from skdgp.dynamics._linearize import LinearModel, linearize
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._propeller import Propeller, ThrustLine
from skdgp.dynamics._replay import replay
from skdgp.dynamics._rigid_body import (
    STATE_NAMES,
    aerodynamic_loads,
    dynamic_pressure,
    external_loads,
    propeller_loads,
    propeller_speed_of,
    propulsive_loads,
    rigid_body_derivative,
    rk4,
    rk4_step,
)
from skdgp.dynamics._simulate import Simulator, simulate
from skdgp.dynamics._size_errors import MOMENTS, PRESSURE, ScaleFactor, relative_errors
from skdgp.dynamics._starts import UncertainStart
from skdgp.dynamics._trajectories import SimulationWarning, trajectory_bands
from skdgp.dynamics._trim import Trim, trim
from skdgp.dynamics._turbulence import Turbulence, dryden_wind

__all__ = [
    "KINDS",
    "MOMENTS",
    "PRESSURE",
    "QUANTITIES",
    "REASONS",
    "STATE_NAMES",
    "Aerodynamics",
    "Air",
    "Aircraft",
    "Clock",
    "FlightComputer",
    "GustyAir",
    "Instant",
    "LinearModel",
    "LocalAir",
    "Motion",
    "Propeller",
    "Record",
    "ScaleFactor",
    "SimulationWarning",
    "Simulator",
    "ThrustLine",
    "Trim",
    "Turbulence",
    "UncertainStart",
    "aerodynamic_coefficients",
    "aerodynamic_loads",
    "air_data",
    "air_velocity",
    "as_aerodynamics",
    "body_to_ned",
    "channels",
    "check_aircraft",
    "dryden_gusts",
    "dryden_wind",
    "dynamic_pressure",
    "euler_to_matrix",
    "euler_to_quaternion",
    "external_loads",
    "fly_record",
    "gravity_in_body_axes",
    "linearize",
    "ned_to_body",
    "propeller_loads",
    "propeller_speed_of",
    "propulsive_loads",
    "quaternion_to_euler",
    "quaternion_to_matrix",
    "relative_errors",
    "replay",
    "rigid_body_derivative",
    "rk4",
    "rk4_step",
    "scaling_of",
    "simulate",
    "stability_derivatives",
    "standard_density",
    "trajectory_bands",
    "trim",
]
