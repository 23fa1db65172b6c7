"""Telemetry logs: what was sent is read like a log of the autopilot itself."""

import struct
import sys

import numpy as np
import pandas as pd
import pytest

from skdgp.io import FlightReadError, read_flight

OFFSET = 1.7e9  # Arrival less the clock of the vehicle [s]


@pytest.fixture(scope="module")
def tlog(flight):
    """Telemetry of a plane with ArduPilot: arrival late by up to .2 s, and a ground station that sends too."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    plane, station = (
        mavlink.MAVLink(None, srcSystem=1, srcComponent=1),
        mavlink.MAVLink(None, srcSystem=255),
    )
    rng, sent = np.random.default_rng(0), []

    def send(time, message, by=plane):
        sent.append((time, message.pack(by)))

    for name, value in (
        ("AIRSPEED_MIN", 12.0),
        ("SERVO2_FUNCTION", 19.0),
        ("SERVO4_FUNCTION", 21.0),
    ):
        send(flight.BEGIN, mavlink.MAVLink_param_value_message(name.encode(), value, 9, 3, 0))
    for t in flight.time(1):
        send(t, mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 0, 3))
        send(t, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3), station)
    for t in flight.time(10):
        ms, at = round(t * 1e3), {name: float(flight[name](t)) for name in flight.SIZES}
        angles, rates = (at["phi"], at["theta"], at["psi"]), (at["p"], at["q"], at["r"])
        send(t, mavlink.MAVLink_attitude_message(ms, *angles, *rates))
        speed = [round(100 * at[name]) for name in ("v_north", "v_east", "v_down")]
        send(
            t,
            mavlink.MAVLink_global_position_int_message(
                ms, 0, 0, round(1e3 * at["altitude"]), 0, *speed, 0
            ),
        )
        force = [round(1e3 * at[name] / 9.80665) for name in ("ax", "ay", "az")]
        gyro = [round(1e3 * rate) for rate in rates]
        send(t, mavlink.MAVLink_raw_imu_message(round(t * 1e6), *force, *gyro, 0, 0, 0))
        equivalent = at["airspeed"] * np.sqrt(at["density"] / 1.225)
        send(
            t, mavlink.MAVLink_vfr_hud_message(equivalent, 0, 0, round(100 * at["throttle"]), 0, 0)
        )
        pressure = 1013.25 * (at["density"] / 1.225) ** (1 / (1 - 1 / 5.25588))
        send(t, mavlink.MAVLink_scaled_pressure_message(ms, pressure, 0, 0))
        pulses = [
            1500,
            round(1500 - 1000 * at["elevator"]),
            1100,
            round(1500 - 1000 * at["rudder"]),
        ]
        send(t, mavlink.MAVLink_servo_output_raw_message(round(t * 1e6), 0, *pulses, *[1500] * 4))
    sent.sort(key=lambda each: each[0])
    arrivals = np.maximum.accumulate([OFFSET + time + rng.uniform(0, 0.2) for time, _ in sent])
    return [
        struct.pack(">Q", round(1e6 * at)) + message
        for at, (_, message) in zip(arrivals, sent, strict=True)
    ]


class TestTelemetry:
    def test_what_was_sent_is_read(self, tlog, tmp_path, flight):
        (tmp_path / "sortie.tlog").write_bytes(b"".join(tlog))
        table = read_flight(tmp_path / "sortie.tlog", servos="full throw")
        assert table.flight.unique().tolist() == ["sortie"]
        time = table["time"].to_numpy()
        for name, error in (
            ("p", 2e-3),
            ("az", 2e-2),
            ("phi", 2e-3),
            ("v_east", 2e-2),
            ("altitude", 0.1),
            ("density", 2e-3),
        ):
            np.testing.assert_allclose(table[name], flight[name](time), atol=error)
        np.testing.assert_allclose(table["elevator"], flight["elevator"](time) / 0.4, atol=5e-3)
        np.testing.assert_allclose(
            table["airspeed"], flight["airspeed"](time), atol=0.3
        )  # it has no clock but arrival
        assert abs(np.mean(table["airspeed"] - flight["airspeed"](time))) < 0.05

    def test_arrival_in_bursts_changes_nothing(self, tlog, tmp_path):
        """A slow link delivers what was sent within four seconds at once."""
        arrival = [struct.unpack(">Q", each[:8])[0] for each in tlog]
        late = [struct.pack(">Q", (stamp // 4_000_000 + 1) * 4_000_000) for stamp in arrival]
        bursts = [stamp + each[8:] for stamp, each in zip(late, tlog, strict=True)]
        tables = []
        for name, content in (("a", tlog), ("b", bursts)):
            (tmp_path / f"{name}.tlog").write_bytes(b"".join(content))
            tables.append(read_flight(tmp_path / f"{name}.tlog", flight="sortie"))
        pd.testing.assert_frame_equal(*tables)
        assert tables[0]["airspeed"].notna().all()

    def test_damage_costs_only_itself(self, tlog, tmp_path):
        (tmp_path / "whole.tlog").write_bytes(b"".join(tlog))
        (tmp_path / "cut.tlog").write_bytes(
            b"".join([*tlog[:600], b"\xfd\x09 what is no message", *tlog[600:-3], tlog[-3][:9]])
        )
        with pytest.warns(UserWarning, match="bytes could not be read and were skipped"):
            damaged = read_flight(tmp_path / "cut.tlog")
        assert len(damaged) > 0.95 * len(read_flight(tmp_path / "whole.tlog"))

    def test_no_telemetry(self, tmp_path):
        pytest.importorskip("pymavlink")
        for content in (b"", b"text", bytes(1000)):
            (tmp_path / "a.tlog").write_bytes(content)
            with pytest.raises(FlightReadError, match="without a message ATTITUDE"):
                read_flight(tmp_path / "a.tlog")


def test_without_its_extra(tlog, tmp_path, monkeypatch):
    (tmp_path / "sortie.tlog").write_bytes(b"".join(tlog))
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[logs\]'"):
        read_flight(tmp_path / "sortie.tlog")
