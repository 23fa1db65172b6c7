"""State estimation: path over the ground, wind and gusts, and lags of channels, of recorded flights.

The path is a sparse least-squares problem (`estimate_path`). Wind, gusts and derivatives of flights
without vanes follow by the filter-error method (`estimate_air_motion`). The transformers of
:mod:`skdgp.preprocessing` call both.
"""

from skdgp.estimation._air_fit import AirSettings
from skdgp.estimation._air_motion import AirMotion, estimate_air_motion
from skdgp.estimation._air_parameters import prior_deviations as prior_deviations
from skdgp.estimation._airspeed_scale import AirspeedScale, airspeed_scale
from skdgp.estimation._lags import Lag, estimate_lags
from skdgp.estimation._lags import removable as removable
from skdgp.estimation._path import CALIBRATED as CALIBRATED
from skdgp.estimation._path import RECONSTRUCTED as RECONSTRUCTED
from skdgp.estimation._path import PathEstimate, estimate_path
from skdgp.estimation._path import air_columns as air_columns
from skdgp.estimation._path import apparent_arm as apparent_arm
from skdgp.estimation._path import contradictions as contradictions
from skdgp.estimation._path import ground_paths as ground_paths
from skdgp.estimation._path import path_columns as path_columns
from skdgp.estimation._path_equations import FlightPath
from skdgp.estimation._sensors import AIR_SENSOR_ERRORS as AIR_SENSOR_ERRORS
from skdgp.estimation._sensors import GUSTS as GUSTS
from skdgp.estimation._sensors import KNOWN_ARM as KNOWN_ARM
from skdgp.estimation._sensors import PATH_CHANNELS as PATH_CHANNELS
from skdgp.estimation._sensors import PATH_NOISE as PATH_NOISE
from skdgp.estimation._sensors import FlightSensors, flights_of
from skdgp.estimation._sensors import NamedFlight as NamedFlight
from skdgp.estimation._sensors import missing_channels as missing_channels
from skdgp.estimation._servos import servo_output as servo_output
from skdgp.estimation._servos import without_lag as without_lag
from skdgp.estimation._vibration import vibration_covariance as vibration_covariance

__all__ = [
    "AirMotion",
    "AirSettings",
    "AirspeedScale",
    "FlightPath",
    "FlightSensors",
    "Lag",
    "PathEstimate",
    "airspeed_scale",
    "estimate_air_motion",
    "estimate_lags",
    "estimate_path",
    "flights_of",
]
