"""Rate and attitude loops of PX4 and ArduPilot Plane: their laws.

The laws are those of PX4's ``FixedwingRateControl::Run`` and ``RateControl::update``, and of
ArduPilot's ``AP_FW_Controller::_get_rate_out``, ``AC_PID::update_all`` and
``AP_YawController::get_servo_out``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.frames import SEA_LEVEL_DENSITY, STANDARD_GRAVITY

# Rate, attitude and control of each loop
LOOP_AXES = {
    "roll": ("p", "phi", "aileron"),
    "pitch": ("q", "theta", "elevator"),
    "yaw": ("r", "", "rudder"),
}

# Gains of a loop, by the names that parameters end with
GAINS = ("P", "I", "D", "FF", "D_FF")
FEEDBACK = ("P", "I", "D")


class Notch(NamedTuple):
    r"""A notch filter, :math:`(s^2 + d \omega s / Q + \omega^2) / (s^2 + \omega s / Q + \omega^2)`."""

    frequency: float  #: [Hz]
    quality: float  #: Q
    depth: float = 0.0  #: d, the gain at its frequency

    def __call__(self, s: Array) -> Array:
        """Return the response at s (n,) [rad/s]."""
        omega = 2 * np.pi * self.frequency
        width = omega * s / self.quality
        return (s**2 + self.depth * width + omega**2) / (s**2 + width + omega**2)


class LowPass(NamedTuple):
    """A low-pass filter: of first order, or Butterworth's of second order."""

    corner: float  #: [Hz]
    order: int = 1

    def __call__(self, s: Array) -> Array:
        """Return the response at s (n,) [rad/s]."""
        x = s / (2 * np.pi * self.corner)
        return 1.0 / (1.0 + x) if self.order == 1 else 1.0 / (1.0 + np.sqrt(2.0) * x + x**2)


Filters: TypeAlias = "tuple[Notch | LowPass, ...]"


@dataclass(frozen=True, kw_only=True)
class Loop:
    r"""A loop of an autopilot: a control law from rate and attitude to one control.

    With the airspeed's scaling k, the rate w, the attitude a and its time constant T, the commanded
    rate is :math:`w_c = -a / T`. The output, 1 at full deflection, is

    .. math:: u = k^2 \left[(P + I / s) (w_c - w) - D s w\right] + k F w_c

    In ArduPilot, D acts on the filtered error, :math:`w_c` is filtered, F is divided by the ratio of true
    and equivalent airspeed, and :math:`k^2 G s w_c` is added. The output of the roll loop also moves the rudder,
    by ``rudder``.
    """

    name: str  #: roll, pitch or yaw
    control: str  #: Of the linear model
    full: float  #: Deflection at an output of 1 [rad]
    P: float  #: Output for a rate error [s/rad], at the scaling speed
    I: float = 0.0  #: Output for its integral [1/rad]
    D: float = 0.0  #: Output for its derivative [s^2/rad]
    FF: float = 0.0  #: Output for a commanded rate [s/rad]
    D_FF: float = 0.0  #: G, output for its derivative [s^2/rad]
    time_constant: float = np.inf  #: Of the attitude [s]; infinite: the rate alone is fed back
    scaling_speed: float = np.nan  #: Airspeed [m/s] of these gains; NaN: they hold at all
    least_scaling: float = 0.0
    most_scaling: float = np.inf
    of_gyro: Filters = ()  #: Filters of the rates
    of_error: Filters = ()  #: Of the rate error
    of_target: Filters = ()  #: Of the commanded rate
    of_derivative: Filters = ()
    #: D acts on the error; FF is divided by the ratio of true to equivalent airspeed
    has_ardupilot_rate_law: bool = False
    #: Part of the rate of a coordinated turn, g phi over the equivalent airspeed, that is commanded
    coordination: float = 0.0
    turn_airspeeds: tuple[float, float] = (0.0, np.inf)  #: Limits of this airspeed [m/s]
    washout: float = 0.0  #: Corner of a high-pass filter of the rate error [rad/s]
    rudder: float = 0.0  #: Deflection of the rudder that is mixed in at an output of 1 [rad]
    #: Parameters of the gains P, I, D, FF, D_FF by name, with their values
    parameters: Mapping[str, float] | None = None

    def feedback(self, s: Array, airspeed: float, density: float) -> dict[str, Array]:
        """Return the command [rad] for each output of the linear model that is fed back, (n,), by its name.

        ``s`` (n,) [rad/s] is the Laplace variable, ``airspeed`` [m/s] the true one, ``density`` [kg/m^3].
        """
        rate, angle, _ = LOOP_AXES[self.name]
        to_true = np.sqrt(SEA_LEVEL_DENSITY / density)
        equivalent = airspeed / to_true
        k = self._scaling(equivalent)
        gyro = _filtered(s, self.of_gyro)
        error = _filtered(s, self.of_error)
        if self.washout:
            error = error * s / (s + self.washout)
        derivative = self.D * s * _filtered(s, self.of_derivative)
        of_error = (self.P + self.I / s) * error
        of_rate = of_error + derivative
        feed_forward = self.FF
        if self.has_ardupilot_rate_law:
            of_error = of_rate = of_error + derivative * error
            feed_forward = self.FF / to_true
        target = _filtered(s, self.of_target)
        forward = k**2 * (of_error + self.D_FF * s) + k * feed_forward
        laws = {rate: -(k**2) * of_rate * gyro}
        if np.isfinite(self.time_constant) and angle:
            laws[angle] = -forward * target / self.time_constant
        if self.coordination:
            turn_rate = STANDARD_GRAVITY / np.clip(equivalent, *self.turn_airspeeds)
            laws["phi"] = forward * self.coordination * turn_rate
        return {name: self.full * law for name, law in laws.items()}

    def scaled(self, factor: float, gains: Sequence[str] = GAINS) -> Loop:
        """Return the loop with gains times a factor."""
        held = tuple(f"_{name}" for name in GAINS if name not in gains)
        parameters = {}
        for name, value in (self.parameters or {}).items():
            parameters[name] = value if name.endswith(held) else factor * value
        changed = {name: factor * vars(self)[name] for name in gains}
        return replace(self, **changed, parameters=parameters)

    def _scaling(self, equivalent_airspeed):
        if np.isnan(self.scaling_speed):
            return 1.0
        scaling = self.scaling_speed / equivalent_airspeed
        return float(np.clip(scaling, self.least_scaling, self.most_scaling))


def _filtered(s, filters):
    """Return the product of filters."""
    response = np.ones_like(s)
    for each in filters:
        response = response * each(s)
    return response
