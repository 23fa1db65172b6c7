"""Rate and attitude loops of PX4 and ArduPilot Plane, from a file of their parameters.

The laws are those of PX4's ``FixedwingRateControl::Run`` and ``RateControl::update``, and of
ArduPilot's ``AP_FW_Controller::_get_rate_out``, ``AC_PID::update_all`` and
``AP_YawController::get_servo_out``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.checks import check_full_deflection
from skdgp._flight.frames import SEA_LEVEL_DENSITY, STANDARD_GRAVITY

#: ArduPilot's outputs are notional degrees of deflection; at this one the servo is at its end
ARDUPILOT_FULL = 45.0
#: Corner of the high-pass filter of ArduPilot's yaw damper [rad/s]
WASHOUT = 0.2
# Defaults of the firmwares, of equivalent airspeeds [m/s]
DEFAULTS = {
    "FW_AIRSPD_TRIM": 15.0,
    "FW_AIRSPD_STALL": 7.0,
    "FW_AIRSPD_MAX": 20.0,
    "AIRSPEED_MIN": 9.0,
    "AIRSPEED_MAX": 22.0,
    "SCALING_SPEED": 15.0,
}
# Rate, attitude and control of each loop
LOOP_AXES = {
    "roll": ("p", "phi", "aileron"),
    "pitch": ("q", "theta", "elevator"),
    "yaw": ("r", "", "rudder"),
}
NUMBERS = (int, float, np.number)
# Parameters that divide
POSITIVE = {
    *DEFAULTS,
    "ARSPD_FBW_MIN",
    "ARSPD_FBW_MAX",
    "FW_R_TC",
    "FW_P_TC",
    "RLL2SRV_TCONST",
    "PTCH2SRV_TCONST",
}
NAME = re.compile(r"[A-Z][A-Z0-9_]{1,16}")
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d")
# Beginnings of the names that control laws use, and of gains of multicopters
OF_LAWS = (
    "FW_",
    "RLL",
    "PTCH",
    "YAW",
    "SCALING_SPEED",
    "AIRSPEED_M",
    "ARSPD_FBW_M",
    "KFF_RDDRMIX",
    "IMU_",
    "INS_GYRO_FILTER",
)
OF_COPTERS = ("MC_", "ATC_RAT_")


@dataclass(frozen=True, kw_only=True)
class Loop:
    r"""A loop of an autopilot: a control law from rate and attitude to one control.

    With the airspeed's scaling k, the rate w, the attitude a and its time constant T, the commanded
    rate is :math:`w_c = -a / T`. The output, 1 at full deflection, is

    .. math:: u = k^2 \left[(P + I / s) (w_c - w) - D s w\right] + k F w_c

    In ArduPilot, D acts on the filtered error, :math:`w_c` is filtered, and F is divided by the ratio of true
    and equivalent airspeed. The output of the roll loop also moves the rudder, by ``rudder``.
    """

    name: str  #: roll, pitch or yaw
    control: str  #: Of the linear model
    full: float  #: Deflection at an output of 1 [rad]
    P: float  #: Output for a rate error [s/rad], at the scaling speed
    I: float = 0.0  #: Output for its integral [1/rad]
    D: float = 0.0  #: Output for its derivative [s^2/rad]
    FF: float = 0.0  #: Output for a commanded rate [s/rad]
    time_constant: float = np.inf  #: Of the attitude [s]; infinite: the rate alone is fed back
    scaling_speed: float = np.nan  #: Airspeed [m/s] of these gains; NaN: they hold at all
    least_scaling: float = 0.0
    most_scaling: float = np.inf
    gyro_corner: float = np.inf  #: Of the second-order filter of the rates [Hz]
    derivative_corner: float = np.inf  #: Of the filter of the derivative [Hz]
    error_corner: float = np.inf  #: Of the filter of the error [Hz]
    target_corner: float = np.inf  #: Of the filter of the commanded rate [Hz]
    derivative_of_error: bool = False
    forward_by_true_airspeed: bool = False  #: F is divided by true over equivalent airspeed
    coordination: float = (
        0.0  #: Part of the rate of a coordinated turn, g phi / V, that is commanded
    )
    washout: float = 0.0  #: Corner of a high-pass filter of the rate error [rad/s]
    slip: float = (
        0.0  #: ArduPilot's YAW2SRV_SLIP: lateral acceleration that counts as a rate [rad s/m]
    )
    rudder: float = 0.0  #: Deflection of the rudder that is mixed in at an output of 1 [rad]
    #: Parameters of the gains P, I, D, FF by name, with their values
    parameters: Mapping[str, float] | None = None

    def feedback(self, s: Array, airspeed: float, density: float) -> dict[str, Array]:
        """Return the command [rad] for each output of the linear model that is fed back, (n,), by its name.

        ``s`` (n,) [rad/s] is the Laplace variable, ``airspeed`` [m/s] the true one, ``density`` [kg/m^3].
        """
        rate, angle, _ = LOOP_AXES[self.name]
        to_true = np.sqrt(SEA_LEVEL_DENSITY / density)
        k = self._scaling(airspeed / to_true)
        gyro = _second_order(s, self.gyro_corner)
        error = _first_order(s, self.error_corner)
        if self.washout:
            error = error * s / (s + self.washout)
        derivative = self.D * s * _first_order(s, self.derivative_corner)
        of_error = (self.P + self.I / s) * error
        if self.derivative_of_error:
            of_error = of_error + derivative * error
        of_rate = of_error if self.derivative_of_error else of_error + derivative
        target = _first_order(s, self.target_corner)
        feed_forward = self.FF / to_true if self.forward_by_true_airspeed else self.FF
        forward = k**2 * of_error + k * feed_forward
        laws = {rate: -(k**2) * of_rate * gyro}
        if np.isfinite(self.time_constant) and angle:
            laws[angle] = -forward * target / self.time_constant
        if self.coordination:
            laws["phi"] = forward * self.coordination * STANDARD_GRAVITY / airspeed
        if self.slip:
            laws["ay"] = -(k**2) * self.I / s * self.slip
        return {name: self.full * law for name, law in laws.items()}

    def scaled(self, factor: float) -> Loop:
        """Return the loop with P, I, D and FF times a factor."""
        parameters = {name: factor * value for name, value in (self.parameters or {}).items()}
        gains = {name: factor * vars(self)[name] for name in ("P", "I", "D", "FF")}
        return replace(self, **gains, parameters=parameters)

    def _scaling(self, equivalent_airspeed):
        if np.isnan(self.scaling_speed):
            return 1.0
        scaling = self.scaling_speed / equivalent_airspeed
        return float(np.clip(scaling, self.least_scaling, self.most_scaling))


def _first_order(s, corner):
    """Return the low-pass filter of a corner [Hz]."""
    return 1.0 / (1.0 + s / (2 * np.pi * corner))


def _second_order(s, corner):
    """Return Butterworth's low-pass filter of second order of a corner [Hz]."""
    x = s / (2 * np.pi * corner)
    return 1.0 / (1.0 + np.sqrt(2.0) * x + x**2)


