"""ULog: what is written is read; what is damaged is left out and named, or the log is refused."""

import struct

import numpy as np
import pytest

from skdgp.io import FlightReadError


@pytest.fixture
def ticks(ulog):
    """Return a function to a log of ticks at some times [us]."""
    return lambda *times: ulog().topic("tick", np.array(times) * 1e-6, x=0.5)


@pytest.fixture
def read(parse, ulog):
    """Read messages after a header."""
    return lambda *messages: parse(ulog.head + b"".join(messages))


class TestWhatTheLogSaysOfItself:
    def test_firmware_and_parameters(self, parse, ulog):
        log = ulog(A_B_C=-3).topic("tick", [1e-6, 2e-6], x=0.5)
        log.definitions.append(log.keyed("I", "uint32_t ver_sw_release", bytes([255, 2, 14, 1])))
        found = parse(log)
        assert found.firmware == "PX4 v1.14.2"
        assert found.parameters == {"A_B_C": -3.0}
        assert found.kind == "PX4 ULog"

    @pytest.mark.parametrize(
        ("field", "value", "vehicle"),
        [
            ("vehicle_type", 2, "fixed wing"),
            ("vehicle_type", 1, "multicopter"),
            ("system_type", 21, "VTOL"),
            ("is_vtol", 1, "VTOL"),
            ("other", 1, None),
        ],
    )
    def test_vehicle(self, parse, ulog, field, value, vehicle):
        log = ulog().topic("vehicle_status", [1e-6, 2e-6], **{field: ("uint8_t", value)})
        assert parse(log).vehicle == vehicle


def times(log):
    return (log.topics["tick"].time * 1e6).round().astype(int).tolist()


SKIPPED = ("parts of the file could not be read and were skipped",)


class TestDamage:
    def test_bytes_between_messages(self, read, ticks):
        parts = ticks(*range(1, 5000)).parts()
        log = read(*parts[:-4997], bytes(range(100, 137)), *parts[-4997:])
        assert times(log) == list(range(1, 5000))
        assert log.remarks == SKIPPED

    def test_cut_off_anywhere(self, parse, ticks):
        log = ticks(1, 2, 3, 4)
        whole = bytes(log)
        row = len(log.parts()[-1])
        first = len(whole) - 3 * row
        for length in range(first, len(whole)):
            assert times(parse(whole[:length])) == list(range(1, 2 + (length - first) // row))
        for length in range(16, first):
            with pytest.raises(FlightReadError, match="without any data"):
                parse(whole[:length])

    @pytest.mark.parametrize("text", ["bad:float x;", "bad:"])
    def test_a_topic_without_time_is_none(self, parse, ticks, text):
        assert list(parse(with_bad(ticks(1, 2), text)).topics) == ["tick"]

    def test_a_definition_that_holds_itself_is_refused(self, parse, ticks):
        with pytest.raises(FlightReadError, match="maximum recursion"):
            parse(with_bad(ticks(1, 2), "bad:bad inner;"))

    def test_messages_of_no_topic(self, read, ticks, ulog):
        assert (
            read(*ticks(1, 2).parts(), ulog.message("D", struct.pack("<HQ", 9, 3))).remarks
            == SKIPPED
        )


def with_bad(log, text):
    """Return a log with another topic, of a definition."""
    log.definitions.append(log.message("F", text.encode()))
    log.subscriptions.append(log.message("A", struct.pack("<BH", 0, 5) + b"bad"))
    return log


def test_a_later_format_is_refused(read, ticks, ulog):
    _, *others = ticks(1).parts()
    with pytest.raises(FlightReadError, match="Unknown incompatible flag"):
        read(ulog.message("B", bytes(8) + b"\x02" + bytes(31)), *others)
