"""Telemetry logs: what was sent is read like a log of the autopilot itself."""

import struct
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from skdgp.io import FlightReadError, read_flight


class TestTelemetry:
    def test_what_was_sent_is_read(self, tlog, tmp_path, flight):
        (tmp_path / "sortie.tlog").write_bytes(b"".join(tlog))
        table = read_flight(tmp_path / "sortie.tlog", servos="full throw")
        assert table.flight.unique().tolist() == ["sortie"]
        time = table["time"].to_numpy()
        for name, error in (
            ("p", 2e-3),
            ("az", 2e-2),
            ("phi", 2e-3),
            ("v_east", 2e-2),
            ("altitude", 0.1),
            ("density", 2e-3),
        ):
            assert_allclose(table[name], flight[name](time), atol=error)
        assert_allclose(table["elevator"], flight["elevator"](time) / 0.4, atol=5e-3)
        assert_allclose(
            table["airspeed"], flight["airspeed"](time), atol=0.3
        )  # it has no clock but arrival
        assert abs(np.mean(table["airspeed"] - flight["airspeed"](time))) < 0.05

    def test_arrival_in_bursts_changes_nothing(self, tlog, tmp_path):
        """A slow link delivers what was sent within four seconds at once."""
        arrival = [struct.unpack(">Q", each[:8])[0] for each in tlog]
        late = [struct.pack(">Q", (stamp // 4_000_000 + 1) * 4_000_000) for stamp in arrival]
        bursts = [stamp + each[8:] for stamp, each in zip(late, tlog, strict=True)]
        tables = []
        for name, content in (("a", tlog), ("b", bursts)):
            (tmp_path / f"{name}.tlog").write_bytes(b"".join(content))
            tables.append(read_flight(tmp_path / f"{name}.tlog", flight="sortie"))
        assert_frame_equal(*tables)
        assert tables[0]["airspeed"].notna().all()

    def test_damage_costs_only_itself(self, tlog, tmp_path):
        (tmp_path / "whole.tlog").write_bytes(b"".join(tlog))
        (tmp_path / "cut.tlog").write_bytes(
            b"".join([*tlog[:600], b"\xfd\x09 what is no message", *tlog[600:-3], tlog[-3][:9]])
        )
        with pytest.warns(UserWarning, match="bytes could not be read and were skipped"):
            damaged = read_flight(tmp_path / "cut.tlog")
        assert len(damaged) > 0.95 * len(read_flight(tmp_path / "whole.tlog"))

    def test_no_telemetry(self, tmp_path):
        pytest.importorskip("pymavlink")
        for content in (b"", b"text", bytes(1000)):
            (tmp_path / "a.tlog").write_bytes(content)
            with pytest.raises(FlightReadError, match="without a message ATTITUDE"):
                read_flight(tmp_path / "a.tlog")


def test_without_its_extra(tlog, tmp_path, monkeypatch):
    (tmp_path / "sortie.tlog").write_bytes(b"".join(tlog))
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(ImportError, match=r"pip install 'skdgp\[logs\]'"):
        read_flight(tmp_path / "sortie.tlog")
