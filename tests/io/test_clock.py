"""One clock: stamps that are believed, channels of any rate brought together, gaps that stay."""

import numpy as np
import pytest

from skdgp.io import FlightReadError, read_flight
from skdgp.preprocessing import FlightDataWarning


@pytest.fixture
def read(tmp_path, dataflash):
    """Return a function from times and a gyro's values, in the order of the file, to the table of the log."""

    def read(time, p, **options):
        log = dataflash().topic("IMU", time, **{f"Gyr{axis}": ("f", p) for axis in "XYZ"})
        content = [*log.definitions, *(message for _, message in log.data)]
        (tmp_path / "log.bin").write_bytes(b"".join(content))
        return read_flight(tmp_path / "log.bin", airborne=False, **options)

    return read


class TestStamps:
    @pytest.mark.parametrize("wrong", [1e9, 0.0])
    def test_single_wrong_stamps_are_left_out(self, read, wrong):
        time = 100 + np.arange(500) * 0.02
        stamps = time.copy()
        stamps[[3, 77, 199, 499]] = wrong
        with pytest.warns(FlightDataWarning, match="4 of 500 messages have a time that cannot be"):
            table = read(stamps, time - 100)
        np.testing.assert_allclose(table["p"], table["time"] - 100, atol=1e-5)

    def test_messages_out_of_order_are_sorted(self, read):
        time = np.arange(500) * 0.02
        time[[100, 101, 102]] = time[[102, 100, 101]]
        with pytest.warns(FlightDataWarning, match="1 messages stand out of order"):
            table = read(time, time)
        np.testing.assert_allclose(table["p"], table["time"], atol=1e-5)

    @pytest.mark.parametrize("n", [2, 30, 60])
    def test_a_short_log_far_from_zero_keeps_its_messages(self, read, n):
        assert len(read(1e4 + 0.1 * np.arange(n), np.zeros(n))) == n

    def test_a_clock_has_no_more_rows_than_its_samples_tell_of(self, read):
        steps = np.tile([0.001, 0.001, 4.9], 500)
        with pytest.raises(FlightReadError, match="a clock without so many gaps"):
            read(np.cumsum(steps), np.zeros(1500), rate=50.0)


class TestRates:
    def sine(self, read, frequency, own):
        time = np.arange(0, 20, 1 / own)
        table = read(time, np.sin(2 * np.pi * frequency * time), rate=50.0)
        table = table[(table["time"] > 2) & (table["time"] < 18)]
        return table["p"], np.sin(2 * np.pi * frequency * table["time"])

    def test_what_the_new_rate_carries_passes_without_delay(self, read):
        p, expected = self.sine(read, 3.0, own=400.0)
        np.testing.assert_allclose(p, expected, atol=2e-3)

    @pytest.mark.parametrize("frequency", [45.0, 55.0, 130.0])
    def test_what_it_cannot_carry_is_not_folded_back(self, read, frequency):
        p, _ = self.sine(read, frequency, own=400.0)
        assert p.abs().max() < 0.01

    def test_slower_channels_are_interpolated(self, read):
        """The error of linear interpolation is at most step^2 / 8 times the second derivative."""
        p, expected = self.sine(read, 0.5, own=10.0)
        assert (p - expected).abs().max() < 1.01 * (2 * np.pi * 0.5 * 0.1) ** 2 / 8

    @pytest.mark.parametrize("own", [10.0, 50.0, 400.0])
    def test_gaps_stay_and_a_lost_sample_is_bridged(self, read, own):
        time = np.arange(0, 10, 1 / own)
        logged = (time < 3) | (time > 5)
        logged[np.searchsorted(time, 8.0)] = False
        with pytest.warns(FlightDataWarning, match="has 1 gaps"):
            table = read(time[logged], time[logged], rate=50.0)
        ends = time[logged][time[logged] < 4].max(), time[logged][time[logged] > 4].min()
        inside = (table["time"] > ends[0] + 1e-9) & (table["time"] < ends[1] - 1e-9)
        assert table["p"][inside].isna().all()
        np.testing.assert_allclose(table["p"][~inside], table["time"][~inside], atol=1e-5)


def test_signs_of_quaternions_do_not_matter(tmp_path, ulog):
    time = 0.02 * np.arange(600)
    half = 0.1 * time
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (600, 1))
    q = signs * np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    log = ulog().topic("vehicle_attitude", time, q=("float[4]", q))
    (tmp_path / "log.ulg").write_bytes(bytes(log))
    table = read_flight(tmp_path / "log.ulg", airborne=False, rate=35.0)
    np.testing.assert_allclose(table["phi"], 0.2 * table["time"], atol=1e-3)
