"""Templates of servo files, from the outputs and parameters of a log."""

from __future__ import annotations

import math

from skdgp.io._autopilot.topics import Log
from skdgp.io._errors import FlightReadError

# ArduPilot: SERVOn_FUNCTION, and whether more of the command turns the surface the other way than the house's sign.
ARDUPILOT_FUNCTIONS = {
    4: ("aileron", False), 19: ("elevator", True), 21: ("rudder", True),
    77: ("elevon_left", True), 78: ("elevon_right", True),
}  # fmt: skip
PX4_CONTROLS = {"aileron": (0, False), "elevator": (1, True), "rudder": (2, True)}
PX4_SURFACES = {1: "aileron", 3: "elevator", 4: "rudder", 5: "elevon_left", 6: "elevon_right"}
"""CA_SV_CSn_TYPE."""

TEMPLATE = """\
# Angles of the surfaces: fill in each deflection [rad], the angle at max, measured at the surface.
# elevator and elevons > 0: trailing edge down. aileron > 0: rolls right. rudder > 0: yaws left.
# Signs follow the autopilot's own: move each stick, look, and set reversed where the sign above does not hold.
# Instead of min, trim, max, deflection: points = [[1100, -0.35], [1500, 0.0], [1900, 0.30]].
"""


def template(log: Log) -> str:
    """Return a calibration file for a log, with everything but the angles.

    Raises
    ------
    FlightReadError
        If the log holds nothing that was sent to servos.
    """
    entries = _ardupilot_entries(log) if log.kind == "ArduPilot DataFlash" else _px4_entries(log)
    if not entries:
        raise FlightReadError(
            "Got a log without servo outputs (RCOU; actuator_outputs, actuator_servos or actuator_controls_0), but "
            "expected one of them: log it, or write the servo file by hand."
        )
    return TEMPLATE + "".join(f"\n[{name}]\n{_toml(entry)}" for name, entry in entries.items())


def _toml(entry):
    words = {True: "true", False: "false"}
    lines = {
        key: words[value] if isinstance(value, bool) else value for key, value in entry.items() if key != "channel"
    }
    return f'channel = "{entry["channel"]}"\n' + "".join(
        f"{key} = {value if isinstance(value, str) else format(value, 'g')}\n" for key, value in lines.items()
    )


def _entry(channel, low, trim, high, turned):
    return {"channel": channel, "min": low, "trim": trim, "max": high, "deflection": math.nan, "reversed": turned}


def _ardupilot_entries(log):
    found, outputs = {}, log.topics.get("RCOU")
    for n in range(1, 15):
        surface, turned = ARDUPILOT_FUNCTIONS.get(log.setting(f"SERVO{n}_FUNCTION"), (None, False))
        if surface is not None and surface not in found and outputs is not None and f"C{n}" in outputs:
            low, trim, high, back = (
                log.parameters.get(f"SERVO{n}_{key}", usual)
                for key, usual in (("MIN", 1100), ("TRIM", 1500), ("MAX", 1900), ("REVERSED", 0))
            )
            found[surface] = _entry(f"RCOU.C{n}", low, trim, high, turned != bool(back))
    return found


def _px4_entries(log):
    servos = log.topics.get("actuator_servos")
    if servos is not None:
        found = {}
        for n in range(8):
            surface = PX4_SURFACES.get(log.setting(f"CA_SV_CS{n}_TYPE"))
            if surface is not None and surface not in found and f"control[{n}]" in servos:
                found[surface] = _entry(f"actuator_servos.control[{n}]", -1, 0, 1, False)
        if found:
            return found
    name = "actuator_controls_1" if "actuator_controls_1" in log.topics else "actuator_controls_0"  # 1: a VTOL's wings
    if name not in log.topics or "control[2]" not in log.topics[name]:
        return {}
    return {surface: _entry(f"{name}.control[{n}]", -1, 0, 1, turned) for surface, (n, turned) in PX4_CONTROLS.items()}
