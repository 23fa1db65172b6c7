"""Rules: which fields of which messages a column comes from, in order of preference.

A rule with the same columns further down is taken where the topic above is absent, never valid, or slow (under 5 Hz).
PX4: https://docs.px4.io/main/en/msg_docs; ArduPilot: https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from skdgp._flight.atmosphere import SEA_LEVEL_DENSITY as DENSITY
from skdgp._flight.atmosphere import SEA_LEVEL_PRESSURE as PRESSURE
from skdgp._flight.frames import euler_to_quaternion

ATTITUDE = ("phi", "theta", "psi")
QUATERNION = ("qw", "qx", "qy", "qz")
"""Attitude between message and table: quaternions, body to north-east-down, of any length."""
EQUIVALENT = "equivalent_airspeed"
"""Airspeed that a pressure difference gives at sea level: sqrt(density / DENSITY) of the true one."""
DEGREE, RPM = np.pi / 180, np.pi / 30


class Rule(NamedTuple):
    """One way to some columns: ``convert`` maps fields (n, k) to columns (n, len(columns))."""

    columns: tuple[str, ...]
    topic: str
    fields: tuple[str, ...]
    convert: Callable[[np.ndarray], np.ndarray] = np.asarray
    valid: tuple[str, ...] = ()
    """Fields that, where the log has them, are positive where the others are valid."""
    note: str = ""


def times(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a conversion by a factor."""
    return lambda values: values * factor


def standard_density(pressure: np.ndarray) -> np.ndarray:
    """Return the density [kg/m^3] that belongs to a pressure [Pa] in the standard atmosphere below 11 km (ISO 2533).

    >>> round(float(standard_density(89874.6)), 4)
    1.1116
    """
    return DENSITY * np.maximum(pressure / PRESSURE, 0.0) ** (1 - 1 / 5.25588)


def standard_pressure(altitude: np.ndarray) -> np.ndarray:
    """Return the pressure [Pa] at an altitude [m] in the standard atmosphere below 11 km (ISO 2533)."""
    return PRESSURE * np.maximum(1 - 0.0065 * altitude / 288.15, 0.0) ** 5.25588


def _ground_course(values):
    """Return velocity north, east, down of ground speed, course [deg], velocity down."""
    speed, course, down = values.T
    return np.column_stack([speed * np.cos(course * DEGREE), speed * np.sin(course * DEGREE), down])


def _of_degrees(values):
    return euler_to_quaternion(*(values * DEGREE).T)


def _xyz(name):
    return tuple(f"{name}[{i}]" for i in range(3))


RATES, FORCES, AXES = ("p", "q", "r"), ("ax", "ay", "az"), ("x", "y", "z")
HORIZONTAL, DOWN, VELOCITY = ("v_north", "v_east"), ("v_down",), ("v_north", "v_east", "v_down")
WIND = ("wind_north", "wind_east")
MODELLED = "estimated on board, not measured by a vane"
STANDARD = "standard atmosphere at the measured pressure"

