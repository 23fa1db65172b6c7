"""Telemetry logs: what was sent is read like a log of the autopilot itself."""

import math
import struct
import sys

import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from skdgp.io import FlightReadError
from skdgp.preprocessing import FlightDataWarning

# Largest errors of what has a clock of its own
ERRORS = {"p": 2e-3, "az": 2e-2, "phi": 2e-3, "v_east": 2e-2, "altitude": 0.1, "density": 2e-3}


def test_what_was_sent_is_read(tlog, read, flight):
    table = read(b"".join(tlog), "sortie.tlog", servos="full throw")
    assert table.flight.unique().tolist() == ["sortie"]
    time = table["time"].to_numpy()
    for name, atol in ERRORS.items():
        assert_allclose(table[name], flight[name](time), atol=atol)
    assert_allclose(table["elevator"], flight["elevator"](time) / 0.4, atol=5e-3)
    error = table["airspeed"] - flight["airspeed"](time)  # it has no clock but arrival
    assert error.abs().max() < 0.3
    assert abs(error.mean()) < 0.05


def test_arrival_in_bursts_changes_nothing(tlog, read):
    """A slow link delivers what was sent within four seconds at once."""
    bursts = []
    for message in tlog:
        (stamp,) = struct.unpack(">Q", message[:8])
        late = (stamp // 4_000_000 + 1) * 4_000_000
        bursts.append(struct.pack(">Q", late) + message[8:])
    table = read(b"".join(tlog), "log.tlog")
    assert_frame_equal(read(b"".join(bursts), "log.tlog"), table)
    assert table["airspeed"].notna().all()


def test_damage_costs_only_itself(tlog, read):
    damaged = [*tlog[:600], b"\xfd\x09 what is no message", *tlog[600:-3], tlog[-3][:9]]
    with pytest.warns(UserWarning, match="bytes could not be read and were skipped"):
        table = read(b"".join(damaged), "log.tlog")
    assert len(table) > 0.95 * len(read(b"".join(tlog), "log.tlog"))


def test_a_vehicle_that_was_never_armed(tlog, read):
    """Its heartbeats are left out, and one without the flag (128) follows each attitude."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 1, 0, 0, 3)
    disarmed = beat.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))
    messages = [message for message in tlog if not is_of(message, mavlink.MAVLINK_MSG_ID_HEARTBEAT)]
    attitudes = [m for m in messages if is_of(m, mavlink.MAVLINK_MSG_ID_ATTITUDE)]
    log = messages + [message[:8] + disarmed for message in attitudes]
    with pytest.warns(FlightDataWarning, match="never armed: HEARTBEAT.armed is never 1, but"):
        read(b"".join(log), "log.tlog")


def test_of_two_vehicles_one_is_read(tlog, read):
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    attitude = mavlink.MAVLink_attitude_message(15000, 0, 0, 0, 0, 0, 0)
    second = attitude.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1))
    log = [*tlog, tlog[-1][:8] + second]
    with pytest.warns(FlightDataWarning, match=r"vehicles \[1, 7\] number 1 is read"):
        table = read(b"".join(log), "log.tlog")
    assert_frame_equal(table, read(b"".join(tlog), "log.tlog"))


@pytest.mark.parametrize("told_by", ["state", "motors", "mode"])
def test_a_vtol_is_read_in_forward_flight_alone(tlog, read, told_by):
    """It hovers until 20 s, by MAV_VTOL_STATE, the pulse of a motor that lifts, or QHOVER, number 18."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    plane = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    log = []
    parameters = {} if told_by == "state" else {b"Q_ENABLE": 1.0}
    if told_by == "motors":
        parameters[b"SERVO5_FUNCTION"] = 33.0
    hovers = True
    for name, value in parameters.items():
        message = mavlink.MAVLink_param_value_message(name, value, 9, 2, 0)
        log.append(tlog[0][:8] + message.pack(plane))
    for message in tlog:
        is_output = is_of(message, mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
        if is_output:
            sent = plane.decode(bytearray(message[8:]))
            hovers = sent.time_usec < 20e6
            state = mavlink.MAVLink_extended_sys_state_message(3 if hovers else 4, 2)
            pulse = 1600 if hovers else 1000
            pulses = [sent.servo1_raw, sent.servo2_raw, sent.servo3_raw, sent.servo4_raw, pulse]
            output = (sent.time_usec, 0, *pulses, 1500, 1500, 1500)
            if told_by == "motors":
                message = message[:8] + mavlink.MAVLink_servo_output_raw_message(*output).pack(
                    plane
                )
            elif told_by == "state":
                log.append(message[:8] + state.pack(plane))
            else:
                mode = 18 if hovers else 5
                beat = mavlink.MAVLink_heartbeat_message(1, 3, 128, mode, 4, 3)
                log.append(message[:8] + beat.pack(plane))
        is_beat = is_of(message, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        if not (is_beat and told_by == "mode"):
            log.append(message)
    with pytest.warns(FlightDataWarning, match="rotors lift"):
        table = read(b"".join(log), "log.tlog")
    assert 19.8 < table.time.min() < 20.5


def test_a_dead_inertial_sensor_gives_way_to_the_second(tlog, read):
    """Of SCALED_IMU nothing moves; RAW_IMU is left out."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    plane = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    log = []
    for message in tlog:
        if is_of(message, mavlink.MAVLINK_MSG_ID_ATTITUDE):
            time = plane.decode(bytearray(message[8:])).time_boot_ms
            for kind, rate in (("scaled_imu", 0), ("scaled_imu2", 100 + time % 7)):
                sent = getattr(mavlink, f"MAVLink_{kind}_message")
                values = [0, 0, -1000, rate, rate, rate, 0, 0, 0]
                log.append(message[:8] + sent(time, *values).pack(plane))
        if not is_of(message, mavlink.MAVLINK_MSG_ID_RAW_IMU):
            log.append(message)
    with pytest.warns(FlightDataWarning, match="SCALED_IMU2"):
        table = read(b"".join(log), "log.tlog")
    assert table.p.dropna().between(0.1, 0.106).all()


def test_engines_by_their_controllers(tlog, read):
    """Arrays of four; the second two are none."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    plane = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    rpm = [6000, 6000, 0, 0]
    four = [1] * 4
    log = []
    for message in tlog:
        if is_of(message, mavlink.MAVLINK_MSG_ID_ATTITUDE):
            sent = mavlink.MAVLink_esc_telemetry_1_to_4_message(four, four, four, four, rpm, four)
            log.append(message[:8] + sent.pack(plane))
        log.append(message)
    table = read(b"".join(log), "log.tlog")
    assert_allclose(table.propeller_speed.dropna(), 200 * math.pi, rtol=1e-6)


def is_of(message, number):
    """Return whether a stamped message of MAVLink 2 is of a type."""
    return int.from_bytes(message[15:18], "little") == number


@pytest.mark.parametrize("content", [b"", b"text", bytes(1000)])
def test_no_telemetry(content, read):
    pytest.importorskip("pymavlink")
    with pytest.raises(FlightReadError, match="without a message ATTITUDE"):
        read(content, "log.tlog")


def test_without_its_extra(tlog, read, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[logs\]'"):
        read(b"".join(tlog), "log.tlog")
