"""One clock: stamps that are believed, channels of any rate brought together, gaps that stay."""

import numpy as np
import pytest

from skdgp._flight.frames import without_sign_changes
from skdgp.dynamics import euler_to_quaternion, quaternion_to_euler
from skdgp.io import Topic
from skdgp.io._autopilot import clock_parts, resample, uniform_clock


def topic(time, order=None):
    time = np.asarray(time, float)
    rows = np.arange(len(time))
    return Topic(time, rows if order is None else np.asarray(order), {"row": rows})


class TestStamps:
    def test_a_sound_clock_stays_as_it_is(self):
        time = np.arange(500) * 0.01
        (part,), remarks = clock_parts({"a": topic(time), "b": topic([0.5], [250])})
        np.testing.assert_array_equal(part["a"].time, time)
        assert len(part["b"]) == 1
        assert remarks == []

    @pytest.mark.parametrize("wrong", [1e12, -1e9, 0.0])
    def test_single_wrong_stamps_are_left_out(self, wrong):
        time = 100 + np.arange(500) * 0.01
        bad = np.array([3, 77, 78, 499])
        time[bad] = wrong
        (part,), remarks = clock_parts({"a": topic(time)})
        np.testing.assert_array_equal(part["a"]["row"], np.delete(np.arange(500), bad))
        assert remarks == ["4 of 500 messages have a time that cannot be (4 of a)"]

    def test_messages_out_of_order_are_sorted(self):
        time = np.arange(500) * 0.01
        time[[100, 101, 102]] = time[[102, 100, 101]]
        (part,), remarks = clock_parts({"a": topic(time)})
        np.testing.assert_array_equal(part["a"].time, np.sort(time))
        assert "out of order" in remarks[0]

    @pytest.mark.parametrize("row", [60, 250, 437])
    def test_a_clock_set_back_parts_all_topics_at_one_place(self, row):
        time = 50 + np.arange(500) * 0.1
        time[row:] -= 45 + 0.1 * row
        slow = np.arange(0, 500, 7)
        parts, remarks = clock_parts({"a": topic(time), "b": topic(time[slow], slow + 0.5)})
        assert [len(part["a"]) for part in parts] == [row, 500 - row]
        assert len(parts[0]["b"]) == (slow < row).sum()
        assert "set back 1 times" in remarks[0]

    def test_a_leap_forward_is_a_gap(self):
        time = np.arange(500) * 0.01
        time[200:] += 4000
        (part,), remarks = clock_parts({"a": topic(time)})
        np.testing.assert_array_equal(part["a"].time, time)
        assert remarks == []

    @pytest.mark.parametrize("n", [1, 2, 30, 60])
    def test_a_short_log_far_from_zero_keeps_its_messages(self, n):
        (part,), remarks = clock_parts({"a": topic(1e4 + 0.1 * np.arange(n))})
        assert len(part["a"]) == n
        assert remarks == []


class TestUniformClock:
    def test_no_rows_where_the_log_stands_still(self):
        time = np.r_[np.arange(0, 10, 0.02), np.arange(1e6, 1e6 + 10, 0.02)]
        clock = uniform_clock(time, 50.0)
        assert len(clock) == len(time)
        assert np.diff(clock).max() > 9e5

    def test_rows_are_bounded(self):
        steps = np.tile([0.001, 0.001, 4.9], 500)
        with pytest.raises(ValueError, match="a clock without so many gaps"):
            uniform_clock(np.cumsum(steps), 50.0)


class TestResample:
    def sine(self, frequency, own, rate, seconds=20.0):
        time = np.arange(0, seconds, 1 / own)
        clock = uniform_clock(time, rate)
        found = resample(time, np.sin(2 * np.pi * frequency * time)[:, None], clock, rate)[:, 0]
        middle = (clock > 2) & (clock < seconds - 2)
        return clock[middle], found[middle]

    def test_what_the_new_rate_carries_passes_without_delay(self):
        clock, found = self.sine(3.0, own=400.0, rate=50.0)
        np.testing.assert_allclose(found, np.sin(2 * np.pi * 3.0 * clock), atol=2e-3)

    @pytest.mark.parametrize("frequency", [45.0, 50.0, 55.0, 130.0])
    def test_what_it_cannot_carry_is_not_folded_back(self, frequency):
        _, found = self.sine(frequency, own=400.0, rate=50.0)
        assert np.abs(found).max() < 0.01

    def test_slower_channels_are_interpolated(self):
        clock, found = self.sine(0.5, own=10.0, rate=50.0)
        bound = (
            2 * np.pi * 0.5 * 0.1
        ) ** 2 / 8  # of linear interpolation: step^2 / 8 times the second derivative
        assert np.abs(found - np.sin(2 * np.pi * 0.5 * clock)).max() < 1.01 * bound

    @pytest.mark.parametrize("own", [10.0, 50.0, 400.0])
    def test_gaps_stay_and_a_lost_sample_is_bridged(self, own):
        time = np.arange(0, 10, 1 / own)
        kept = (time < 3) | (time > 5)
        kept[np.searchsorted(time, 8.0)] = False
        clock = np.arange(0, 500) / 50
        found = resample(time[kept], np.column_stack([time, 2 * time])[kept], clock, 50.0)
        inside = (clock > time[kept][time[kept] < 4].max() + 1e-9) & (
            clock < time[kept][time[kept] > 4].min() - 1e-9
        )
        assert np.isnan(found[inside]).all()
        known = ~inside & (clock <= time.max())
        np.testing.assert_allclose(
            found[known], np.column_stack([clock, 2 * clock])[known], atol=1e-5
        )

    def test_values_that_are_not_numbers_are_not_sampled(self):
        time = np.arange(100) / 50
        values = np.ones((100, 2))
        values[40:60, 1] = np.nan
        found = resample(time, values, time, 50.0)
        assert np.isnan(found[40:60]).all()
        assert np.isfinite(np.delete(found, np.arange(40, 60), axis=0)).all()


class TestAttitude:
    def test_signs(self):
        turning = euler_to_quaternion(np.linspace(0, 30, 300), 0.0, 0.0)
        signs = np.random.default_rng(1).choice([-1.0, 1.0], 300)[:, None]
        smooth = without_sign_changes(turning * signs)
        assert np.abs(np.diff(smooth, axis=0)).max() < 0.06
        np.testing.assert_allclose(
            quaternion_to_euler(smooth), quaternion_to_euler(turning), atol=1e-12
        )
