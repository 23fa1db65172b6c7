"""DataFlash: what is written is read, as pymavlink reads it; what is damaged costs only itself."""

import struct
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.io import AUTOPILOTS, FlightReadError

read_dataflash = AUTOPILOTS[".bin"]
DEFINITIONS = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG")


@pytest.fixture
def read(parse):
    """Read a log."""
    return partial(parse, name="log.bin")


def assert_as_pymavlink(path):
    """Every number of every message is the one that pymavlink reads."""
    reader = pytest.importorskip("pymavlink.DFReader").DFReader_binary(
        str(path), zero_time_base=True
    )
    theirs = {}
    with reader:
        while (message := reader.recv_msg()) is not None:
            name = message.get_type()
            fields = message.to_dict()
            if name not in DEFINITIONS and "TimeUS" in fields:
                of = message.fmt.instance_field
                theirs.setdefault((name, fields[of] if of else 0), []).append(fields)
        ours = read_dataflash(path)
        assert len(ours.topics) == len(theirs) > 0
        assert ours.parameters == reader.params
    for (name, instance), messages in theirs.items():
        topic = ours.topics[f"{name}#{instance}" if instance else name]
        for field in messages[0]:
            if field in topic:
                expected = [fields[field] for fields in messages]
                assert_allclose(topic[field], expected, rtol=1e-14, equal_nan=True)


class TestAsPymavlink:
    def test_a_log_of_every_column(self, write, ardupilot):
        assert_as_pymavlink(write(ardupilot, "log.bin"))

    @pytest.mark.shared
    def test_shared_log(self, shared_data, write):
        """Its first quarter: pymavlink takes its time."""
        content = (shared_data / "logs" / "pyflightcoach_elevator_bench.BIN").read_bytes()
        assert_as_pymavlink(write(content[:600_000], "log.bin"))


def ticks(log, *times):
    return log.topic("TICK", [t * 1e-6 for t in times], X=[0.5 * t for t in times])


def times(log):
    return (log.topics["TICK"].time * 1e6).round().astype(int).tolist()


class TestWhatTheLogSaysOfItself:
    @pytest.mark.parametrize(
        ("text", "parameters", "vehicle"),
        [
            ("ArduPlane V4.5.1 (abcdef01)", {}, "fixed wing"),
            ("ArduPlane V4.5.1 (abcdef01)", {"Q_ENABLE": 1.0}, "VTOL"),
            ("ArduCopter V4.3.0", {}, "multicopter"),
            ("ArduCopter V4.3.0", {"FRAME_CLASS": 6.0}, "helicopter"),
            ("ArduRover V4.5.0", {"FRAME_CLASS": 1.0}, "rover"),
            ("ArduRover V4.5.0", {"FRAME_CLASS": 2.0}, "boat"),
            ("hello", {}, None),
        ],
    )
    def test_vehicle(self, read, dataflash, text, parameters, vehicle):
        log = read(ticks(dataflash(text, **parameters), 1, 2))
        assert log.vehicle == vehicle
        assert log.parameters == parameters
        assert log.firmware == (text if vehicle else "ArduPilot")

    def test_instances(self, read, dataflash):
        log = dataflash()
        for n in (0, 1, 2):
            log.topic("BARO", [0.1 * (3 * k + n) for k in range(4)], I=("B", n), Alt=10.0 * n)
        topics = read(log).topics
        assert list(topics) == ["BARO", "BARO#1", "BARO#2"]
        assert_array_equal(topics["BARO#2"]["Alt"], 20.0)


class TestDamage:
    def test_bytes_between_messages(self, read, dataflash):
        parts = ticks(dataflash(), 1, 2, 3, 4).parts()
        log = read(b"".join([*parts[:-2], b"\xa3garbage\xa3\x95\xee", *parts[-2:]]))
        assert times(log) == [1, 2, 3, 4]
        assert log.remarks == ("11 bytes could not be read and were skipped",)

    def test_cut_off_anywhere(self, read, dataflash):
        parts = ticks(dataflash(), 1, 2, 3).parts()
        whole = b"".join(parts)
        first = len(b"".join(parts[:-2]))
        for length in range(first, len(whole)):
            n_more = (length - first) // len(parts[-1])
            assert times(read(whole[:length])) == [*range(1, 2 + n_more)]
        for length in range(2, first - len(parts[-1])):
            with pytest.raises(FlightReadError, match="no message has a TimeUS"):
                read(whole[:length])
        assert "cut off" in read(whole[:-3]).remarks[0]

    @pytest.mark.parametrize(
        ("length", "codes", "columns"),
        [
            (0, "Qf", "TimeUS,X"),
            (255, "Qf", "TimeUS,X"),
            (15, "Q?", "TimeUS,X"),
            (15, "Qf", "TimeUS"),
            (15, "Qf", "X,X"),
        ],
    )
    def test_formats_that_make_no_sense(self, read, dataflash, length, codes, columns):
        log = ticks(dataflash(), 1, 2, 3)
        body = struct.pack("<BB4s16s64s", 200, length, b"BAD", codes.encode(), columns.encode())
        bad = b"\xa3\x95\x80" + body + b"\xa3\x95\xc8" + bytes(12)
        parts = log.parts()
        assert times(read(b"".join([parts[0], bad, *parts[1:]]))) == [1, 2, 3]


def test_a_log_in_text_is_refused(refused):
    refused("in text", "FMT, 129, 23, IMU, QBfff, TimeUS,I,GyrX,GyrY,GyrZ", "sortie.log")


def test_a_parameter_that_changes_counts_as_in_the_middle(read, dataflash):
    """Once in flight, and once on the bench after it."""
    log = ticks(dataflash(SERVO1_REVERSED=0.0, SERVO1_TRIM=1500.0), *(10**6 * np.arange(10, 60)))
    changes = (20_000_000, b"SERVO1_TRIM", 1520.0), (58_000_000, b"SERVO1_REVERSED", 1.0)
    log.rows("PARM", "QNf", "TimeUS,Name,Value", changes)
    assert read(log).parameters == {"SERVO1_REVERSED": 0.0, "SERVO1_TRIM": 1520.0}
