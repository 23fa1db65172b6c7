"""Parameters of PX4 and ArduPilot Plane: their files, the firmwares' defaults, and the loops that they describe.

The names and defaults are those of PX4 1.14 and ArduPilot Plane 4.5. Filters of the rates are those of PX4's
``VehicleAngularVelocity``, and of ArduPilot's ``HarmonicNotchFilter`` and ``NotchFilter``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import warn
from skdgp._flight.servo_functions import WEIGHTS, ServoFunction
from skdgp._flight.tables import as_floats, check_full_deflections
from skdgp.control._loops import GAINS, LOOP_AXES, Loop, LowPass, Notch

#: ArduPilot's outputs are notional degrees of deflection; at this one the servo is at its end
ARDUPILOT_FULL = 45.0
#: Decay of the high-pass filter of ArduPilot's yaw damper at each turn of the main loop
WASHOUT = 1 - 0.9960080
# Defaults other than zero
# fmt: off
PX4_DEFAULTS = {
    "FW_RR_P": 0.05, "FW_RR_I": 0.1, "FW_RR_FF": 0.5, "FW_RR_IMAX": 0.2, "FW_R_TC": 0.4,
    "FW_PR_P": 0.08, "FW_PR_I": 0.1, "FW_PR_FF": 0.5, "FW_PR_IMAX": 0.4, "FW_P_TC": 0.4,
    "FW_YR_P": 0.05, "FW_YR_I": 0.1, "FW_YR_FF": 0.3, "FW_YR_IMAX": 0.2,
    "FW_AIRSPD_TRIM": 15.0, "FW_AIRSPD_STALL": 7.0, "FW_AIRSPD_MAX": 20.0,
    "IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0,
    "IMU_GYRO_NF0_BW": 20.0, "IMU_GYRO_NF1_BW": 20.0,
}
ARDUPILOT_DEFAULTS = {
    "RLL_RATE_P": 0.08, "RLL_RATE_I": 0.15, "RLL_RATE_FF": 0.345, "RLL_RATE_IMAX": 0.666,
    "PTCH_RATE_P": 0.04, "PTCH_RATE_I": 0.15, "PTCH_RATE_FF": 0.345, "PTCH_RATE_IMAX": 0.666,
    "RLL_RATE_FLTT": 3.0, "RLL_RATE_FLTD": 12.0, "PTCH_RATE_FLTT": 3.0, "PTCH_RATE_FLTD": 12.0,
    "RLL2SRV_TCONST": 0.5, "PTCH2SRV_TCONST": 0.5, "YAW2SRV_RLL": 1.0, "KFF_RDDRMIX": 0.5,
    "SCALING_SPEED": 15.0, "AIRSPEED_MIN": 9.0, "AIRSPEED_MAX": 22.0, "MIXING_GAIN": 0.5,
    "INS_GYRO_FILTER": 20.0, "SCHED_LOOP_RATE": 50.0,
}
# fmt: on
# Harmonic notch filters of ArduPilot's gyros
HARMONIC_NOTCHES = ("INS_HNTCH", "INS_HNTC2")
# INS_HNTCH_MODE of a notch that follows no engine, whatever its INS_HNTCH_REF
FIXED = 0
# Parameters that divide
POSITIVE = {
    *("FW_AIRSPD_TRIM", "FW_AIRSPD_STALL", "FW_AIRSPD_MAX", "FW_R_TC", "FW_P_TC"),
    *("SCALING_SPEED", "AIRSPEED_MIN", "AIRSPEED_MAX", "ARSPD_FBW_MIN", "ARSPD_FBW_MAX"),
    "SCHED_LOOP_RATE",
    *("RLL2SRV_TCONST", "PTCH2SRV_TCONST"),
}
# Name and value: one with a decimal comma as a whole, or nothing where the line is cut off
NAMED = re.compile(r"\b([A-Z][A-Z0-9_]{1,16})(?:[\s,:=]+([-+]?\d+,\d|[^\s,:=]*)|$)")
# Comments of ground stations and of ArduPilot's default files
COMMENT = re.compile(r"#.*|//.*|\[[^\]]*\]")
# Vehicle and component before the name, in files of QGroundControl
VEHICLE = re.compile(r"(\d+)\s+\d+\s+[A-Z]")
# Beginnings of the names that control laws use
OF_LAWS = (
    *("FW_", "IMU_", "RLL", "PTCH", "YAW", "SCALING_SPEED", "SCHED_LOOP_RATE", "AIRSPEED_M"),
    *("ARSPD_FBW_M", "KFF_RDDRMIX", "MIXING_", "INS_GYRO_FILTER", "INS_HNTC", "INS_NOTCH"),
)
OF_PX4 = ("FW_RR_", "FW_PR_", "FW_YR_")
OF_ARDUPILOT = ("RLL_RATE_", "PTCH_RATE_")
# Limits of integrators and of commanded rates, the turn's pitch rate, and what chooses rates of sampling: none of
# them changes a small oscillation about level flight
WITHOUT_EFFECT = re.compile(
    r".*_(IMAX|RMAX|RMAX_UP|RMAX_DN|RMX)|PTCH2SRV_RLL|IMU_GYRO_(RATEMAX|CAL_EN|FFT_.*|DNF_(BW|HMC|MIN))"
)
# Servos that the autopilot mixes, with MIXING_GAIN
MIXED = {
    *(ServoFunction.ELEVON_LEFT, ServoFunction.ELEVON_RIGHT),
    *(ServoFunction.VTAIL_LEFT, ServoFunction.VTAIL_RIGHT),
}
# ArduPilot's default functions of servos 1 to 4
USUAL_FUNCTIONS = {
    1: ServoFunction.AILERON,
    2: ServoFunction.ELEVATOR,
    3: ServoFunction.THROTTLE,
    4: ServoFunction.RUDDER,
}
N_SERVOS = 32


def read_parameters(path: str | Path) -> dict[str, float]:
    """Return the parameters of an autopilot from a file, by name.

    Files of QGroundControl, Mission Planner, MAVProxy and PX4's ``param show`` have a parameter on each
    line, its name before its value. Comments begin with ``#`` or ``//``. In ArduPilot's files of defaults
    ``@delete NAME`` removes a parameter.

    Raises
    ------
    ValueError
        If the file has none, one of them twice with different values, those of two vehicles, a line that
        includes another file, or a parameter of the control law that is no finite number.
    """
    path = Path(path)
    found: dict[str, float] = {}
    vehicles = set()
    # Windows writes a mark of the byte order first
    for line in path.read_text(encoding="utf-8-sig", errors="replace").splitlines():
        text = COMMENT.sub(" ", line).strip()
        if text.startswith("@include"):
            raise ValueError(
                f"Got the line {line.strip()!r} in {path}, but expected all parameters in one file: put those of "
                "the other file in its place."
            )
        if text.startswith("@delete"):
            found.pop(text.split()[-1], None)
            continue
        if vehicle := VEHICLE.match(text):
            vehicles.add(vehicle[1])
        named = NAMED.search(text)
        if named is None:
            continue
        name, value = named.groups()
        number = float(as_floats(value))
        if not np.isfinite(number):
            if name.startswith(OF_LAWS):
                raise ValueError(
                    f"Got the line {line.strip()!r} in {path}, but expected a number with a decimal point behind "
                    f"{name}: save the parameters again."
                )
            continue
        if found.get(name, number) != number:
            raise ValueError(
                f"Got {name} twice in {path}, {found[name]:g} and {number:g}, but expected the parameters of one "
                "vehicle, each once: delete those that do not count."
            )
        found[name] = number
    if len(vehicles) > 1:
        raise ValueError(
            f"Got parameters of the vehicles {', '.join(sorted(vehicles))} in {path}, but expected those of one: "
            "delete the lines of the others."
        )
    if not found:
        raise ValueError(
            f"Got {path} without parameters, but expected lines of a name and a value, as ground stations save them."
        )
    return found


class Parameters:
    """Parameters of an autopilot with the defaults of its firmware; it remembers what was asked and absent."""

    def __init__(self, given: Mapping[str, float], defaults: Mapping[str, float]) -> None:
        self.given = given
        self.defaults = defaults
        self.asked: set[str] = set()
        #: Defaults other than zero that count
        self.absent: dict[str, float] = {}

    def __call__(self, name: str, former: str = "", default: float = 0.0) -> float:
        """Return a parameter, by its name or the one of earlier firmware, or its default by the firmware."""
        self.asked |= {name, former}
        for key in (name, former):
            if key in self.given:
                return self.given[key]
        default = self.defaults.get(name, default)
        if default and not WITHOUT_EFFECT.fullmatch(name):
            self.absent[name] = default
        return default

    def low_pass(self, name: str, order: int = 1) -> tuple[LowPass, ...]:
        """Return the filter of a corner [Hz]; zero switches it off."""
        corner = self(name)
        return (LowPass(corner, order),) if corner > 0 else ()

    def unread(self, prefixes: tuple[str, ...]) -> dict[str, float]:
        """Return the parameters with some beginnings of their names that are not zero, and were not asked."""
        unread = {}
        for name, value in self.given.items():
            is_known = name in self.asked or WITHOUT_EFFECT.fullmatch(name)
            if value and name.startswith(prefixes) and not is_known:
                unread[name] = value
        return unread


def autopilot_loops(
    parameters: str | Path | Mapping[str, float], full: Mapping[str, float]
) -> list[Loop]:
    """Return the loops of PX4 or ArduPilot Plane with gains, for the controls that ``full`` names.

    Parameters
    ----------
    parameters : path or mapping of str to float
        A file, see `read_parameters`, or its parameters; those that are missing have the firmware's defaults. PX4:
        gains and time constants ``FW_RR_*``, ``FW_PR_*``, ``FW_YR_*``, ``FW_R_TC``, ``FW_P_TC``, the rudder's
        ``FW_RLL_TO_YAW_FF``, filters ``IMU_GYRO_*``, airspeeds ``FW_AIRSPD_*``. ArduPilot Plane 4.1 and newer:
        ``RLL_RATE_*``, ``PTCH_RATE_*``, ``RLL2SRV_TCONST``, ``PTCH2SRV_TCONST``, ``YAW2SRV_*``, ``KFF_RDDRMIX``,
        the rate of its filter ``SCHED_LOOP_RATE``,
        filters ``INS_GYRO_FILTER``, ``INS_HNTCH_*`` and ``INS_HNTC2_*``, airspeeds
        ``SCALING_SPEED``, ``AIRSPEED_MIN`` and ``AIRSPEED_MAX``, and for elevons and V-tails ``SERVOn_FUNCTION`` and
        ``MIXING_GAIN``.
    full : mapping of str to float
        Deflection [rad] of aileron, elevator and rudder with the servos at their ends, positive, as of `fly`; for
        PX4 at an output of 1. Loops of controls that are not named are left out.

    Returns
    -------
    list of Loop

    Raises
    ------
    ValueError
        If there are no gains of these firmwares, or of both, no loop for the controls, a parameter is no finite
        number, an airspeed or a time constant is not above zero, or the trim of PX4's airspeed is beyond its limits.

    Warns
    -----
    UserWarning
        Of a control that ``full`` names and no gains move; of parameters that have the firmware's defaults; of
        parameters that are not zero, and change the loops in a way that is not known here.

    Examples
    --------
    >>> from skdgp.control import autopilot_loops
    >>> gains = {"FW_RR_P": 0.05, "FW_RR_I": 0.1, "FW_RR_FF": 0.5, "FW_R_TC": 0.4}
    >>> speeds = {"FW_AIRSPD_TRIM": 15.0, "FW_AIRSPD_STALL": 9.0, "FW_AIRSPD_MAX": 25.0}
    >>> filters = {"IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0}
    >>> [loop.name for loop in autopilot_loops(gains | speeds | filters, full={"aileron": 0.42})]
    ['roll']
    """
    given = parameters if isinstance(parameters, Mapping) else read_parameters(parameters)
    _check_parameters(given)
    full = check_full_deflections(full, [surface for *_, surface in LOOP_AXES.values()])
    if not full:
        raise ValueError(
            f"Got full={full}, but expected deflections [rad] at full output of aileron, elevator or rudder."
        )
    is_px4 = any(name.startswith(OF_PX4) for name in given)
    is_ardupilot = any(name.startswith(OF_ARDUPILOT) for name in given)
    if is_px4 and is_ardupilot:
        raise ValueError(
            "Got gains of PX4 (FW_RR_P, FW_PR_P) and of ArduPilot (RLL_RATE_P, PTCH_RATE_P), but expected those of "
            "one autopilot: save the parameters of the aircraft again."
        )
    if not (is_px4 or is_ardupilot):
        raise ValueError(
            f"Got parameters without gains of a rate loop ({len(given)} in all), but expected FW_RR_P or FW_PR_P of "
            "PX4, or RLL_RATE_P or PTCH_RATE_P of ArduPilot Plane, not those of a multicopter or of a Plane before "
            "4.1 (RLL2SRV_P), which has another control law."
        )
    value = Parameters(given, PX4_DEFAULTS if is_px4 else ARDUPILOT_DEFAULTS)
    loops, unknown = (_px4_loops if is_px4 else _ardupilot_loops)(value, full)
    if not loops:
        raise ValueError(
            f"Got no gains other than zero for {sorted(full)}, but expected at least one loop for these controls."
        )
    moved = {loop.control for loop in loops}
    if any(loop.rudder for loop in loops):
        moved.add("rudder")
    if still := sorted({*full} - moved):
        warn(
            f"The parameters have no gains other than zero for {' and '.join(still)}: no loop moves "
            "them. Leave them out of full, or save all parameters of the autopilot."
        )
    if value.absent:
        firmware = "PX4 1.14" if is_px4 else "ArduPilot Plane 4.5"
        warn(
            f"The parameters lack {_listed(value.absent)}: these are the defaults of {firmware}, which count here. "
            "Save all parameters of the autopilot if it has others."
        )
    if unknown:
        warn(
            f"These parameters of the loops are not zero, and margins do not contain what they do: {_listed(unknown)}."
        )
    return loops


def _listed(values: Mapping[str, float]) -> str:
    """Return parameters with their values as text."""
    return ", ".join(f"{name} {value:g}" for name, value in values.items())


def _check_parameters(given: Mapping[str, float]) -> None:
    """Raise ValueError of parameters of control laws that are no finite numbers, or divide and are not above zero."""
    for name, value in given.items():
        is_number = isinstance(value, int | float | np.number) and np.isfinite(value)
        if str(name).startswith(OF_LAWS) and not is_number:
            raise ValueError(f"Got {name}={value!r}, but expected a finite number.")
    for name in POSITIVE & {*given}:
        if not given[name] > 0:
            raise ValueError(f"Got {name}={given[name]:g}, but expected a number above zero.")


def _px4_loops(value: Parameters, full: Mapping[str, float]) -> tuple[list[Loop], dict[str, float]]:
    """Return the loops of PX4's ``FixedwingRateControl``, and the parameters of the loops that are not known here.

    FF is inside the loop of the attitude.
    """
    notches = []
    for n in range(2):
        frequency = value(f"IMU_GYRO_NF{n}_FRQ")
        if frequency > 0 and (width := value(f"IMU_GYRO_NF{n}_BW")) > 0:
            notches.append(Notch(frequency, frequency / width))
    scaling, turn_airspeeds = _px4_airspeeds(value)
    common = {
        **scaling,
        "of_gyro": (*value.low_pass("IMU_GYRO_CUTOFF", 2), *notches),
        "of_derivative": value.low_pass("IMU_DGYRO_CUTOFF"),
    }
    loops = []
    prefixes = ["IMU_GYRO_", "IMU_DGYRO_"]
    for name, short in {"roll": "R", "pitch": "P", "yaw": "Y"}.items():
        if LOOP_AXES[name][2] not in full:
            continue
        prefixes.append(f"FW_{short}R_")
        settings: dict[str, Any]
        if name == "yaw":
            settings = {"coordination": 1.0, "turn_airspeeds": turn_airspeeds}
        else:
            settings = {"time_constant": value(f"FW_{short}_TC")}
        if name == "roll" and "rudder" in full:
            settings["rudder"] = value("FW_RLL_TO_YAW_FF") * full["rudder"]
        loops += _loop(name, f"FW_{short}R", 1.0, value, full, **settings, **common)
    return loops, value.unread(tuple(prefixes))


def _px4_airspeeds(value: Parameters) -> tuple[dict[str, float], tuple[float, float]]:
    """Return speed and limits of the scaling of the gains, and the limits of ``get_airspeed_constrained``.

    If PX4 does not use the airspeed, it takes the one of the trim and does not scale.
    """
    trim = value("FW_AIRSPD_TRIM")
    if not value.given.get("FW_USE_AIRSPD", 1) or value.given.get("FW_ARSP_MODE", 0):
        return {}, (trim, trim)
    slowest = value("FW_AIRSPD_STALL")
    fastest = value("FW_AIRSPD_MAX")
    if not slowest <= trim <= fastest:
        raise ValueError(
            f"Got FW_AIRSPD_STALL {slowest:g}, TRIM {trim:g} and MAX {fastest:g}, given or by default, but "
            "expected airspeeds that increase: give all three."
        )
    scaling = {}
    if value.given.get("FW_ARSP_SCALE_EN", 1):
        scaling["scaling_speed"] = trim
        scaling["least_scaling"] = trim / fastest
        scaling["most_scaling"] = trim / slowest
    return scaling, (slowest, fastest)


def _ardupilot_loops(
    value: Parameters, full: Mapping[str, float]
) -> tuple[list[Loop], dict[str, float]]:
    """Return the loops of ArduPilot's ``AP_FW_Controller`` and ``AP_YawController``, as `_px4_loops` does."""
    if value("YAW_RATE_ENABLE") and "rudder" in full:
        raise ValueError(
            "Got YAW_RATE_ENABLE=1 and the rudder in full, but the law of ArduPilot's yaw rate controller is not "
            "known here: leave the rudder out of full."
        )
    full = {name: angle * output_factor(value, name) for name, angle in full.items()}
    scaling_speed = value("SCALING_SPEED")
    slowest = value("AIRSPEED_MIN", "ARSPD_FBW_MIN")
    fastest = value("AIRSPEED_MAX", "ARSPD_FBW_MAX")
    notches, others = _gyro_notches(value)
    common = {
        "scaling_speed": scaling_speed,
        # Plane::calc_speed_scaler
        "least_scaling": min(0.5, scaling_speed / (2 * fastest)),
        "most_scaling": max(2.0, scaling_speed / (0.7 * slowest)),
        "of_gyro": (*value.low_pass("INS_GYRO_FILTER", 2), *notches),
    }
    unit = np.rad2deg(1.0) / ARDUPILOT_FULL
    loops = []
    prefixes = ["INS_NOTCH_ENABLE", "MIXING_OFFSET", *others]  # notches before 4.2
    for name, rate, angle in (("roll", "RLL_RATE", "RLL2SRV"), ("pitch", "PTCH_RATE", "PTCH2SRV")):
        if LOOP_AXES[name][2] not in full:
            continue
        prefixes += [f"{rate}_", f"{angle}_"]
        settings = {
            "time_constant": value(f"{angle}_TCONST"),
            "of_error": value.low_pass(f"{rate}_FLTE"),
            "of_target": value.low_pass(f"{rate}_FLTT"),
            "of_derivative": value.low_pass(f"{rate}_FLTD"),
            "has_ardupilot_rate_law": True,
        }
        if name == "roll" and "rudder" in full:
            settings["rudder"] = value("KFF_RDDRMIX") * full["rudder"]
        loops += _loop(name, rate, unit, value, full, **settings, **common)
    if "rudder" in full:
        prefixes.append("YAW2SRV_")
        loops += _ardupilot_yaw_damper(value, full, unit, common)
    return loops, value.unread(tuple(prefixes))


def output_factor(value: Parameters, control: str) -> float:
    """Return the deflection of a control at a full output of its loop, over the one with the servos at their ends.

    The mixer of elevons and V-tails, ``Plane::channel_function_mixer``, multiplies outputs by MIXING_GAIN. Warns if
    no servo moves the control.
    """
    functions = {*servo_functions(value.given).values()}
    factor = 0.0
    for function, weight in WEIGHTS[control].items():
        if function in functions:
            factor += abs(weight) * (value("MIXING_GAIN") if function in MIXED else 1.0)
    if not factor:
        warn(
            f"No servo is the {control} by SERVOn_FUNCTION: its loop is taken as one whose full output is full "
            "deflection."
        )
        return 1.0
    return factor


def servo_functions(given: Mapping[str, float]) -> dict[int, int]:
    """Return the function of each output, by default aileron, elevator, throttle, rudder."""
    numbers = range(1, N_SERVOS + 1)
    return {n: int(given.get(f"SERVO{n}_FUNCTION", USUAL_FUNCTIONS.get(n, 0))) for n in numbers}


def _gyro_notches(value: Parameters) -> tuple[list[Notch], list[str]]:
    """Return the notches of ArduPilot's gyros, one at each harmonic, and the settings that make them others.

    A notch of a width [Hz] and an attenuation [dB] is that of ArduPilot's ``NotchFilter``.
    """
    notches: list[Notch] = []
    others: list[str] = []
    for name in HARMONIC_NOTCHES:
        width = value(f"{name}_BW", default=40.0) if value(f"{name}_ENABLE") else 0.0
        if not width > 0:
            continue
        others.append(f"{name}_OPTS")
        if value.given.get(f"{name}_MODE") != FIXED:
            others.append(f"{name}_REF")
        # ArduPilot keeps the whole notch above zero
        frequency = max(value(f"{name}_FREQ", default=80.0), 0.52 * width)
        ratio = frequency / (frequency - 0.5 * width)
        depth = 10 ** (-value(f"{name}_ATT", default=40.0) / 20)
        of_all = Notch(frequency, ratio / (ratio**2 - 1), depth)
        harmonics = int(value(f"{name}_HMNCS", default=3.0))
        for k in range(16):
            if harmonics >> k & 1:
                notches.append(of_all._replace(frequency=(k + 1) * frequency))
    return notches, others


def _ardupilot_yaw_damper(
    value: Parameters, full: Mapping[str, float], unit: float, common: Mapping[str, Any]
) -> list[Loop]:
    """Return the yaw damper: the output is -DAMP (1 + INT / s) of the washed out rate."""
    damping = value("YAW2SRV_DAMP")
    integral = value("YAW2SRV_INT")
    turn = value("YAW2SRV_RLL")
    if not damping:
        return []
    return [
        Loop(
            name="yaw",
            control="rudder",
            full=full["rudder"],
            P=unit * damping,
            I=unit * damping * integral,
            washout=WASHOUT * value("SCHED_LOOP_RATE"),
            coordination=turn,
            turn_airspeeds=(value("AIRSPEED_MIN", "ARSPD_FBW_MIN"), np.inf),
            parameters={"YAW2SRV_DAMP": damping},
            **common,
        )
    ]


def _loop(
    name: str,
    prefix: str,
    unit: float,
    value: Parameters,
    full: Mapping[str, float],
    **settings: Any,
) -> list[Loop]:
    """Return the loop of an axis, or none without gains."""
    control = LOOP_AXES[name][2]
    values = {gain: value(f"{prefix}_{gain}") for gain in GAINS}
    if not value(f"{prefix}_IMAX"):
        values["I"] = 0.0
    if not any(values.values()):
        return []
    named = {f"{prefix}_{gain}": values[gain] for gain in GAINS if values[gain]}
    gains: dict[str, Any] = {gain: unit * values[gain] for gain in GAINS}
    return [
        Loop(name=name, control=control, full=full[control], parameters=named, **gains, **settings)
    ]
