"""State estimation: path over the ground, wind and gusts, and lags of channels, of recorded flights.

The path is a sparse least-squares problem (`estimate_path`). Wind, gusts and derivatives of flights
without vanes follow by the filter-error method (`estimate_air_motion`). The transformers of
:mod:`skdgp.preprocessing` call both.
"""

from skdgp.estimation._air_motion import AirMotion, estimate_air_motion
from skdgp.estimation._air_parameters import prior_deviations
from skdgp.estimation._airspeed_scale import AirspeedScale, airspeed_scale
from skdgp.estimation._airspeed_scale import without_airspeed_error as without_airspeed_error
from skdgp.estimation._lags import Lag, estimate_lags, removable
from skdgp.estimation._path import (
    CALIBRATED,
    PathEstimate,
    SensorContradiction,
    contradictions,
    estimate_path,
    overlapping_parts,
)
from skdgp.estimation._path_equations import FlightPath
from skdgp.estimation._reconstruction import RECONSTRUCTED, air_columns, path_columns
from skdgp.estimation._sensors import AIR_SENSOR_ERRORS as AIR_SENSOR_ERRORS
from skdgp.estimation._sensors import (
    GUSTS,
    PATH_CHANNELS,
    PATH_NOISE,
    FlightSensors,
    NamedFlight,
    flights_of,
    missing_channels,
)
from skdgp.estimation._sensors import KNOWN_ARM as KNOWN_ARM
from skdgp.estimation._servos import delayed_surfaces
from skdgp.estimation._settings import AirSettings, LagSettings, PathSettings
from skdgp.estimation._shift import without_lag
from skdgp.estimation._vibration import vibration_covariance as vibration_covariance

__all__ = [
    "CALIBRATED",
    "GUSTS",
    "PATH_CHANNELS",
    "PATH_NOISE",
    "RECONSTRUCTED",
    "AirMotion",
    "AirSettings",
    "AirspeedScale",
    "FlightPath",
    "FlightSensors",
    "Lag",
    "LagSettings",
    "NamedFlight",
    "PathEstimate",
    "PathSettings",
    "SensorContradiction",
    "air_columns",
    "airspeed_scale",
    "contradictions",
    "delayed_surfaces",
    "estimate_air_motion",
    "estimate_lags",
    "estimate_path",
    "flights_of",
    "missing_channels",
    "overlapping_parts",
    "path_columns",
    "prior_deviations",
    "removable",
    "without_lag",
]
