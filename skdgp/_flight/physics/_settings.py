"""Settings of the checks of physics, each number with its unit and source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PhysicsSettings:
    """Settings of the checks of physics."""

    # rows are averaged to about this rate [Hz], above the frequencies of flight dynamics
    rate: float = 20.0
    # window of kinematics [s], longer than the usual lags
    kinematic_window: float = 1.0
    # window of forces and moments [s], shorter than the time constant of roll
    response_window: float = 0.1
    # larger angles [rad] are in degrees
    largest_radians: float = 2.1 * np.pi
    # flights shorter than this [s] are judged together with others only
    long_flight: float = 30.0

    # fewer rows, or fewer effective samples, decide nothing
    least_rows: int = 40
    least_samples: float = 10.0
    # least distance of a slope from its admissible interval, in standard deviations
    least_t: float = 5.0

    # largest mean of the unit vectors ahead in flights that turn: one heading has 1, a circle 0 (guess)
    most_ahead: float = 0.8

    # equalities: least t of the reverse slope, which tells noise of x from a wrong scale, and its
    # largest standard deviation that tells anything (guesses)
    reverse_t: float = 1.5
    reverse_std: float = 0.5
    # a longer lag [s] is a contradiction: LagCorrector corrects 0.3 s, holds of slow GPS add to it
    usual_lag: float = 0.5
    # the same of the airspeed [s], and its least t: gusts reach it before the aircraft follows, which
    # makes lags up to 1.0 s (25 simulated flights); beyond, none had a t above zero, and 2 s had 3.7
    # to 10
    usual_airspeed_lag: float = 1.0
    least_airspeed_t: float = 4.0
    # the same of vanes against the motion: gusts lead it (54 simulated flights)
    usual_vane_lag: float = 0.15
    least_vane_t: float = 10.0
    # contradictions from which on a mistake of several channels at once is looked for
    several: int = 3
    # least correlation at a lag that is a contradiction, whatever the slope (guess)
    lagged_correlation: float = 0.5

    # signs and exchanges: least partial correlation; feedback, lags and gusts cause weaker ones
    least_correlation: float = 0.3
    # a lag is possible if the ratio of explained to unexplained variance is this fraction of the best
    possible_lag: float = 1 / 3
    # the same of lags from zero where the angle that a surface turns the aircraft to was not measured
    possible_lag_without_angle: float = 1 / 8


PHYSICS = PhysicsSettings()
# Lags that are tried [s], positive where y is late against x
KINEMATIC_LAGS = (0.0, -1.0, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 1.0)
# further ones of the airspeed, which gusts reach before the aircraft follows
AIRSPEED_LAGS = (-1.4, 1.4, -1.8, 1.8, -2.2, 2.2, -2.6, 2.6, -3.0, 3.0)
VANE_LAGS = (0.0, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
# of surfaces, whose servos are late
SURFACE_LAGS = (0.0, -0.1, -0.05, 0.05, 0.1, 0.15, -0.2, -0.3)
