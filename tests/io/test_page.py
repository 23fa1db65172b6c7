"""The page logs.md: its code runs on a log that is laid ready, and its table is that of the rules."""

import re
from pathlib import Path

from skdgp.io._servos import read_servos

PAGE = (Path(__file__).parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.DOTALL | re.MULTILINE)


def test_the_code_runs(tmp_path, monkeypatch, ulog, flight):
    t = flight.time(50)
    log = ulog(MAV_TYPE=1)
    for name, field, columns in (
        ("vehicle_angular_velocity", "xyz", "pqr"),
        ("vehicle_acceleration", "xyz", ("ax", "ay", "az")),
        ("actuator_controls_0", "control", ("aileron", "elevator", "rudder", "throttle")),
    ):
        log.topic(name, t, **{field: (f"float[{len(columns)}]", flight.at(t, *columns))})
    log.topic("airspeed", t, true_airspeed_m_s=("float", flight["airspeed"](t)))
    log.topic("vehicle_air_data", t, rho=("float", flight["density"](t)))
    log.topic("rpm", t, indicated_frequency_rpm=("float", flight["propeller_speed"](t)))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sortie.ulg").write_bytes(bytes(log))
    names = {}
    for block in blocks("python"):
        exec(compile(block, "logs.md", "exec"), names)


def test_the_servo_file_is_one(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "servo.toml").write_text(text)
    servos = read_servos(tmp_path / "servo.toml")
    assert servos["elevator"].angles == (0.35, 0.0, -0.35)
    assert servos["aileron"].channel == "actuator_outputs.output[0]"
