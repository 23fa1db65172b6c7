"""Reading flights: tables come out in SI, and errors name the place and the remedy."""

import sys

import numpy as np
import pandas as pd
import pytest
from flight_columns import FORCES, RATES, SURFACES
from made_flights import make_flight
from numpy.testing import assert_allclose

from skdgp.io import FlightReadError, read_flight


def table(n=50, **columns):
    levels = {"alpha q elevator": (0, 0.05, 0), "airspeed": (30, 0.5, 0)}
    return make_flight(levels, n, 0.02).assign(**columns)


class TestUnitsThatNumbersGiveAway:
    def test_degrees_are_named_in_one_order(self, read, refused):
        angles = ["alpha", "beta", "theta", "phi", *SURFACES, "elevon_left", "flap"]
        wave = np.sin(np.arange(50))
        degrees = dict.fromkeys(angles, 12 * wave) | dict.fromkeys(RATES, 25 * wave)
        words = ".*".join(f"'{name}'" for name in degrees)
        words += ".*look like degrees. Convert them with numpy.deg2rad"
        refused(words, table(**degrees))
        read(table(**{name: np.deg2rad(values) for name, values in degrees.items()}))

    def test_heading(self, refused):
        refused(r"'psi'.*degrees", table(psi=np.linspace(300, 420, 50) % 360))
        refused(r"'psi'.*wrapped by numpy.angle", table(psi=np.linspace(0, 40, 50)))

    def test_per_cent_g_densities_and_milliseconds(self, read, refused):
        refused("expected 0 to 1: divide it", table(throttle=55.0))
        refused("expected air in kg/m", table(density=1.2e-3))
        refused("looks like g", table(ax=0.02, ay=0.0, az=-1.01))
        refused("looks like milliseconds", table(time=20.0 * np.arange(50)))
        fast = np.arange(50) / 400  # s
        motion = {"theta": 0.2 * np.sin(30 * fast), "q": 6.0 * np.cos(30 * fast)}
        refused("looks like milliseconds", table(time=1e3 * fast, **motion))
        slow = np.arange(50.0)
        slow[30:] += 3600  # a pause
        read(table(time=slow, theta=motion["theta"], q=0.075 * np.cos(30 * fast)))
        read(table(time=slow, theta=motion["theta"]))
        with pytest.warns(UserWarning, match="if this is in minutes"):
            read(table(time=4e-4 * np.arange(50)))
        assert_allclose(read(table(ax=0.2, ay=0.0, az=-9.9)).az.mean(), -9.9)
        # gravity was removed
        assert_allclose(read(table(ax=0.2, ay=0.0, az=-0.2)).az.mean(), -0.2)

    def test_a_mark_of_missing_angles_is_no_angle_in_degrees(self, refused):
        marked = np.where(np.arange(50) % 10, 0.1, -999.0)
        refused("alpha of magnitude 999 in 5 rows.*mark of missing", table(alpha=marked))

    @pytest.mark.parametrize(
        ("name", "values"), [("elevator", [0, 5, -5]), ("flap", [0, 20]), ("alpha", [0, 12])]
    )
    def test_steps_of_one_size_in_degrees_are_no_mark(self, refused, name, values):
        refused(f"'{name}'.*degrees", table(**{name: np.resize(np.repeat(values, 5), 50)}))

    def test_values_of_another_column(self, refused):
        """A name is missing in the header, so the airspeed stands under alpha."""
        rows = table(alpha=0.05)[["time", "airspeed", "alpha", "q"]]
        shifted = rows.set_axis(["time", "alpha", "q", "extra"], axis="columns")
        refused("the values of another column", shifted)

    def test_one_bad_sample_is_not_a_unit(self, read):
        alpha = np.full(500, 0.05)
        alpha[100] = 3.0
        assert len(read(pd.DataFrame({"time": np.arange(500) * 0.02, "alpha": alpha}))) == 500


