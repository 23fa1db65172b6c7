"""VTOLs: rows in which rotors lift are no flight on wings."""

import numpy as np
import pytest

T = 10 + np.arange(1500) / 50.0
SLOW = T[::5]
# rotors lift until then
TRANSITION = 20.0
HOVERS = SLOW < TRANSITION
PLANE = "ArduPlane V4.5.1 (abcdef01)"
MOTORS = {f"SERVO{n}_FUNCTION": 28.0 + n for n in (5, 6, 7, 8)}
RUNNING = dict.fromkeys(("C5", "C6", "C7", "C8"), ("H", 1500))


@pytest.fixture
def vtol(dataflash):
    """Return a writer of a log of a VTOL of ArduPilot in 18 m/s."""

    def vtol(**parameters):
        log = dataflash(PLANE, Q_ENABLE=1.0, **parameters)
        log.gyros(T, np.sin(T))
        log.topic("ARSP", SLOW, Airspeed=18 + np.sin(SLOW), H=("B", 1))
        modes = ("B", np.where(HOVERS, 18, 5))
        return log.topic("MODE", SLOW, Mode=("M", 0), ModeNum=modes)

    return vtol


def is_in_forward_flight_alone(table):
    return abs(table.time.min() - TRANSITION) < 0.2 and table.time.max() > 39


@pytest.mark.parametrize(
    ("parameters", "outputs"),
    [
        ({"SERVO3_FUNCTION": 73.0, "SERVO4_FUNCTION": 74.0, "Q_TAILSIT_ENABLE": 1.0}, "C3 C4"),
        (MOTORS | {"Q_TAILSIT_MOTMX": 15.0}, "C5 C6 C7 C8"),
        (MOTORS, "C3 C4"),
    ],
    ids=["tailsitter", "tailsitter with motors of a copter", "motors on other outputs"],
)
def test_the_mode_counts_where_no_output_tells(told, vtol, parameters, outputs):
    log = vtol(**parameters)
    log.topic("RCOU", SLOW, **dict.fromkeys(outputs.split(), ("H", 1500)))
    table = told("rotors lift", log)
    assert is_in_forward_flight_alone(table)


def test_a_flight_in_which_rotors_lift_throughout(refused, vtol):
    log = vtol(**MOTORS)
    log.topic("RCOU", SLOW, C1=("H", 1500 + 100 * np.sin(SLOW)), **RUNNING)
    refused("lifted by rotors in 100 % of the rows", log)


def test_a_mode_that_flies_on_wings_at_first(read, vtol):
    """QRTL returns in forward flight: the motors count, which are idle."""
    log = vtol(**MOTORS)
    log.topic("MODE", SLOW + 1e-3, Mode=("M", 0), ModeNum=("B", 21))
    idle = dict.fromkeys(RUNNING, ("H", 1000))
    log.topic("RCOU", SLOW, C1=("H", 1500 + 100 * np.sin(SLOW)), **idle)
    table = read(log)
    assert len(table) > 0.98 * len(T)
