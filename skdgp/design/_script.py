"""The script that ArduPilot flies a plan with."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.excitation import ROUNDING, Steps, Wavetrain
from skdgp._flight.servo_functions import TURNED, ServoFunction
from skdgp._flight.tables import check_full_deflections, check_number

SCRIPT = Path(__file__).with_name("replay.lua")


# ArduPilot's functions of servos
ARDUPILOT = {
    "elevator": ServoFunction.ELEVATOR,
    "aileron": ServoFunction.AILERON,
    "rudder": ServoFunction.RUDDER,
    "throttle": ServoFunction.THROTTLE,
    "elevon_left": ServoFunction.ELEVON_LEFT,
    "elevon_right": ServoFunction.ELEVON_RIGHT,
    "vtail_left": ServoFunction.VTAIL_LEFT,
    "vtail_right": ServoFunction.VTAIL_RIGHT,
}
# Surfaces that several axes move
MIXES = {
    "elevon_left": {"elevator": 1.0, "aileron": 1.0},
    "elevon_right": {"elevator": 1.0, "aileron": -1.0},
    "vtail_left": {"elevator": 1.0, "rudder": 1.0},
    "vtail_right": {"elevator": 1.0, "rudder": -1.0},
}
# RCn_OPTION of the switch, Scripting1: most others act on the aircraft
SWITCH = 300


def ardupilot_script(train: Wavetrain, rate: float, full: Mapping[str, float]) -> str:
    """Return a Lua script for ArduPilot that adds inputs to the autopilot's commands while a switch is high.

    The switch of the transmitter has the RCn_OPTION 300, Scripting1.

    The script holds the signals as formulas, not as samples: some kilobytes for any duration. It
    keeps the limits of the axes at every step, also where steps come late. The inputs end at once
    when the switch is low or the aircraft is disarmed, and the autopilot's own commands return
    within five steps if the script stops. It logs them (PLAN). Write it to a file such as
    ``plan.lua`` in ``APM/scripts`` of the autopilot's card and set SCR_ENABLE to 1.

    Parameters
    ----------
    train : Wavetrain
        Of elevator, aileron, rudder, throttle, or of the elevons.
    rate : float
        At which the script runs [Hz].
    full : mapping of str to float
        The surfaces the aircraft has (SERVOn_FUNCTION), each with its deflection at the end of the
        servo's range [rad]. ``elevon_left`` and ``elevon_right`` move with elevator and aileron,
        ``vtail_left`` and ``vtail_right`` with elevator and rudder. The throttle needs none.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the rate is above 1000 Hz, an axis moves none of the surfaces,
        ArduPilot has no servo function for one, a full deflection is no number > 0 or smaller than
        the inputs of the surface, or as of `Wavetrain.table`.

    Examples
    --------
    >>> from skdgp.design import Wavetrain, ardupilot_script, doublet
    >>> script = ardupilot_script(Wavetrain({"elevator": {1.0: doublet(0.5, 0.05)}}), 50.0, {"elevator": 0.4})
    >>> "SRV_Channels" in script
    True
    """
    if not check_number("rate", rate, unit="Hz") <= 1000.0:
        raise ValueError(f"Got rate={rate:g} Hz, but expected at most 1000 Hz.")
    full = dict(full)
    if "throttle" in train.inputs:
        full["throttle"] = 1.0
    mixes = surface_mixes(list(train.inputs), full)
    _check_room(train.table(rate), mixes, full)
    plan = {
        "switch": SWITCH,
        "period": int(1000.0 / rate),  # ArduPilot counts milliseconds
        "duration": train.duration,
        "labels": ",".join(["t", *train.inputs]),
        "format": "f" * (1 + len(train.inputs)),
        "axes": [_axis(train, axis) for axis in train.inputs],
        "surfaces": [_surface(name, full[name], mix, train.inputs) for name, mix in mixes.items()],
    }
    return SCRIPT.read_text(encoding="utf-8").replace("--[[PLAN]]", _lua(plan))


def surface_mixes(axes: Sequence[str], full: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the gains of the axes that move each surface of ArduPilot; raise ValueError as `ardupilot_script`."""
    check_full_deflections(full, ARDUPILOT)
    mixes = {}
    still = dict.fromkeys(axes)
    for name in full:
        gains = MIXES.get(name, {name: 1.0})
        mix = {axis: gain for axis, gain in gains.items() if axis in axes}
        if mix:
            mixes[name] = mix
        for axis in mix:
            still.pop(axis, None)
    if still:
        raise ValueError(
            f"Got full deflections of {list(full)}, but expected also those of surfaces that move "
            f"with the {' and the '.join(still)}: add them."
        )
    return mixes


def _check_room(table: pd.DataFrame, mixes: Mapping, full: Mapping[str, float]) -> None:
    """Raise ValueError if a full deflection is smaller than the inputs of a surface."""
    for name, mix in mixes.items():
        gains = pd.Series(mix)
        peak = (table[gains.index] @ gains).abs().max()
        if not peak <= full[name] * (1.0 + ROUNDING):
            raise ValueError(
                f"Got inputs of the {name} up to {peak:.4g}, but its full deflection is "
                f"{full[name]:g}: make them smaller."
            )


def _axis(train: Wavetrain, axis: str) -> dict[str, Any]:
    """Return the inputs of an axis for the script."""
    signals = []
    for start, signal in train.inputs[axis].items():
        numbers = {"start": start, "kind": type(signal).__name__, "duration": signal.duration}
        if isinstance(signal, Steps):
            numbers["edges"] = signal.edges.tolist()
            numbers["swings"] = np.diff([0.0, *signal.levels, 0.0]).tolist()
        else:
            numbers |= vars(signal)
        signals.append(numbers)
    amplitude = train.limits.get(axis, 1e30)  # no limit
    return {"name": axis, "amplitude": amplitude, "signals": signals}


def _surface(
    name: str, full: float, mix: Mapping[str, float], axes: Iterable[str]
) -> dict[str, Any]:
    """Return the commands of a surface for the script."""
    function = ARDUPILOT[name]
    is_throttle = name == "throttle"
    return {
        "name": name,
        "servo": function,
        "full": -full if function in TURNED else full,
        "range": is_throttle,  # from 0 to 1, not from -1 to 1
        "scale": 100.0 if is_throttle else 4500.0,  # percent, centidegrees of a range of 45 degrees
        "parts": [mix.get(axis, 0.0) for axis in axes],
    }


def _lua(value: Any) -> str:
    """Return a value as Lua writes it."""
    if isinstance(value, Mapping):
        items = [f"{name} = {_lua(item)}" for name, item in value.items()]
    elif isinstance(value, list | tuple):
        items = [_lua(item) for item in value]
    else:
        return json.dumps(value)
    return "{" + ", ".join(items) + "}"
