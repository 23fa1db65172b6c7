"""Flight dynamics: the aircraft, its equations of motion, and its aerodynamic coefficients.

Body axes x forward, y right, z down; moments about the centre of gravity; SI units and radians.
The interface to a regressor is a flight table and a table of the six coefficients.

Names imported as themselves are not part of the public interface: other folders of the package use
them.
"""

from skdgp._flight.frames import air_data, quaternion_to_euler, standard_density
from skdgp._flight.frames import air_velocity as air_velocity
from skdgp._flight.frames import body_to_ned as body_to_ned
from skdgp._flight.frames import euler_to_matrix as euler_to_matrix
from skdgp._flight.frames import euler_to_quaternion as euler_to_quaternion
from skdgp._flight.frames import ned_to_body as ned_to_body
from skdgp._flight.frames import quaternion_to_matrix as quaternion_to_matrix
from skdgp.dynamics._aerodynamics import Aerodynamics, as_aerodynamics
from skdgp.dynamics._aerodynamics import Drift as Drift
from skdgp.dynamics._aerodynamics import Mixing as Mixing
from skdgp.dynamics._air import Air, Turbulence
from skdgp.dynamics._air import LocalAir as LocalAir
from skdgp.dynamics._air import gusty_air as gusty_air
from skdgp.dynamics._air import turbulence_of_flights as turbulence_of_flights
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._aircraft import check_aircraft as check_aircraft
from skdgp.dynamics._derivatives import stability_derivatives
from skdgp.dynamics._dryden import dryden_gusts as dryden_gusts
from skdgp.dynamics._dryden import gust_rate_lags as gust_rate_lags
from skdgp.dynamics._dryden import rolling_gust as rolling_gust
from skdgp.dynamics._integrate import REASONS as REASONS
from skdgp.dynamics._integrate import Trajectories as Trajectories
from skdgp.dynamics._integrate import channels as channels
from skdgp.dynamics._integrate import fly_record as fly_record
from skdgp.dynamics._inverse import aerodynamic_coefficients
from skdgp.dynamics._inverse import numbers_in_flight as numbers_in_flight
from skdgp.dynamics._linearize import LinearModel, linearize
from skdgp.dynamics._modes import LATERAL as LATERAL
from skdgp.dynamics._modes import LONGITUDINAL as LONGITUDINAL
from skdgp.dynamics._motion import Instant as Instant
from skdgp.dynamics._motion import Motion as Motion
from skdgp.dynamics._propeller import Propeller, ThrustLine
from skdgp.dynamics._rigid_body import ATTITUDE as ATTITUDE
from skdgp.dynamics._rigid_body import RATES as RATES
from skdgp.dynamics._rigid_body import STATE_NAMES
from skdgp.dynamics._rigid_body import VELOCITY as VELOCITY
from skdgp.dynamics._rigid_body import aerodynamic_loads as aerodynamic_loads
from skdgp.dynamics._rigid_body import dynamic_pressure as dynamic_pressure
from skdgp.dynamics._rigid_body import gyroscopic_moment as gyroscopic_moment
from skdgp.dynamics._rigid_body import propeller_loads as propeller_loads
from skdgp.dynamics._rigid_body import propeller_speed_of as propeller_speed_of
from skdgp.dynamics._rigid_body import propulsive_loads as propulsive_loads
from skdgp.dynamics._rigid_body import rigid_body_derivative as rigid_body_derivative
from skdgp.dynamics._rigid_body import rk4_step as rk4_step
from skdgp.dynamics._rigid_body import thrust_control as thrust_control
from skdgp.dynamics._servos import Servos
from skdgp.dynamics._servos import ramp_weights as ramp_weights
from skdgp.dynamics._simulate import Simulator, simulate
from skdgp.dynamics._sizes import KINDS as KINDS
from skdgp.dynamics._sizes import MOMENTS as MOMENTS
from skdgp.dynamics._sizes import QUANTITIES as QUANTITIES
from skdgp.dynamics._sizes import ScaleFactor
from skdgp.dynamics._trajectories import SimulationWarning, trajectory_bands
from skdgp.dynamics._trim import Trim, trim

__all__ = [
    "STATE_NAMES",
    "Aerodynamics",
    "Air",
    "Aircraft",
    "LinearModel",
    "Propeller",
    "ScaleFactor",
    "Servos",
    "SimulationWarning",
    "Simulator",
    "ThrustLine",
    "Trim",
    "Turbulence",
    "aerodynamic_coefficients",
    "air_data",
    "as_aerodynamics",
    "linearize",
    "quaternion_to_euler",
    "simulate",
    "stability_derivatives",
    "standard_density",
    "trajectory_bands",
    "trim",
]
