"""Sensors in axes of the board and the airspeed of an untrusted tube: the table has axes and scale of the vehicle."""

import numpy as np
import pytest
from flight_columns import FORCES, RATES
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from skdgp.io import inspect_log

NAMES = [*RATES, *FORCES]
INERTIAL = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")
TRIM = {"AHRS_TRIM_X": 0.03, "AHRS_TRIM_Y": -0.05, "AHRS_TRIM_Z": 0.01}
ARSPD = {"I": ("B", 0), "H": ("B", 1)}


def measured(flight, time, to_body):
    """Return what sensors read that a rotation takes to body axes, (n, 6)."""
    rates, force = (flight.at(time, *names) for names in (RATES, FORCES))
    board = to_body.inv()
    return np.hstack([board.apply(rates), board.apply(force)])


def dataflash_log(dataflash, flight, to_body, **parameters):
    time = flight.time(50)
    log = dataflash("ArduPlane V4.5.1 (abcdef01)", AIRSPEED_MIN=12.0, **parameters)
    readings = zip(INERTIAL, measured(flight, time, to_body).T, strict=True)
    log.topic("IMU", time, I=("B", 0), **dict(readings))
    flight.log(log, "ATT", 50, factor=np.rad2deg(1.0), Roll="phi", Pitch="theta", Yaw="psi")
    return log


def assert_in_body_axes(table, flight):
    for name in NAMES:
        assert_allclose(table[name], flight[name](table["time"]), atol=5e-3)


@pytest.mark.parametrize("angles", [TRIM, dict.fromkeys(TRIM, 0.0)])
def test_ahrs_trim_turns_rates_and_accelerations(read, dataflash, flight, angles):
    """The rotation of the trim takes the board to the vehicle, whose attitude is logged (AP_AHRS)."""
    trim = Rotation.from_euler("ZYX", [*angles.values()][::-1])
    table = read(dataflash_log(dataflash, flight, trim, **angles), airborne=False)
    assert_in_body_axes(table, flight)
    _, _, said = table.attrs["sources"]["ax"].partition("AHRS_TRIM")
    assert said.startswith(" 0.03 -0.05 0.01") if angles is TRIM else not said


@pytest.mark.parametrize(
    ("place", "board"),  # yaw, pitch, roll
    [
        (0, (0, 0, 0)),
        (2, (90, 0, 0)),
        (8, (0, 0, 180)),
        (12, (0, 180, 0)),
        (14, (270, 0, 180)),
        (25, (0, 270, 0)),
    ],
)
def test_single_sensors_of_px4_are_turned_as_the_board_is(read, ulog, flight, place, board):
    """SENS_BOARD_ROT, and then the offsets in degrees; the numbers are those of ROTATION_* of PX4."""
    rotation = Rotation.from_euler("ZYX", board, degrees=True)
    offsets = {"SENS_BOARD_X_OFF": 1.5, "SENS_BOARD_Y_OFF": -2.0, "SENS_BOARD_Z_OFF": 3.0}
    to_body = Rotation.from_euler("ZYX", [3.0, -2.0, 1.5], degrees=True) * rotation
    time = flight.time(100)
    readings = measured(flight, time, to_body)
    log = ulog(MAV_TYPE=1, SENS_BOARD_ROT=place, **offsets)
    for topic, columns in (("sensor_gyro", readings[:, :3]), ("sensor_accel", readings[:, 3:])):
        log.topic(topic, time, **dict(zip("xyz", columns.T, strict=True)))
    assert_in_body_axes(read(log, airborne=False), flight)


def test_telemetry_has_the_pitch_of_the_vehicle_again(read, mavlink_parameters, flight):
    """ArduPlane sends theta less PTCH_TRIM_DEG, unless bit 8 of FLIGHT_OPTIONS is set."""
    for options, shift in ((0, np.deg2rad(2.0)), (256, 0.0)):
        table = read(mavlink_parameters({b"PTCH_TRIM_DEG": 2.0, b"FLIGHT_OPTIONS": float(options)}))
        assert_allclose(table["theta"], flight["theta"](table["time"]) + shift, atol=2e-3)


@pytest.mark.parametrize(
    ("use", "flag", "is_read"),
    [(1, 1, True), (0, 0, False), (0, 1, False), (2, 0, False), (2, 1, True)],
)
def test_an_airspeed_that_the_autopilot_does_not_use_is_none(
    write, dataflash, flight, use, flag, is_read
):
    log = dataflash_log(dataflash, flight, Rotation.identity(), ARSPD_USE=float(use))
    log.topic("ARSP", flight.time(10), **ARSPD, U=("B", flag), Airspeed=20.0)
    summary = inspect_log(write(log), airborne=False)
    assert ("airspeed" in summary.columns.index) == is_read
    assert any("ARSPD_USE" in remark for remark in summary.remarks) != is_read


def test_the_airspeed_before_a_new_ratio_is_scaled_to_it(told, dataflash, flight):
    """V^2 is the ratio times the pressure difference (ARSPD_AUTOCAL changes it in flight)."""
    log = dataflash_log(dataflash, flight, Rotation.identity(), ARSPD_RATIO=2.0)
    time = flight.time(10)
    pressure_times_ratio = np.where(time < 25.05, 200.0, 288.0)
    log.topic("ARSP", time, **ARSPD, Airspeed=np.sqrt(pressure_times_ratio))
    changes = (25_050_000, b"ARSPD_RATIO", 2.88), (20_000_000, b"ARSPD_RATIO", 2.0)
    log.rows("PARM", "QNf", "TimeUS,Name,Value", changes)
    # out of order in the file
    log.data[-2:] = [(30_000_000, message) for _, message in log.data[-2:]]
    table = told("ARSPD_RATIO changed from 2 to 2.88", log, airborne=False)
    assert_allclose(table["airspeed"].dropna(), np.sqrt(2.88 * 100.0), rtol=1e-4)


def test_telemetry_without_the_trim_says_so(told, mavlink_parameters):
    told(
        "AHRS_TRIM_X and _Y are not in the telemetry",
        mavlink_parameters({}, without=b"AHRS_TRIM_X"),
    )
