"""Flight-table columns: units, axes and signs; non-dimensional rates.

Body axes: x forward, y right, z down, origin at the centre of gravity. SI units and radians
everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

VANES = ("alpha", "beta")
AIR_DATA = ("airspeed", *VANES)
POSITION = ("north", "east", "down")
# velocity over the ground
BODY_VELOCITY = ("u", "v", "w")
EARTH_VELOCITY = ("v_north", "v_east", "v_down")
# attitude, in the order of its rotations from the body outward
EULER = ("phi", "theta", "psi")
# roll and heading, which go round and jump by 2 pi
WRAPPED = ("phi", "psi")
RATES = ("p", "q", "r")
RATE_DERIVATIVES = ("p_dot", "q_dot", "r_dot")
SPECIFIC_FORCE = ("ax", "ay", "az")
# of the inertial sensors, from the centre of gravity
SENSOR_POSITION = ("sensor_position_x", "sensor_position_y", "sensor_position_z")
WIND = ("wind_north", "wind_east", "wind_down")
# elevons move as elevator and aileron at once
MIXED = ("elevator", "aileron")
ELEVONS = ("elevon_left", "elevon_right")
THRUST_FORCES = ("thrust_x", "thrust_y", "thrust_z")
# any of these gives the thrust: along the thrust line, or by its components
THRUST_COLUMNS = ("thrust", *THRUST_FORCES)
THRUST_MOMENTS = ("thrust_l", "thrust_m", "thrust_n")
SURFACES = (*MIXED, "rudder")
ALL_SURFACES = (*SURFACES, *ELEVONS)
HIGH_LIFT = ("flap", "spoiler")
# Column of flights whose surfaces are in parts of their full throw
FULL_THROW = "full_throw"
# Further controls, zero in normal flight
AUXILIARY = (*HIGH_LIFT, "differential_throttle")

# SI unit of each column of a flight table, and what it is
CHANNELS = {
    "time": "s",  # time on the log's one clock, increasing within a flight
    "flight": "",  # flight identifier
    # Air data: relative to the air, so the wind is inside them.
    "airspeed": "m/s",  # true airspeed V
    "alpha": "rad",  # angle of attack, > 0 nose above the relative wind
    "beta": "rad",  # sideslip, > 0 relative wind from the right
    "alpha_dot": "rad/s",  # rate of change of alpha
    "beta_dot": "rad/s",  # rate of change of beta
    "density": "kg/m^3",  # air density
    "altitude": "m",  # altitude above mean sea level
    "wind_north": "m/s",  # velocity of the air, north
    "wind_east": "m/s",  # velocity of the air, east
    "wind_down": "m/s",  # velocity of the air, down
    "gust": "m/s",  # how much the air changes in one second, standard deviation along one axis
    # Inertial quantities.
    "p": "rad/s",  # roll rate, > 0 right wing down
    "q": "rad/s",  # pitch rate, > 0 nose up
    "r": "rad/s",  # yaw rate, > 0 nose right
    "p_dot": "rad/s^2",  # roll acceleration
    "q_dot": "rad/s^2",  # pitch acceleration
    "r_dot": "rad/s^2",  # yaw acceleration
    "ax": "m/s^2",  # specific force at the inertial sensors, forward (what an accelerometer reads)
    "ay": "m/s^2",  # specific force at the inertial sensors, right
    "az": "m/s^2",  # specific force at the inertial sensors, down (about -9.8 in level flight)
    "sensor_position_x": "m",  # position of the inertial sensors from the CG, forward
    "sensor_position_y": "m",  # position of the inertial sensors from the CG, right
    "sensor_position_z": "m",  # position of the inertial sensors from the CG, down
    "sensor_tilt": "rad",  # roll and pitch of the inertial sensors against the attitude's axes, standard deviation
    "servo_delay_std": "s",  # error of the delay of surfaces behind their commands, beside a lag
    "u": "m/s",  # ground-relative velocity, forward
    "v": "m/s",  # ground-relative velocity, right
    "w": "m/s",  # ground-relative velocity, down (body axis)
    "phi": "rad",  # roll angle, > 0 right wing down
    "theta": "rad",  # pitch angle, > 0 nose up
    "psi": "rad",  # heading, > 0 clockwise from north
    "north": "m",  # position, north
    "east": "m",  # position, east
    "down": "m",  # position, down
    "v_north": "m/s",  # ground velocity, north
    "v_east": "m/s",  # ground velocity, east
    "v_down": "m/s",  # ground velocity, down
    # Controls and propulsion.
    "throttle": "",  # throttle, 0 to 1
    "differential_throttle": "",  # throttle of the left less the right engine, > 0 yaws right
    "propeller_speed": "rad/s",  # propeller speed Omega
    "elevator": "rad",  # elevator, > 0 pitches down
    "aileron": "rad",  # aileron, > 0 rolls right
    "rudder": "rad",  # rudder, > 0 yaws left
    "elevon_left": "rad",  # left elevon, > 0 trailing edge down
    "elevon_right": "rad",  # right elevon, > 0 trailing edge down
    "mass": "kg",  # mass of the aircraft, where it falls in flight
    "flap": "rad",  # flaps, > 0 trailing edge down
    "spoiler": "rad",  # spoilers, > 0 up
    "full_throw": "",  # 1: surfaces are in parts of their full throw, -1 to 1, in place of rad
    "thrust": "N",  # propulsive force along the thrust line
    "thrust_x": "N",  # propulsive force, forward
    "thrust_y": "N",  # propulsive force, right
    "thrust_z": "N",  # propulsive force, down
    "thrust_l": "N m",  # propulsive moment about the CG, roll
    "thrust_m": "N m",  # propulsive moment about the CG, pitch
    "thrust_n": "N m",  # propulsive moment about the CG, yaw
    # Aerodynamic coefficients, body axes.
    "CX": "",  # force coefficient, forward
    "CY": "",  # force coefficient, right
    "CZ": "",  # force coefficient, down
    "Cl": "",  # moment coefficient, roll (by span)
    "Cm": "",  # moment coefficient, pitch (by chord)
    "Cn": "",  # moment coefficient, yaw (by span)
}

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
LONGITUDINAL = ("CX", "CZ", "Cm")
LATERAL = ("CY", "Cl", "Cn")
# Coefficients and regressors whose sign changes in a mirror at the x-z plane
MIRRORED = frozenset(
    (
        *LATERAL,
        "beta",
        "beta_dot",
        "p",
        "r",
        "p_dot",
        "r_dot",
        "ay",
        "aileron",
        "rudder",
        "differential_throttle",
    )
)

# columns that end so are noise-free truth of a simulation: for scoring only
TRUTH_SUFFIX = "_true"

# ends the name of a non-dimensional rate
HAT = "_hat"
RATE_LENGTHS = {"p": "span", "q": "chord", "r": "span", "alpha_dot": "chord", "beta_dot": "span"}
ACCELERATION_LENGTHS = {"p_dot": "span", "q_dot": "chord", "r_dot": "span"}
LENGTHS = RATE_LENGTHS | ACCELERATION_LENGTHS
# Regressors by the names of :class:`skdgp.preprocessing.RegressorSelector`
REGRESSOR_SETS = {
    "quasi-steady": (*VANES, *RATES, *SURFACES, "throttle"),
    "classical": (*VANES, *RATES, "alpha_dot", "beta_dot", *SURFACES, "throttle"),
    # equation 22
    "paper": (
        *SPECIFIC_FORCE,
        *RATES,
        "p_dot",
        "q_dot",
        "r_dot",
        "alpha_dot",
        "beta_dot",
        "throttle",
        *SURFACES,
    ),
}
# the ``gust`` [m/s] that changes the regressors as much as sensor errors do in calm air
SENSOR_GUST = 0.1


def by_elevons(channels: Any) -> dict[str, Any]:
    """Return elevator and aileron of the two elevons of a table."""
    left, right = (channels[name] for name in ELEVONS)
    return {"elevator": (left + right) / 2, "aileron": (left - right) / 2}


def rate_factor(name: str, length: float, airspeed: np.ndarray) -> np.ndarray:
    """Return what makes a rate non-dimensional: L / 2V, of an angular acceleration (L / 2V)^2.

    The length L [m] is ``RATE_LENGTHS`` or ``ACCELERATION_LENGTHS`` of the aircraft, the airspeed V
    is in m/s.
    """
    factor = length / (2 * airspeed)
    return factor**2 if name in ACCELERATION_LENGTHS else factor