class TestRefusals:
    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("empty.csv", "", "is empty"),
            ("head.csv", "time,alpha\n", "no rows"),
            ("log.txt", "time,alpha\n0,0\n", "suffix '.txt', but expected one of"),
            ("log.csv", "time,alpha\n0,0.1\n1,high\n", "'high' in column 'alpha' at row 1"),
            ("log.csv", "time,alpha\n0,0.1\n,0.2\n", "no time at row 1"),
            ("log.csv", "time,alpha\n0,0.1\n2,0.2\n1,0.3\n3,0.4\n", "time 1 s after 2 s at row 2"),
            ("log.csv", "time,alpha\n0,0.1\n1,0.2\n1,0.3\n", "drop repeated rows"),
        ],
    )
    def test_says_what_is_wrong(self, write, name, content, message):
        path = write(content, name)
        with pytest.raises(FlightReadError, match=message) as error:
            read_flight(path)
        assert str(path) in str(error.value)
        assert isinstance(error.value, ValueError)

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="no such file"):
            read_flight(tmp_path / "gone.csv")

    @pytest.mark.parametrize(
        ("name", "module", "extra"),
        [
            ("log.parquet", "pyarrow.parquet", "parquet"),
            ("log.ulg", "pyulog", "logs"),
            ("log.tlog", "pymavlink.dialects.v20.ardupilotmega", "logs"),
        ],
    )
    def test_formats_without_their_extra(self, read, monkeypatch, name, module, extra):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ImportError, match=rf"pip install 'skdgp\[{extra}\]'"):
            read(b"", name)

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("log.bin", b"", "does not begin as a DataFlash log does"),
            ("log.bin", b"\xa3", "does not begin as a DataFlash log does"),
            ("log.bin", b"time,alpha\n", "does not begin as a DataFlash log does"),
            ("log.ulg", b"", "does not begin as a ULog does"),
            ("log.ulg", b"ULog", "does not begin as a ULog does"),
            ("log.ulg", b"time,alpha\n", "does not begin as a ULog does"),
            ("log.tlog", b"", "without a message ATTITUDE"),
            ("log.tlog", b"text", "without a message ATTITUDE"),
            ("log.tlog", bytes(1000), "without a message ATTITUDE"),
        ],
    )
    def test_logs_of_another_kind(self, refused, name, content, message):
        pytest.importorskip("pymavlink")
        refused(message, content, name)


class TestRemarks:
    def test_misspelt_names(self, read):
        words = r"'Beta' \(did you mean 'beta' \[rad\]\?\), 'trottle' \(did you mean 'throttle'\?\)"
        with pytest.warns(UserWarning, match=words):
            flight = read(table(Beta=0.0, trottle=0.2, my_sensor=1.0))
        assert flight.attrs["unknown_columns"] == ["Beta", "trottle", "my_sensor"]

    def test_infinities_are_missing(self, read):
        rows = table()
        rows.loc[3, "q"] = np.inf
        with pytest.warns(UserWarning, match=r"\['q'\] are read as missing"):
            assert np.isnan(read(rows, "log.parquet").q[3])


class TestRename:
    NAMES = {"de": "elevator", "ias": "airspeed"}

    def test_names_and_units(self, read):
        flight = read("time,de [deg],ias\n0,18,20\n0.02,9,21\n", rename=self.NAMES)
        assert_allclose(flight.elevator, [np.pi / 10, np.pi / 20])
        assert flight.airspeed.tolist() == [20, 21]
        expected = table().rename(columns={"elevator": "de", "airspeed": "ias"})
        for name in ("a.parquet", "b.csv"):
            assert {"elevator", "airspeed"} <= set(read(expected, name, rename=self.NAMES))

    @pytest.mark.parametrize(
        ("rename", "message"),
        [
            ({"dee": "elevator"}, r"has no such column: expected one such as \[.*'de'"),
            ({"de": "elevatr"}, "expected a name of a flight table"),
            ({"de": "alpha"}, r"repeated columns \['alpha'\]"),
        ],
    )
    def test_refusals(self, refused, rename, message):
        refused(message, table().rename(columns={"elevator": "de"}), "a.parquet", rename=rename)


def test_accelerations_that_were_never_sampled_are_no_warning(read):
    assert read("time,ax,ay,az\n0,,,\n0.1,,,\n")[FORCES].isna().all(axis=None)
