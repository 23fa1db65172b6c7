"""Sensors whose readings contradict the path of all sensors together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from skdgp.estimation._sensors import PATH_NOISE, READINGS_OF, FlightSensors, noise_by_differences
from skdgp.estimation._settings import PATH_SETTINGS, PathSettings


class SensorContradiction(NamedTuple):
    """A sensor whose residuals along the path exceed its white noise, standard deviations [SI]."""

    sensor: str
    residual: float
    noise: float
    # whether the readings show less noise than any sensor, so that the residual tells nothing of it
    is_smoothed: bool = False


INERTIAL = ("gyro", "accelerometer")


def contradictions(
    flights: Sequence[FlightSensors],
    residuals: Mapping[str, float],
    settings: PathSettings = PATH_SETTINGS,
) -> list[SensorContradiction]:
    """Return the sensors whose residuals along the path exceed their white noise by a ratio.

    The ratio is ``air_ratio`` or ``inertial_ratio`` of the settings. ``residuals`` are the noises
    of `PathEstimate.noise` [SI]; white noise is estimated from third differences of the readings.
    A sensor that shows hardly any was smoothed, so its noise is not known.
    """
    contradicted = []
    for sensor, columns in READINGS_OF.items():
        largest = settings.inertial_ratio if sensor in INERTIAL else settings.air_ratio
        residual = residuals[sensor]
        noise = noise_by_differences(flights, columns)
        is_smoothed = noise < settings.least_noise * PATH_NOISE[sensor]
        if residual > largest * noise:
            contradicted.append(SensorContradiction(sensor, residual, noise, is_smoothed))
    return contradicted
