"""Position of the inertial sensors by the parameters of autopilots."""

import numpy as np
import pytest
from flight_columns import POSITION
from numpy.testing import assert_allclose

from skdgp.io import inspect_log

PLACE = (0.12, -0.03, 0.05)
T = 10 + np.arange(500) / 50.0
FORCE = np.column_stack([np.sin(T), np.cos(T), np.sin(T) - 9.8])


def parameters(name, place=PLACE):
    return {f"{name}_{axis}": value for axis, value in zip("XYZ", place, strict=True)}


def inertial(log):
    """Add an IMU of ArduPilot."""
    ax, ay, az = FORCE.T
    return log.gyros(T, np.sin(T), I=("B", 0), AccX=ax, AccY=ay, AccZ=az)


def assert_is_placed(table):
    """The sensors are at one place throughout."""
    assert_allclose(table[POSITION], [PLACE] * len(table), rtol=1e-6, atol=1e-9)


def test_of_ardupilot(read, write, dataflash):
    log = inertial(dataflash(**parameters("INS_POS1")))
    table = read(log, "log.bin", airborne=False)
    assert_is_placed(table)
    assert table.attrs["sources"]["sensor_position_x"] == "INS_POS1_X _Y _Z"
    summary = inspect_log(write(log, "log.bin"))
    assert summary.columns.loc["sensor_position_z", "source"] == "INS_POS1_X _Y _Z"


def test_of_px4(read, ulog):
    log = ulog(**parameters("EKF2_IMU_POS"))
    log.topic("vehicle_acceleration", T, xyz=FORCE)
    assert_is_placed(read(log, airborne=False))


def test_forces_by_the_velocity_are_of_the_centre_of_gravity(read, dataflash):
    """Without accelerometers, wherever these would be."""
    log = dataflash(**parameters("INS_POS1"))
    log.gyros(T, np.sin(T))
    log.topic("ATT", T, Roll=np.sin(T), Pitch=np.cos(T), Yaw=10.0)
    log.topic("XKF1", T, **{name: np.sin(T) for name in ("VN", "VE", "VD")})
    table = read(log, "log.bin", airborne=False)
    assert table["az"].notna().any()
    assert_allclose(table[POSITION], 0.0)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (np.nan, 0.1, 0.1)])
def test_zeros_state_nothing(read, dataflash, place):
    """They are the default of autopilots."""
    table = read(inertial(dataflash(**parameters("INS_POS1", place))), "log.bin", airborne=False)
    assert {*POSITION}.isdisjoint(table.columns)