def read_parameters(path: str | Path) -> dict[str, float]:
    """Return the parameters of an autopilot from a file, by name.

    Files of QGroundControl, Mission Planner, MAVProxy and PX4's ``param show`` have a parameter on each
    line, its name before its value.

    Raises
    ------
    ValueError
        If the file has none, or a parameter of the control law is no finite number.
    """
    path = Path(path)
    found = {}
    # Windows writes a mark of the byte order first
    for line in path.read_text(encoding="utf-8-sig", errors="replace").splitlines():
        text = re.sub(r"\[[^\]]*\]", " ", line.split("#")[0])
        words = re.split(r"[\s,:=]+", text.strip())
        for name, value in pairwise(words):
            if NAME.fullmatch(name):
                number = _number(value)
                behind = text.split(name, 1)[1].lstrip(" \t,:=")
                if DECIMAL_COMMA.match(behind):
                    number = None
                if number is not None:
                    found[name] = number
                elif name.startswith(OF_LAWS):
                    raise ValueError(
                        f"Got the line {line.strip()!r} in {path}, but expected a number with a decimal point "
                        f"behind {name}: save the parameters again."
                    )
                break
    if not found:
        raise ValueError(
            f"Got {path} without parameters, but expected lines of a name and a value, as ground stations save them."
        )
    return found


