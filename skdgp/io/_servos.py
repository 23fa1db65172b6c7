"""Servo files (TOML): pulse widths to surface angles; mixing by the autopilot's parameters."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.files import read_toml
from skdgp._flight.channels import ALL_SURFACES
from skdgp.io._log import Control, Log, Servo
from skdgp.io._tables import FlightReadError

MOVED = (*ALL_SURFACES, "throttle")
KEYS = {"channel", "points"}
# What stands for a servo file where none is at hand: surfaces in parts of their full throw, -1 to
# 1; with ", reversed rudder" after it, some of the other sign than the autopilot's parameters say
FULL_THROW = "full throw"
REVERSED = ", reversed "
THROW = re.compile(r"(\d+\.?\d*|\.\d+) ?(deg|rad)")


def read_servos(
    servos: str | Path | Mapping[str, Any] | None,
) -> dict[str, Servo | float]:
    r"""Return a calibration, one entry for each surface, from a TOML file or a mapping.

    ``[elevator]`` has ``channel`` and ``points``, a list of pairs (value of the channel, angle in
    rad), with straight lines between them and beyond. Or in one line the angle at full throw [rad],
    ``elevator = "25 deg"``, of the servos that the autopilot's parameters name.

    Raises FlightReadError if the file is no TOML, or a surface or number makes no sense.

    Examples
    --------
    >>> read_servos({"rudder": {"channel": "RCOU.C4", "points": [[1100, -0.3], [1900, 0.3]]}})
    {'rudder': Servo(channel='RCOU.C4', inputs=(1100.0, 1900.0), angles=(-0.3, 0.3))}
    """
    if servos is None:
        return {}
    if isinstance(servos, (str, Path)):
        try:
            servos = read_toml(servos)
        except ValueError as error:
            raise FlightReadError(
                f"Got {servos} as the servo file, but expected TOML: {error}"
            ) from error
    return {name: _servo(name, entry) for name, entry in servos.items()}


def reversed_of(servos: Any) -> tuple[str, ...] | None:
    """Return the surfaces of other sign that servos in parts of the full throw have; None of a servo file.

    Raises FlightReadError if one is no surface.

    Examples
    --------
    >>> reversed_of("full throw, reversed rudder aileron"), reversed_of("full throw"), reversed_of("servo.toml")
    (('rudder', 'aileron'), (), None)
    """
    if not isinstance(servos, str) or servos.partition(REVERSED)[0] != FULL_THROW:
        return None
    names = servos.partition(REVERSED)[2].split()
    if strange := set(names) - set(ALL_SURFACES):
        raise FlightReadError(
            f"Got {sorted(strange)} as reversed, but expected some of {list(ALL_SURFACES)}."
        )
    return tuple(names)


def full_throws(log: Log, turned: Collection[str] = ()) -> dict[str, Control]:
    """Return the servos that the parameters of an autopilot name, -1 to 1 from end to end and 0 at trim.

    Surfaces in ``turned`` have the other sign. Where the parameters say how controls are mixed,
    these are elevator, aileron and rudder of any tail and wing. Raises FlightReadError if there are
    none.
    """
    if not log.controls:
        raise FlightReadError(
            f"Got outputs {[name for name in log.outputs if name in log.topics]} without "
            f"parameters that name their surfaces, but expected some of {list(log.outputs)}, and "
            f"SERVOn_FUNCTION of ArduPilot or CA_SV_CSn_TYPE of PX4, or controls before a fixed "
            f"mixer (actuator_controls_0): log them, or write the servo file by hand."
        )
    disordered = [
        f"{name} on {servo.channel} {servo.inputs}"
        for name, parts in log.controls.items()
        for _, servo in parts
        if list(servo.inputs) != sorted({*servo.inputs})
    ]
    if disordered:
        raise FlightReadError(
            f"Got min, trim, max of {', '.join(disordered)}, but expected them in this order: "
            f"write the servo file by hand."
        )
    return {
        name: tuple((-weight if name in turned else weight, servo) for weight, servo in parts)
        for name, parts in log.controls.items()
    }


def with_throws(servos: Mapping[str, Servo | float], log: Log) -> dict[str, Control]:
    """Return the servos, throws by the parameters of the autopilot; FlightReadError if these lack a servo."""
    throws = {name: entry for name, entry in servos.items() if isinstance(entry, float)}
    named = full_throws(log) if throws else {}
    if lacking := sorted(set(throws) - set(named)):
        raise FlightReadError(
            f"Got the full throw of {lacking}, but expected surfaces that the parameters of the "
            f"log name, "
            f"{sorted(named)}: give the channel of the others."
        )
    measured = {name: ((1.0, entry),) for name, entry in servos.items() if isinstance(entry, Servo)}
    return measured | {
        name: tuple((angle * weight, servo) for weight, servo in named[name])
        for name, angle in throws.items()
    }


def _servo(name, entry) -> Servo | float:
    if name not in MOVED:
        raise FlightReadError(f"Got {name!r} in the servo file, but expected one of {list(MOVED)}.")
    if isinstance(entry, str):
        return _throw(name, entry)
    if not isinstance(entry, dict) or not isinstance(entry.get("channel"), str):
        raise FlightReadError(
            f'Got {name} without a channel, but expected one, as in channel = "RCOU.C2".'
        )
    if set(entry) - KEYS:
        raise FlightReadError(
            f"Got {sorted(set(entry) - KEYS)} for {name}, but expected only {sorted(KEYS)}."
        )
    try:
        pairs = np.array(sorted([float(value), float(angle)] for value, angle in entry["points"]))
    except (KeyError, TypeError, ValueError, OverflowError):
        pairs = np.empty((0, 2))
    if len(pairs) < 2:
        raise FlightReadError(
            f"Got {entry} for {name}, but expected points, pairs of numbers (channel, angle) as in "
            f"[[1100, -0.35], [1900, 0.35]]."
        )
    if not np.isfinite(pairs).all() or (np.diff(pairs[:, 0]) <= 0).any():
        raise FlightReadError(
            f"Got {pairs.tolist()} (channel, angle) for {name}, but expected finite numbers, each "
            f"value of the channel once: measure the angle of the surface at these values, in rad."
        )
    if (most := np.abs(pairs[:, 1]).max()) > np.pi / 2:
        raise FlightReadError(
            f"Got angles up to {most:g} for {name}, but expected radians, at most pi/2: convert "
            f"degrees."
        )
    return Servo(entry["channel"], tuple(pairs[:, 0].tolist()), tuple(pairs[:, 1].tolist()))


def _throw(name, text) -> float:
    match = THROW.fullmatch(text.strip())
    angle = float(match[1]) * {"deg": np.pi / 180, "rad": 1.0}[match[2]] if match else np.nan
    if not 0 < angle <= np.pi / 2:
        raise FlightReadError(
            f"Got {name} = {text!r}, but expected the angle at full throw, up to 90 degrees, as "
            f'in {name} = "25 deg".'
        )
    return float(angle)
