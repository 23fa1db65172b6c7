"""ULog: what is written is read, as pyulog reads it; what is damaged costs only itself."""

import struct

import numpy as np
import pytest

from skdgp.io import FlightReadError, Log
from skdgp.io._ulog import HEADER_SIZE, read_ulog

HEADER = b"ULog\x01\x12\x35\x01" + bytes(8)


def message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def definition(text):
    return message("F", text.encode())


def subscription(number, name, instance=0):
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def datum(number, code, *values):
    return message("D", struct.pack("<H" + code, number, *values))


TICK = [definition("tick:uint64_t timestamp;float x;"), subscription(0, "tick")]


def ticks(*times):
    return [datum(0, "Qf", t, 0.5 * t) for t in times]


@pytest.fixture
def read(tmp_path):
    """Read messages after a header."""

    def of(*messages, header=HEADER):
        path = tmp_path / "log.ulg"
        path.write_bytes(header + b"".join(messages))
        return read_ulog(path)

    return of


def assert_as_pyulog(path):
    """Every field of every topic is the one that pyulog reads."""
    pyulog = pytest.importorskip("pyulog")
    theirs, ours = pyulog.ULog(str(path)), read_ulog(path)
    assert len(ours.topics) == len(theirs.data_list) > 0
    for data in theirs.data_list:
        topic = ours.topics[data.name + (f"#{data.multi_id}" if data.multi_id else "")]
        assert set(topic.channels()) == set(data.data)
        for name, values in data.data.items():
            np.testing.assert_array_equal(topic[name], values.astype(float))
    assert ours.parameters == {
        key: float(value) for key, value in theirs.initial_parameters.items()
    }


class TestAsPyulog:
    def test_a_log_of_every_column(self, tmp_path, px4):
        (tmp_path / "log.ulg").write_bytes(px4)
        assert_as_pyulog(tmp_path / "log.ulg")

    def test_nested_messages_arrays_and_padding(self, tmp_path):
        content = [
            definition("point:uint64_t timestamp;float[2] at;uint8_t flag;uint8_t[3] _padding0;"),
            definition("pair:uint64_t timestamp;point[2] ends;int16_t n;uint8_t[6] _padding0;"),
            subscription(7, "pair", 2),
            *(
                datum(7, "Q" + 2 * "QffB3x" + "h", t, t, 1.5, t, 1, 0, -2.0, 0.5, 0, -t)
                for t in (1, 2, 3)
            ),
        ]
        path = tmp_path / "log.ulg"
        path.write_bytes(HEADER + b"".join(content))
        topic = read_ulog(path).topics["pair#2"]
        np.testing.assert_array_equal(topic["ends[0].at[1]"], [1, 2, 3])
        np.testing.assert_array_equal(topic["n"], [-1, -2, -3])
        assert "ends[2].at[0]" not in topic
        assert "ends" not in topic
        assert_as_pyulog(path)

    @pytest.mark.shared
    @pytest.mark.parametrize(
        "name", ["fw_system_id_log_altitude_1_HITL.ulg", "pyulog_sample_log_small_vtol_bench.ulg"]
    )
    def test_shared_logs(self, shared_data, name):
        assert_as_pyulog(shared_data / "logs" / name)


class TestWhatTheLogSaysOfItself:
    def test_firmware_and_parameters(self, read):
        def info(kind, key, value):
            text = f"{kind} {key}".encode()
            return message("I", bytes([len(text)]) + text + value)

        name = info("char[3]", "sys_name", b"PX4")
        release = info("uint32_t", "ver_sw_release", bytes([255, 2, 14, 1]))
        parameter = b"\x0dint32_t A_B_C" + struct.pack("<i", -3)
        log = read(name, release, message("P", parameter), *TICK, *ticks(1, 2))
        assert log.firmware == "PX4 1.14.2"
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


class TestDamage:
    def times(self, log: Log):
        return (log.topics["tick"].time * 1e6).round().astype(int).tolist()

    def test_bytes_between_messages(self, read):
        log = read(*TICK, *ticks(1, 2), bytes(range(100, 137)), *ticks(3, 4, 5, 6))
        assert self.times(log) == [1, 2, 3, 4, 5, 6]
        assert log.remarks == ("37 bytes could not be read and were skipped",)

    def test_a_length_that_is_wrong(self, read):
        broken = b"\xff\x40D" + ticks(3)[0][3:]
        log = read(*TICK, *ticks(1, 2), broken, *ticks(*range(4, 1500)))
        assert self.times(log) == [1, 2, *range(4, 1500)]

    def test_cut_off_anywhere(self, read):
        messages = [*TICK, *ticks(1, 2, 3, 4)]
        whole = b"".join(messages)
        first = len(b"".join(messages[:3]))
        for length in range(first, len(whole)):
            log = read(whole[:length])
            assert self.times(log) == list(range(1, 2 + (length - first) // len(messages[-1])))
        for length in range(first):
            with pytest.raises(FlightReadError, match="without any data"):
                read(whole[:length])

    def test_messages_out_of_order_stay_in_the_order_of_the_file(self, read):
        assert self.times(read(*TICK, *ticks(3, 1, 2))) == [3, 1, 2]

    @pytest.mark.parametrize(
        "text",
        [
            "bad:uint64_t timestamp;bad inner;",  # in itself
            "bad:uint64_t timestamp;float[99999] x;",  # longer than a message can be
            "bad:uint64_t timestamp;other x;",
            "bad:uint64_t timestamp;float x;float x;",
            "bad:uint64_t timestamp;float[0] x;",
            "bad:float x;",
            "bad:",
        ],
    )
    def test_definitions_that_make_no_sense(self, read, text):
        log = read(definition(text), subscription(5, "bad"), *TICK, *ticks(1, 2))
        assert list(log.topics) == ["tick"]

    def test_definitions_that_double_each_other_take_no_time(self, read):
        chain = [definition(f"a{n}:a{n + 1}[60000] x;a{n + 1}[60000] y;") for n in range(8)]
        log = read(*chain, definition("a8:float x;"), subscription(5, "a0"), *TICK, *ticks(1, 2))
        assert list(log.topics) == ["tick"]

    def test_data_appended_after_half_a_message(self, read):
        half = ticks(3)[0][:9]
        body = b"".join([*TICK, *ticks(1, 2)]) + half
        flags = (
            bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", HEADER_SIZE + 43 + len(body), 0, 0)
        )
        assert self.times(read(message("B", flags), body, *ticks(4, 5))) == [1, 2, 4, 5]


class TestRefusals:
    def test_what_is_no_ulog(self, read):
        for content in (b"", b"ULog", b"\xa3\x95\x80", b"time,alpha\n"):
            with pytest.raises(FlightReadError, match="does not begin as a ULog does"):
                read(header=content)

    def test_a_later_format(self, read):
        with pytest.raises(FlightReadError, match="incompatible flags 02"):
            read(message("B", bytes(8) + b"\x02" + bytes(31)), *TICK, *ticks(1))
