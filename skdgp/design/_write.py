"""Files of planned inputs: tables, and a script that ArduPilot runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import csv_writer, text_writer, write_atomically
from skdgp._excitation import ROUNDING, UNLIMITED, Chirp, Multisine, Signal, Steps, Wavetrain
from skdgp._flight.checks import check_names

SCRIPT = Path(__file__).with_name("replay.lua")
PX4 = {"aileron": ("xyz[0]", 1.0), "elevator": ("xyz[1]", -1.0), "rudder": ("xyz[2]", -1.0)}
"""Component of vehicle_torque_setpoint, and sign: PX4's positive commands roll right, pitch up, yaw
right.
"""
ARDUPILOT = {
    "elevator": (19, -1.0), "aileron": (4, 1.0), "rudder": (21, -1.0), "throttle": (70, 1.0),
    "elevon_left": (77, -1.0), "elevon_right": (78, -1.0), "vtail_left": (79, -1.0), "vtail_right": (80, -1.0),
    "flaperon_left": (24, 1.0), "flaperon_right": (25, -1.0),
}  # fmt: skip
"""SERVOn_FUNCTION and sign: ArduPilot's positive commands raise the nose, roll and yaw right, move elevons and halves
of a V-tail up. Flaperons roll right, flaps lower the left and raise the right command; later
versions turn the left one (ArduPlane/servos.cpp), which the script sees by the command of the
ailerons."""
MIXES = {
    "elevon_left": {"elevator": 1.0, "aileron": 1.0}, "elevon_right": {"elevator": 1.0, "aileron": -1.0},
    "vtail_left": {"elevator": 1.0, "rudder": 1.0}, "vtail_right": {"elevator": 1.0, "rudder": -1.0},
    "flaperon_left": {"aileron": 1.0}, "flaperon_right": {"aileron": -1.0},
}  # fmt: skip
"""Surfaces that several axes move."""
THROTTLE_SCALE, SURFACE_SCALE = 100.0, 4500.0
"""ArduPilot's scaled commands at full deflection: per cent, and centidegrees of a range of 45."""
NO_LIMIT = 1e30
FASTEST = 1000.0
"""Rate of a script [Hz]: ArduPilot counts milliseconds."""
SWITCHES = range(300, 308)
"""RCn_OPTION of Scripting1 to Scripting8: others act on the aircraft."""