def _number(text):
    try:
        number = float(text)
    except ValueError:
        return None
    return number if np.isfinite(number) else None


def autopilot_loops(
    parameters: str | Path | Mapping[str, float], full: Mapping[str, float]
) -> list[Loop]:
    """Return the loops of PX4 or ArduPilot Plane with gains, for the controls that ``full`` names.

    Warns of a control that ``full`` names and no gains move.

    Parameters
    ----------
    parameters : path or mapping of str to float
        A file, see `read_parameters`, or its parameters. PX4: ``FW_RR_*``, ``FW_PR_*``, ``FW_YR_*``, the
        attitude's ``FW_R_TC`` and ``FW_P_TC``, filters ``IMU_GYRO_CUTOFF`` and ``IMU_DGYRO_CUTOFF``, the
        rudder's ``FW_RLL_TO_YAW_FF``. ArduPilot Plane 4.1 and newer: ``RLL_RATE_*``, ``PTCH_RATE_*``,
        ``RLL2SRV_TCONST``, ``PTCH2SRV_TCONST``, ``YAW2SRV_*``, ``KFF_RDDRMIX``, ``SCALING_SPEED``,
        ``INS_GYRO_FILTER``. Gains that are missing are zero, and a missing time constant of PX4 means that
        only the rate is fed back; other missing parameters have the firmware's defaults, limits of the airspeed if
        they include that of the trim.
    full : mapping of str to float
        Deflection [rad] of aileron, elevator and rudder at an output of 1, positive. Loops of controls
        that are not named are left out.

    Returns
    -------
    list of Loop

    Raises
    ------
    ValueError
        If there are no gains of these firmwares, or of both, no loop for the controls, a parameter is no finite
        number, an airspeed or a time constant is not above zero, or the trim of PX4's airspeed is beyond its limits.

    Examples
    --------
    >>> from skdgp.control import autopilot_loops
    >>> gains = {"FW_RR_P": 0.05, "FW_RR_I": 0.1, "FW_R_TC": 0.4, "FW_AIRSPD_TRIM": 15.0}
    >>> [loop.name for loop in autopilot_loops(gains, full={"aileron": 0.42})]
    ['roll']
    """
    firmware = parameters if isinstance(parameters, Mapping) else read_parameters(parameters)
    _check_parameters(firmware)
    _check_full(full)
    is_px4 = "FW_RR_P" in firmware or "FW_PR_P" in firmware
    is_ardupilot = "RLL_RATE_P" in firmware or "PTCH_RATE_P" in firmware
    if firmware.get("YAW_RATE_ENABLE", 0) and "rudder" in full:
        raise ValueError(
            "Got YAW_RATE_ENABLE=1 and the rudder in full, but the law of ArduPilot's yaw rate controller is not "
            "known here: leave the rudder out of full."
        )
    if is_px4 and is_ardupilot:
        raise ValueError(
            "Got gains of PX4 (FW_RR_P, FW_PR_P) and of ArduPilot (RLL_RATE_P, PTCH_RATE_P), but expected those of "
            "one autopilot: save the parameters of the aircraft again."
        )
    if is_px4:
        loops = _px4_loops(firmware, full)
    elif is_ardupilot:
        loops = _ardupilot_loops(firmware, full)
    elif "RLL2SRV_P" in firmware or "PTCH2SRV_P" in firmware:
        raise ValueError(
            "Got the gains RLL2SRV_P or PTCH2SRV_P of ArduPilot before 4.1, but expected RLL_RATE_P and "
            "PTCH_RATE_P: the older firmware has another control law."
        )
    elif copter := [name for name in firmware if name.startswith(OF_COPTERS)]:
        raise ValueError(
            f"Got {copter[0]}, a gain of a multicopter, but expected FW_RR_P or FW_PR_P of PX4, or RLL_RATE_P or "
            "PTCH_RATE_P of ArduPilot Plane: save the parameters of the aeroplane."
        )
    else:
        raise ValueError(
            f"Got parameters without gains of a rate loop ({len(firmware)} in all), but expected FW_RR_P or FW_PR_P "
            "of PX4, or RLL_RATE_P or PTCH_RATE_P of ArduPilot Plane."
        )
    if not loops:
        raise ValueError(
            f"Got no gains other than zero for {sorted(full)}, but expected at least one loop for these controls."
        )
    moved = {loop.control for loop in loops}
    if any(loop.rudder for loop in loops):
        moved.add("rudder")
    open_controls = sorted({*full} - moved)
    if open_controls:
        warn(
            f"The parameters have no gains other than zero for {' and '.join(open_controls)}: no loop moves "
            "them. Leave them out of full, or save all parameters of the autopilot."
        )
    return loops