PX4 = (
    Rule(RATES, "vehicle_angular_velocity", _xyz("xyz")),
    Rule(RATES, "sensor_combined", _xyz("gyro_rad")),
    Rule(RATES, "vehicle_attitude", ("rollspeed", "pitchspeed", "yawspeed")),
    Rule(RATES, "sensor_gyro", AXES),
    Rule(FORCES, "vehicle_acceleration", _xyz("xyz")),
    Rule(FORCES, "sensor_combined", _xyz("accelerometer_m_s2")),
    Rule(FORCES, "sensor_accel", AXES),
    Rule(QUATERNION, "vehicle_attitude", tuple(f"q[{i}]" for i in range(4))),
    Rule(("airspeed",), "airspeed_validated", ("true_airspeed_m_s",), valid=("airspeed_sensor_measurement_valid",)),
    Rule(("airspeed",), "airspeed", ("true_airspeed_m_s",)),
    Rule(("alpha",), "airflow_aoa", ("aoa_rad",)),
    Rule(("beta",), "airflow_slip", ("slip_rad",)),
    Rule(HORIZONTAL, "vehicle_local_position", ("vx", "vy"), valid=("v_xy_valid",)),
    Rule(HORIZONTAL, "vehicle_global_position", ("vel_n", "vel_e")),
    Rule(HORIZONTAL, "vehicle_gps_position", ("vel_n_m_s", "vel_e_m_s"), valid=("vel_ned_valid",)),
    Rule(DOWN, "vehicle_local_position", ("vz",), valid=("v_z_valid",)),
    Rule(DOWN, "vehicle_global_position", ("vel_d",)),
    Rule(DOWN, "vehicle_gps_position", ("vel_d_m_s",), valid=("vel_ned_valid",)),
    Rule(("north", "east"), "vehicle_local_position", ("x", "y"), valid=("xy_valid",)),
    Rule(("down",), "vehicle_local_position", ("z",), valid=("z_valid",)),
    Rule(("altitude",), "vehicle_global_position", ("alt",)),
    Rule(("altitude",), "vehicle_air_data", ("baro_alt_meter",), note="of the barometer"),
    Rule(("altitude",), "vehicle_gps_position", ("altitude_msl_m",)),
    Rule(("altitude",), "vehicle_gps_position", ("alt",), times(1e-3)),
    Rule(("density",), "vehicle_air_data", ("rho",)),
    Rule(WIND, "wind", ("windspeed_north", "windspeed_east")),
    Rule(WIND, "wind_estimate", ("windspeed_north", "windspeed_east")),
    Rule(("throttle",), "actuator_controls_1", ("control[3]",), note="of a VTOL in forward flight"),
    Rule(("throttle",), "actuator_controls_0", ("control[3]",)),
    Rule(("throttle",), "vehicle_thrust_setpoint", ("xyz[0]",)),
    Rule(("throttle",), "actuator_motors", ("control[0]",)),
    Rule(("propeller_speed",), "rpm", ("rpm_estimate",), times(RPM)),
    Rule(("propeller_speed",), "rpm", ("indicated_frequency_rpm",), times(RPM)),
    Rule(("propeller_speed",), "esc_status", ("esc[0].esc_rpm",), times(RPM)),
)

ARDUPILOT = (
    Rule(RATES, "IMU", ("GyrX", "GyrY", "GyrZ")),
    Rule(FORCES, "IMU", ("AccX", "AccY", "AccZ")),
    Rule(QUATERNION, "ATT", ("Roll", "Pitch", "Yaw"), _of_degrees),
    Rule(QUATERNION, "AHR2", ("Roll", "Pitch", "Yaw"), _of_degrees),
    Rule((EQUIVALENT,), "ARSP", ("Airspeed",), valid=("H", "Health")),
    Rule(("alpha",), "AOA", ("AOA",), times(DEGREE), note=MODELLED),
    Rule(("beta",), "AOA", ("SSA",), times(DEGREE), note=MODELLED),
    Rule(VELOCITY, "XKF1", ("VN", "VE", "VD")),
    Rule(VELOCITY, "NKF1", ("VN", "VE", "VD")),
    Rule(VELOCITY, "GPS", ("Spd", "GCrs", "VZ"), _ground_course),
    Rule(("north", "east", "down"), "XKF1", ("PN", "PE", "PD")),
    Rule(("north", "east", "down"), "NKF1", ("PN", "PE", "PD")),
    Rule(("altitude",), "POS", ("Alt",)),
    Rule(("altitude",), "GPS", ("Alt",)),
    Rule(("density",), "BARO", ("Press",), standard_density, note=STANDARD),
    Rule(WIND, "XKF2", ("VWN", "VWE")),
    Rule(WIND, "NKF2", ("VWN", "VWE")),
    Rule(("throttle",), "CTUN", ("ThO",), times(0.01)),
    Rule(("throttle",), "CTUN", ("ThrOut",), times(0.01)),
    Rule(("throttle",), "AETR", ("Thr",), times(0.01)),
    Rule(("propeller_speed",), "RPM", ("rpm1",), times(RPM)),
    Rule(("propeller_speed",), "RPM", ("RPM",), times(RPM)),
    Rule(("propeller_speed",), "ESC", ("RPM",), times(RPM)),
)

RULES = {"PX4 ULog": PX4, "ArduPilot DataFlash": ARDUPILOT}
LANDED = {"PX4 ULog": ("vehicle_land_detected", "landed", 1.0), "ArduPilot DataFlash": ("STAT", "isFlying", 0.0)}
"""Topic and field that tell of being on the ground, and its value there."""
SLOWEST_AIRSPEED = {"PX4 ULog": ("FW_AIRSPD_MIN",), "ArduPilot DataFlash": ("AIRSPEED_MIN", "ARSPD_FBW_MIN")}
"""Parameters [m/s]."""
