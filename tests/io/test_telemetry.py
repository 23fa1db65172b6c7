"""Telemetry logs: what was sent is read like a log of the autopilot itself."""

import math
import struct
import sys

import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal


@pytest.fixture
def mavlink():
    return pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")


@pytest.fixture
def plane(mavlink):
    """Return the vehicle that sends the messages."""
    return mavlink.MAVLink(None, srcSystem=1, srcComponent=1)


@pytest.fixture
def at(plane):
    """Return a function to a message of the vehicle that arrives with another."""
    return lambda stamped, message: stamped[:8] + message.pack(plane)


@pytest.fixture
def is_of(mavlink):
    """Return a function that tells whether a stamped message is of a type, by its name."""

    def is_of(message, name):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        return int.from_bytes(message[15:18], "little") == number

    return is_of


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


def test_a_vehicle_that_was_never_armed(tlog, told, mavlink, at, is_of):
    """Its heartbeats are left out, and one without the flag (128) follows each attitude."""
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 1, 0, 0, 3)
    messages = [message for message in tlog if not is_of(message, "HEARTBEAT")]
    log = messages + [at(message, beat) for message in messages if is_of(message, "ATTITUDE")]
    told("never armed: HEARTBEAT.armed is never 1, but", b"".join(log), "log.tlog")


def test_of_two_vehicles_one_is_read(tlog, read, told, mavlink):
    attitude = mavlink.MAVLink_attitude_message(15000, 0, 0, 0, 0, 0, 0)
    second = attitude.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1))
    log = [*tlog, tlog[-1][:8] + second]
    table = told(r"vehicles \[1, 7\] number 1 is read", b"".join(log), "log.tlog")
    assert_frame_equal(table, read(b"".join(tlog), "log.tlog"))


def test_an_airspeed_without_a_sensor_is_no_measurement(tlog, read, mavlink, at, is_of):
    """From the middle on the sensor, number 16 of those that are present, is not healthy."""
    log = []
    for k, message in enumerate(tlog):
        if is_of(message, "HEARTBEAT"):
            health = 16 if k < len(tlog) / 2 else 0
            status = mavlink.MAVLink_sys_status_message(48, 48, health, *[0] * 10)
            log.append(at(message, status))
        log.append(message)
    table = read(b"".join(log), "log.tlog")
    assert table.airspeed[table.time < 25].notna().all()
    assert table.airspeed[table.time > 29].isna().all()


@pytest.mark.parametrize("told_by", ["state", "motors", "mode"])
def test_a_vtol_is_read_in_forward_flight_alone(tlog, told, mavlink, plane, at, is_of, told_by):
    """It hovers until 20 s, by MAV_VTOL_STATE, the pulse of a motor that lifts, or QHOVER, number 18."""
    parameters = {} if told_by == "state" else {b"Q_ENABLE": 1.0}
    if told_by == "motors":
        parameters[b"SERVO5_FUNCTION"] = 33.0
    log = []
    for name, value in parameters.items():
        log.append(at(tlog[0], mavlink.MAVLink_param_value_message(name, value, 9, 2, 0)))
    replaced = {"mode": "HEARTBEAT", "motors": "SERVO_OUTPUT_RAW"}.get(told_by)
    for message in tlog:
        if replaced is None or not is_of(message, replaced):
            log.append(message)
        if is_of(message, "SERVO_OUTPUT_RAW"):
            sent = plane.decode(bytearray(message[8:]))
            hovers = sent.time_usec < 20e6
            pulses = [sent.servo1_raw, sent.servo2_raw, sent.servo3_raw, sent.servo4_raw]
            pulses += [1600 if hovers else 1000, 1500, 1500, 1500]
            telling = {
                "state": mavlink.MAVLink_extended_sys_state_message(3 if hovers else 4, 2),
                "motors": mavlink.MAVLink_servo_output_raw_message(sent.time_usec, 0, *pulses),
                "mode": mavlink.MAVLink_heartbeat_message(1, 3, 128, 18 if hovers else 5, 4, 3),
            }
            log.append(at(message, telling[told_by]))
    table = told("rotors lift", b"".join(log), "log.tlog")
    assert 19.8 < table.time.min() < 20.5


def test_a_dead_inertial_sensor_gives_way_to_the_second(tlog, told, mavlink, plane, at, is_of):
    """Of SCALED_IMU nothing moves; RAW_IMU is left out."""
    log = []
    for message in tlog:
        if is_of(message, "ATTITUDE"):
            time = plane.decode(bytearray(message[8:])).time_boot_ms
            for kind, rate in (("scaled_imu", 0), ("scaled_imu2", 100 + time % 7)):
                values = [0, 0, -1000, rate, rate, rate, 0, 0, 0]
                log.append(at(message, getattr(mavlink, f"MAVLink_{kind}_message")(time, *values)))
        if not is_of(message, "RAW_IMU"):
            log.append(message)
    table = told("SCALED_IMU2", b"".join(log), "log.tlog")
    assert table.p.dropna().between(0.1, 0.106).all()


def test_engines_by_their_controllers(tlog, read, mavlink, at, is_of):
    """Arrays of four; the second two are none."""
    four = [1] * 4
    rpm = [6000, 6000, 0, 0]
    sent = mavlink.MAVLink_esc_telemetry_1_to_4_message(four, four, four, four, rpm, four)
    log = []
    for message in tlog:
        log += [message, at(message, sent)] if is_of(message, "ATTITUDE") else [message]
    table = read(b"".join(log), "log.tlog")
    assert_allclose(table.propeller_speed.dropna(), 200 * math.pi, rtol=1e-6)


@pytest.mark.parametrize("content", [b"", b"text", bytes(1000)])
def test_no_telemetry(content, refused):
    pytest.importorskip("pymavlink")
    refused("without a message ATTITUDE", content, "log.tlog")


def test_without_its_extra(tlog, read, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[logs\]'"):
        read(b"".join(tlog), "log.tlog")
