"""ULog: what is written is read; what is damaged is left out and named, or the log is refused."""

import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.io import FlightReadError

HEADER = b"ULog\x01\x12\x35\x01" + bytes(8)


def message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def definition(text):
    return message("F", text.encode())


def subscription(number, name):
    return message("A", struct.pack("<BH", 0, number) + name.encode())


def datum(number, code, *values):
    return message("D", struct.pack("<H" + code, number, *values))


TICK = [definition("tick:uint64_t timestamp;float x;"), subscription(0, "tick")]


def ticks(*times):
    return [datum(0, "Qf", t, 0.5 * t) for t in times]


@pytest.fixture
def read(parse):
    """Read messages after a header."""
    return lambda *messages: parse(HEADER + b"".join(messages))


class TestWhatTheLogSaysOfItself:
    def test_firmware_and_parameters(self, read):
        def info(kind, key, value):
            text = f"{kind} {key}".encode()
            return message("I", bytes([len(text)]) + text + value)

        name = info("char[3]", "sys_name", b"PX4")
        release = info("uint32_t", "ver_sw_release", bytes([255, 2, 14, 1]))
        parameter = b"\x0dint32_t A_B_C" + struct.pack("<i", -3)
        log = read(name, release, message("P", parameter), *TICK, *ticks(1, 2))
        assert log.firmware == "PX4 v1.14.2"
        assert log.parameters == {"A_B_C": -3.0}
        assert log.kind == "PX4 ULog"

    @pytest.mark.parametrize(
        ("field", "value", "vehicle"),
        [
            ("vehicle_type", 2, "fixed wing"),
            ("vehicle_type", 1, "multicopter"),
            ("system_type", 21, "VTOL"),
            ("is_vtol", 1, "VTOL"),
        ],
    )
    def test_vehicle(self, read, field, value, vehicle):
        status = definition(f"vehicle_status:uint64_t timestamp;uint8_t {field};")
        log = read(
            status,
            subscription(0, "vehicle_status"),
            datum(0, "QB", 1, value),
            datum(0, "QB", 2, value),
        )
        assert log.vehicle == vehicle

    def test_unknown_vehicle(self, read):
        assert read(*TICK, *ticks(1, 2)).vehicle is None


def times(log):
    return (log.topics["tick"].time * 1e6).round().astype(int).tolist()


SKIPPED = ("parts of the file could not be read and were skipped",)


class TestDamage:
    def test_bytes_between_messages(self, read):
        log = read(*TICK, *ticks(1, 2), bytes(range(100, 137)), *ticks(*range(3, 5000)))
        assert times(log) == list(range(1, 5000))
        assert log.remarks == SKIPPED

    def test_a_wrong_length_costs_what_stands_before_the_next_mark(self, read):
        """PX4 writes marks for this case all along the file."""
        mark = message("S", bytes.fromhex("2f731320250cbb12"))
        broken = b"\xff\x04D" + ticks(3)[0][3:]
        parts = [[*ticks(*range(k, k + 100)), mark] for k in range(4, 5004, 100)]
        log = read(*TICK, *ticks(1, 2), broken, *(each for part in parts for each in part))
        assert times(log) == [1, 2, *range(104, 5004)]
        assert log.remarks == SKIPPED

    def test_cut_off_anywhere(self, read):
        messages = [*TICK, *ticks(1, 2, 3, 4)]
        whole = b"".join(messages)
        first = len(b"".join(messages[:3]))
        for length in range(first, len(whole)):
            log = read(whole[:length])
            assert times(log) == list(range(1, 2 + (length - first) // len(messages[-1])))
        for length in range(first):
            with pytest.raises(FlightReadError, match="without any data"):
                read(whole[:length])

    @pytest.mark.parametrize("text", ["bad:float x;", "bad:"])
    def test_a_topic_without_time_is_none(self, read, text):
        log = read(definition(text), *TICK, subscription(5, "bad"), *ticks(1, 2))
        assert list(log.topics) == ["tick"]

    def test_a_definition_that_holds_itself_is_refused(self, read):
        with pytest.raises(FlightReadError, match="maximum recursion"):
            read(definition("bad:bad inner;"), *TICK, subscription(5, "bad"), *ticks(1, 2))

    def test_messages_of_no_topic(self, read):
        assert read(*TICK, *ticks(1, 2), datum(9, "Q", 3)).remarks == SKIPPED

    def test_messages_out_of_order_stay_in_the_order_of_the_file(self, read):
        assert times(read(*TICK, *ticks(3, 1, 2))) == [3, 1, 2]


@pytest.mark.parametrize("place", [-60, -20, -5, 5, 20, 60])
def test_a_clock_that_was_set_back_makes_flights_of_their_own(told, ulog, place):
    """Both stretches have times from 10 to 42 s, and near the restart one message has a wrong time."""
    time = np.arange(10, 50, 0.02)
    times = np.append(time, time - 8)
    times[len(time) + place] = 5000.0
    log = ulog().gyros(times, np.repeat([1.0, 2.0], len(time)))
    log.data = [(k, message) for k, (_, message) in enumerate(log.data)]
    table = told("the clock was set back 1 times", log, airborne=False)
    rates = table.groupby("flight").p
    assert_allclose([rates.min(), rates.max()], [[1.0, 2.0]] * 2)


class TestRefusals:
    def test_a_later_format(self, read):
        with pytest.raises(FlightReadError, match="Unknown incompatible flag"):
            read(message("B", bytes(8) + b"\x02" + bytes(31)), *TICK, *ticks(1))