def write_csv(
    path: str | os.PathLike[str],
    train: Wavetrain,
    rate: float,
    *,
    trim: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Write `Wavetrain.table` as CSV, and return it: ``time`` [s] and the axes [rad, or 1 of the throttle].

    Parameters
    ----------
    path : path-like
    train : Wavetrain
    rate : float
        Of the autopilot [Hz].
    trim : mapping of str to float, optional
        Controls of trimmed flight, to which the inputs are added.

    Returns
    -------
    DataFrame

    Raises
    ------
    ValueError
        As of `Wavetrain.table`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.design import Wavetrain, doublet, write_csv
    >>> path = Path(tempfile.mkdtemp()) / "plan.csv"
    >>> table = write_csv(path, Wavetrain({"elevator": {0.2: doublet(0.5, 0.05)}}), rate=50.0)
    >>> path.read_text().splitlines()[:2]
    ['time,elevator', '0.0,0.0']
    """
    table = train.table(rate, trim=trim)
    write_atomically(path, csv_writer(table))
    return table


def write_px4(
    path: str | os.PathLike[str], train: Wavetrain, rate: float, full: Mapping[str, float]
) -> pd.DataFrame:
    """Write the inputs in the columns, units and signs of PX4's topic vehicle_torque_setpoint, and return the table.

    Torque setpoints are from -1 to 1 about x, y, z: positive rolls right, pitches up, yaws right.
    Those of the CSV file are to be added to the setpoints of the controllers.

    Parameters
    ----------
    path : path-like
    train : Wavetrain
        Of elevator, aileron and rudder.
    rate : float
        [Hz].
    full : mapping of str to float
        Deflection of each axis at a setpoint of 1 [rad].

    Returns
    -------
    DataFrame
        ``timestamp`` [us], ``xyz[0]``, ``xyz[1]``, ``xyz[2]``.

    Raises
    ------
    ValueError
        If an axis is none of these, a full deflection lacks, is not > 0 or smaller than an input,
        or as of `Wavetrain.table`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.design import Wavetrain, doublet, write_px4
    >>> train = Wavetrain({"elevator": {0.0: doublet(0.5, 0.1)}})
    >>> write_px4(Path(tempfile.mkdtemp()) / "plan.csv", train, 50.0, {"elevator": 0.4}).iloc[10]
    timestamp    200000.00
    xyz[0]            0.00
    xyz[1]           -0.25
    xyz[2]            0.00
    Name: 10, dtype: float64
    """
    check_names(train.axes, PX4, "axes of PX4's torque setpoint")
    moved = train.table(rate)
    _check_room(moved, _moved(train.axes, {axis: {axis: 1.0} for axis in full}, full), full)
    table = pd.DataFrame({"timestamp": (1e6 * moved["time"]).round().astype(np.int64)})
    for axis, (name, sign) in PX4.items():
        table[name] = sign * moved[axis] / full[axis] if axis in moved else 0.0
    write_atomically(path, csv_writer(table))
    return table


def write_ardupilot_lua(
    path: str | os.PathLike[str],
    train: Wavetrain,
    rate: float,
    full: Mapping[str, float],
    *,
    switch: int = 300,
) -> None:
    """Write a Lua script for ArduPilot that adds the inputs to the autopilot's commands while a switch is high.

    The script holds the signals as formulas, not as samples: some kilobytes for any duration. It
    keeps the limits of the axes at every step, also where steps come late. The inputs end at once
    when the switch is low or the aircraft is disarmed, and the autopilot's own commands return
    within five steps if the script stops. It logs them (PLAN).

    Parameters
    ----------
    path : path-like
        Such as ``plan.lua``; copy it to ``APM/scripts`` of the autopilot's card and set SCR_ENABLE
        to 1.
    train : Wavetrain
        Of elevator, aileron, rudder, throttle, or of the elevons.
    rate : float
        At which the script runs [Hz].
    full : mapping of str to float
        The surfaces the aircraft has (SERVOn_FUNCTION), each with its deflection at the end of the
        servo's range [rad]. ``elevon_left`` and ``elevon_right`` move with elevator and aileron,
        ``vtail_left`` and ``vtail_right`` with elevator and rudder, ``flaperon_left`` and
        ``flaperon_right`` with the aileron. The throttle needs none.
    switch : int, default=300
        RCn_OPTION of the switch of the transmitter, Scripting1 to Scripting8: 300 to 307.

    Raises
    ------
    ValueError
        If the rate is above 1000 Hz, the switch none of these, an axis moves none of the surfaces,
        ArduPilot has no servo function for one, a full deflection is no number > 0 or smaller than
        the inputs of the surface, a signal is none of this package, or as of `Wavetrain.table`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.design import Wavetrain, doublet, write_ardupilot_lua
    >>> path = Path(tempfile.mkdtemp()) / "plan.lua"
    >>> write_ardupilot_lua(path, Wavetrain({"elevator": {1.0: doublet(0.5, 0.05)}}), 50.0, {"elevator": 0.4})
    >>> "SRV_Channels" in path.read_text()
    True
    """
    write_atomically(path, text_writer(ardupilot_script(train, rate, full, switch)))


def ardupilot_script(
    train: Wavetrain, rate: float, full: Mapping[str, float], switch: int = 300
) -> str:
    """Return the text of the script that `write_ardupilot_lua` writes, with its errors.

    Parameters
    ----------
    train, rate, full, switch
        As for `write_ardupilot_lua`.

    Returns
    -------
    str
    """
    if not (rate <= FASTEST and switch in SWITCHES):
        raise ValueError(
            f"Got rate={rate:g} Hz and switch={switch!r}, but expected at most {FASTEST:g} Hz and "
            f"an RCn_OPTION of "
            f"{SWITCHES[0]} to {SWITCHES[-1]}."
        )
    full = dict(full) | ({"throttle": 1.0} if "throttle" in train.axes else {})
    mixes = surface_mixes(train.axes, full)
    _check_room(train.table(rate), mixes, full)
    axes = []
    for axis in train.axes:
        limit = train.limits.get(axis, UNLIMITED)
        signals = [
            _parts(signal) | {"start": start} for start, signal in train.inputs[axis].items()
        ]
        axes.append(
            {"name": axis, "amplitude": limit.amplitude, "rate": limit.rate, "signals": signals}
        )
    surfaces = []
    for name, mix in mixes.items():
        (servo, sign), scale = (
            ARDUPILOT[name],
            THROTTLE_SCALE if name == "throttle" else SURFACE_SCALE,
        )
        surfaces.append({
            "name": name, "servo": servo, "full": sign * full[name], "range": name == "throttle", "scale": scale,
            "parts": [mix.get(axis, 0.0) for axis in train.axes],
        })  # fmt: skip
    plan = {
        "switch": switch, "period": int(1000.0 / rate), "duration": train.duration,
        "labels": ",".join(["t", *train.axes]), "format": "f" * (1 + len(axes)), "axes": axes,
        "surfaces": surfaces,
    }  # fmt: skip
    return SCRIPT.read_text(encoding="utf-8").replace("--[[PLAN]]", _lua(plan))


def surface_mixes(axes: Sequence[str], full: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the gains of the axes that move each surface of ArduPilot; raise ValueError as `write_ardupilot_lua`."""
    check_names(full, ARDUPILOT, "servo functions of ArduPilot")
    return _moved(axes, {name: {name: 1.0} | MIXES.get(name, {}) for name in full}, full)


def _moved(
    axes: Sequence[str], gains: Mapping[str, Mapping[str, float]], full: Mapping[str, float]
) -> dict[str, dict[str, float]]:
    """Return the gains of those axes and surfaces that move; raise ValueError if an axis moves none."""
    for name, value in full.items():
        if not 0 < value < np.inf:
            raise ValueError(
                f"Got {value:g} as the full deflection of the {name}, but expected a number > 0: "
                f"give the deflection "
                "at the end of its servo's range."
            )
    mixes = {
        name: {axis: gain for axis, gain in mix.items() if axis in axes}
        for name, mix in gains.items()
    }
    if still := [axis for axis in axes if not any(axis in mix for mix in mixes.values())]:
        raise ValueError(
            f"Got full deflections of {list(full)}, but expected also those of surfaces that move "
            f"with the "
            f"{' and the '.join(still)}: add them."
        )
    return {name: mix for name, mix in mixes.items() if mix}


def _check_room(
    table: pd.DataFrame, mixes: Mapping[str, Mapping[str, float]], full: Mapping[str, float]
) -> None:
    """Raise ValueError if a full deflection is smaller than the inputs of a surface."""
    for name, mix in mixes.items():
        peak = np.abs(sum(gain * table[axis] for axis, gain in mix.items())).max()
        if not peak <= full[name] * (1.0 + ROUNDING):
            raise ValueError(
                f"Got inputs of the {name} up to {peak:.4g}, but its full deflection is "
                f"{full[name]:g}: make them "
                "smaller."
            )


def _parts(signal: Signal) -> dict[str, Any]:
    """Return what the script evaluates a signal from."""
    kind = {"kind": type(signal).__name__, "duration": signal.duration}
    if isinstance(signal, Steps):
        return kind | {
            name: getattr(signal, name).tolist() for name in ("edges", "swings", "ramps")
        }
    if isinstance(signal, Chirp | Multisine):
        return kind | vars(signal)
    raise ValueError(
        f"Got a {type(signal).__name__}, which the script does not know, but expected Steps, "
        f"Chirp or Multisine."
    )


def _lua(value: Any) -> str:
    """Return a value as Lua writes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {_lua(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "{" + ", ".join(map(_lua, value)) + "}"
    return json.dumps(min(value, NO_LIMIT) if isinstance(value, float) else value)
