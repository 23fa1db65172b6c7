"""Telemetry logs: what was sent is read like a log of the autopilot itself."""

import math
import struct

import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal


@pytest.fixture
def with_sent(mavlink, tlog, vehicle):
    """Return a function to the telemetry with further messages after each of a type, without those of another."""

    def is_of(message, name):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        return int.from_bytes(message[15:18], "little") == number

    def with_sent(name, further, without=None, given=tlog):
        log = []
        for message in given:
            if without is None or not is_of(message, without):
                log.append(message)
            if is_of(message, name):
                log += [message[:8] + sent.pack(vehicle) for sent in further(message)]
        return log

    return with_sent


# Largest errors of what has a clock of its own
ERRORS = {"p": 2e-3, "az": 2e-2, "phi": 2e-3, "v_east": 2e-2, "altitude": 0.1, "density": 2e-3}


def test_what_was_sent_is_read(tlog, read, flight):
    table = read(tlog, "sortie.tlog", servos="full throw")
    assert table.flight.unique().tolist() == ["sortie"]
    time = table["time"]
    for name, atol in ERRORS.items():
        assert_allclose(table[name], flight[name](time), atol=atol)
    assert_allclose(table["elevator"], flight["elevator"](time) / 0.4, atol=5e-3)
    error = table["airspeed"] - flight["airspeed"](time)  # it has no clock but arrival
    assert_allclose(error, 0.0, atol=0.3)
    assert_allclose(error.mean(), 0.0, atol=0.05)


def test_arrival_in_bursts_changes_nothing(tlog, read):
    """A slow link delivers what was sent within four seconds at once."""
    bursts = []
    for message in tlog:
        (stamp,) = struct.unpack(">Q", message[:8])
        late = struct.pack(">Q", (stamp // 4_000_000 + 1) * 4_000_000)
        bursts.append(late + message[8:])
    table = read(tlog)
    assert_frame_equal(read(bursts), table)
    assert table["airspeed"].notna().all()


def test_damage_costs_only_itself(tlog, read):
    damaged = [*tlog[:600], b"\xfd\x09 what is no message", *tlog[600:-3], tlog[-3][:9]]
    with pytest.warns(UserWarning, match="bytes could not be read and were skipped"):
        table = read(damaged)
    assert len(table) > 0.95 * len(read(tlog))


def test_of_two_vehicles_one_is_read(tlog, read, told, mavlink):
    attitude = mavlink.MAVLink_attitude_message(15000, 0, 0, 0, 0, 0, 0)
    second = attitude.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1))
    log = [*tlog, tlog[-1][:8] + second]
    assert_frame_equal(told(r"vehicles \[1, 7\] number 1 is read", log), read(tlog))


def test_an_airspeed_without_a_sensor_is_no_measurement(tlog, read, mavlink, with_sent):
    """From the middle on the sensor, number 16 of those that are present, is not healthy."""
    early = {*tlog[: len(tlog) // 2]}

    def status(beat):
        health = 16 if beat in early else 0
        return [mavlink.MAVLink_sys_status_message(48, 48, health, *[0] * 10)]

    table = read(with_sent("HEARTBEAT", status))
    assert table.airspeed[table.time < 25].notna().all()
    assert table.airspeed[table.time > 29].isna().all()


@pytest.mark.parametrize("told_by", ["state", "mode", "tailsitter"])
def test_a_vtol_is_read_in_forward_flight_alone(
    told, mavlink, vehicle, mavlink_parameters, with_sent, told_by
):
    """It hovers until 20 s, by MAV_VTOL_STATE, or by QHOVER (18), also of MAV_TYPE 20."""

    def telling(message):
        hovers = vehicle.decode(bytearray(message[8:])).time_usec < 20e6
        if told_by == "state":
            return [mavlink.MAVLink_extended_sys_state_message(3 if hovers else 4, 2)]
        kind = 20 if told_by == "tailsitter" else 1
        return [mavlink.MAVLink_heartbeat_message(kind, 3, 128, 18 if hovers else 5, 4, 3)]

    given = mavlink_parameters({b"Q_ENABLE": 1.0} if told_by == "mode" else {})
    replaced = None if told_by == "state" else "HEARTBEAT"
    table = told("rotors lift", with_sent("SERVO_OUTPUT_RAW", telling, replaced, given))
    assert 19.8 < table.time.min() < 20.5


def test_engines_by_their_controllers(read, mavlink, with_sent):
    """Arrays of four; the second two are none."""
    four = [1] * 4
    rpm = [6000, 6000, 0, 0]
    sent = mavlink.MAVLink_esc_telemetry_1_to_4_message(four, four, four, four, rpm, four)
    table = read(with_sent("ATTITUDE", lambda _: [sent]))
    assert_allclose(table.propeller_speed.dropna(), 200 * math.pi, rtol=1e-6)


def test_a_dead_inertial_sensor_gives_way_to_the_second(told, mavlink, vehicle, with_sent):
    """Of SCALED_IMU nothing moves; RAW_IMU is left out."""

    def sensors(message):
        time = vehicle.decode(bytearray(message[8:])).time_boot_ms
        rates = [100 + time % 7] * 3
        still = mavlink.MAVLink_scaled_imu_message(time, 0, 0, -1000, *[0] * 6)
        moving = mavlink.MAVLink_scaled_imu2_message(time, 0, 0, -1000, *rates, 0, 0, 0)
        return [still, moving]

    table = told("SCALED_IMU2", with_sent("ATTITUDE", sensors, without="RAW_IMU"))
    assert table.p.dropna().between(0.1, 0.106).all()