def _check_parameters(firmware):
    """Raise ValueError of parameters of control laws that are no finite numbers, or divide and are not above zero."""
    for name, value in firmware.items():
        is_number = isinstance(value, NUMBERS) and np.isfinite(value)
        if str(name).startswith(OF_LAWS) and not is_number:
            raise ValueError(f"Got {name}={value!r}, but expected a finite number.")
    # without scaling by the airspeed that of the trim does not count
    is_scaled = firmware.get("FW_ARSP_SCALE_EN", 1)
    for name in POSITIVE & {*firmware}:
        if not firmware[name] > 0 and (is_scaled or not name.startswith("FW_AIRSPD")):
            raise ValueError(f"Got {name}={firmware[name]:g}, but expected a number above zero.")


def _check_full(full):
    """Raise ValueError where full deflections are no mapping of surfaces to positive angles up to 90 degrees."""
    surfaces = [surface for *_, surface in LOOP_AXES.values()]
    if not isinstance(full, Mapping) or not full or not {*full} <= {*surfaces}:
        raise ValueError(
            f"Got full={full!r}, but expected deflections [rad] at full output of some of {surfaces}."
        )
    for name, value in full.items():
        check_full_deflection(name, value)


def _airspeed(parameters, name, former_name=""):
    """Return an equivalent airspeed [m/s], by its name or the one of earlier firmware, or its default."""
    return parameters.get(name, parameters.get(former_name, DEFAULTS[name]))


def _corner(parameters, name, default):
    """Return the corner of a filter [Hz]; zero switches it off."""
    corner = parameters.get(name, default)
    return corner if corner > 0 else np.inf


def _px4_loops(firmware, full):
    """Return the loops of PX4's ``FixedwingRateControl``; FF is inside the loop of the attitude."""
    scaling = {}
    # without airspeed the firmware takes that of the trim
    is_measured = firmware.get("FW_USE_AIRSPD", 1) and not firmware.get("FW_ARSP_MODE", 0)
    if firmware.get("FW_ARSP_SCALE_EN", 1) and is_measured:
        trim = _airspeed(firmware, "FW_AIRSPD_TRIM")
        slowest = _airspeed(firmware, "FW_AIRSPD_STALL")
        fastest = _airspeed(firmware, "FW_AIRSPD_MAX")
        # the firmware refuses a trim beyond its limits, so a default that excludes the trim is not its limit
        if slowest > trim and "FW_AIRSPD_STALL" not in firmware:
            slowest = 0.1
        if fastest < trim and "FW_AIRSPD_MAX" not in firmware:
            fastest = 1000.0
        if not slowest <= trim <= fastest:
            raise ValueError(
                f"Got FW_AIRSPD_STALL {slowest:g}, TRIM {trim:g} and MAX {fastest:g}, given or by default, but "
                "expected airspeeds that increase: give all three."
            )
        scaling = {
            "scaling_speed": trim,
            "least_scaling": trim / fastest,
            "most_scaling": trim / slowest,
        }
    filters = {
        "gyro_corner": _corner(firmware, "IMU_GYRO_CUTOFF", 40.0),
        "derivative_corner": _corner(firmware, "IMU_DGYRO_CUTOFF", 30.0),
    }
    loops = []
    for name, short in {"roll": "R", "pitch": "P", "yaw": "Y"}.items():
        parameters = {gain: f"FW_{short}R_{gain}" for gain in ("P", "I", "D", "FF")}
        settings: dict[str, Any] = {"time_constant": firmware.get(f"FW_{short}_TC", np.inf)}
        if name == "roll":
            settings["rudder"] = firmware.get("FW_RLL_TO_YAW_FF", 0.0) * full.get("rudder", 0.0)
        if name == "yaw":
            settings["coordination"] = 1.0
        loops += _loop(name, parameters, 1.0, firmware, full, **settings, **scaling, **filters)
    return loops


def _ardupilot_loops(firmware, full):
    """Return the loops of ArduPilot's ``AP_FW_Controller`` and ``AP_YawController``."""
    scaling_speed = _airspeed(firmware, "SCALING_SPEED")
    slowest = _airspeed(firmware, "AIRSPEED_MIN", "ARSPD_FBW_MIN")
    fastest = _airspeed(firmware, "AIRSPEED_MAX", "ARSPD_FBW_MAX")
    common = {
        "scaling_speed": scaling_speed,
        # Plane::calc_speed_scaler
        "least_scaling": min(0.5, scaling_speed / (2 * fastest)),
        "most_scaling": max(2.0, scaling_speed / (0.7 * slowest)),
        "gyro_corner": _corner(firmware, "INS_GYRO_FILTER", 20.0),
    }
    unit = np.rad2deg(1.0) / ARDUPILOT_FULL
    loops = []
    for name, rate, angle in (("roll", "RLL_RATE", "RLL2SRV"), ("pitch", "PTCH_RATE", "PTCH2SRV")):
        parameters = {gain: f"{rate}_{gain}" for gain in ("P", "I", "D", "FF")}
        settings = {
            "time_constant": firmware.get(f"{angle}_TCONST", 0.5),
            "forward_by_true_airspeed": True,
            "error_corner": _corner(firmware, f"{rate}_FLTE", 0.0),
            "target_corner": _corner(firmware, f"{rate}_FLTT", 3.0),
            "derivative_corner": _corner(firmware, f"{rate}_FLTD", 12.0),
        }
        if name == "roll":
            settings["rudder"] = firmware.get("KFF_RDDRMIX", 0.5) * full.get("rudder", 0.0)
        loops += _loop(
            name,
            parameters,
            unit,
            firmware,
            full,
            derivative_of_error=True,
            **settings,
            **common,
        )
    return loops + _ardupilot_yaw_damper(firmware, full, unit, common)


def _ardupilot_yaw_damper(firmware, full, unit, common):
    """Return the yaw damper: the output is -DAMP (1 + INT / s) of the washed out rate, and INT of the slip."""
    damping = firmware.get("YAW2SRV_DAMP", 0.0)
    if not damping or "rudder" not in full:
        return []
    integral = firmware.get("YAW2SRV_INT", 0.0)
    return [
        Loop(
            name="yaw",
            control="rudder",
            full=full["rudder"],
            P=unit * damping,
            I=unit * damping * integral,
            washout=WASHOUT,
            coordination=firmware.get("YAW2SRV_RLL", 1.0),
            # degrees of rate for an acceleration
            slip=np.deg2rad(firmware.get("YAW2SRV_SLIP", 0.0)),
            parameters={"YAW2SRV_DAMP": damping},
            **common,
        )
    ]


def _loop(name, parameters, unit, firmware, full, **settings):
    """Return the loop of an axis, or none: parameters without values are zero."""
    control = LOOP_AXES[name][2]
    values = {gain: firmware.get(parameter, 0.0) for gain, parameter in parameters.items()}
    feeds_back = any(values[gain] for gain in ("P", "I", "D"))
    # FF closes the loop of the attitude, or of the turn
    commands = np.isfinite(settings["time_constant"]) or settings.get("coordination", 0.0)
    feeds_attitude = values["FF"] and commands
    if control not in full or not (feeds_back or feeds_attitude):
        return []
    named = {
        parameter: firmware[parameter] for parameter in parameters.values() if parameter in firmware
    }
    gains = {gain: unit * value for gain, value in values.items()}
    return [
        Loop(
            name=name,
            control=control,
            full=full[control],
            parameters=named,
            **gains,
            **settings,
        )
    ]
