"""Smoothing and differentiation: no delay, no leak between flights, no guess where there is nothing to tell."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from skdgp._flight.smoothing import differentiate, noise_level, smooth

RATE = 40.0
CUTOFFS = ["auto", 3.0, None]


def clock(n, rate=RATE, start=0.0):
    return start + np.arange(n) / rate


def noisy_sine(n=2400, noise=0.05, frequency=0.4, seed=0):
    time = clock(n)
    truth = np.sin(2 * np.pi * frequency * time + 0.3)
    return time, truth, truth + np.random.default_rng(seed).normal(0, noise, n)


def rms(error):
    return np.sqrt(np.mean(np.square(error)))


class TestSmooth:
    @pytest.mark.parametrize("cutoff", CUTOFFS)
    def test_constant_and_line_are_kept(self, cutoff):
        time = clock(1200)
        lines = np.column_stack([np.full(1200, 7.0), 2.0 - 0.3 * time])
        np.testing.assert_allclose(smooth(lines, time, cutoff=cutoff), lines, atol=1e-9)
        np.testing.assert_allclose(
            differentiate(lines, time, cutoff=cutoff), [[0.0, -0.3]] * 1200, atol=1e-7
        )

    @pytest.mark.parametrize("cutoff", CUTOFFS)
    def test_time_reversal_commutes(self, cutoff):
        # A filter without delay treats a log and its mirror image alike.
        time, _, noisy = noisy_sine()
        there, back = (
            smooth(noisy, time, cutoff=cutoff),
            smooth(noisy[::-1], time, cutoff=cutoff)[::-1],
        )
        np.testing.assert_allclose(
            there, back, atol=2e-3 if cutoff == 3.0 else 1e-9
        )  # its start-up differs

    def test_butterworth_halves_its_cutoff_frequency(self):
        # Forward and backward: |H|^2 = 1 / (1 + (f / fc)^4), 1/2 at fc.
        time = clock(8000)
        wave = np.sin(2 * np.pi * 2.0 * time)
        middle = slice(1000, -1000)
        assert rms(smooth(wave, time, cutoff=2.0)[middle]) / rms(wave[middle]) == pytest.approx(
            0.5, abs=2e-3
        )

    @pytest.mark.parametrize("seed", range(3))
    def test_auto_removes_most_noise_and_keeps_the_signal(self, seed):
        time, truth, noisy = noisy_sine(seed=seed)
        assert rms(smooth(noisy, time) - truth) < 0.25 * rms(noisy - truth)
        assert rms(differentiate(noisy, time) - np.gradient(truth, time)) < 0.05 * rms(
            np.gradient(noisy, time)
        )

    def test_auto_leaves_a_noise_free_channel_alone(self):
        time, truth, _ = noisy_sine()
        rng = np.random.default_rng(0)
        steps = np.repeat(rng.normal(size=80), rng.integers(10, 51, 80))[
            :2400
        ]  # commands: spectrum falls as f^-2
        walk = signal.lfilter(
            [1], [1, -0.95], rng.normal(size=2400)
        )  # as an Ornstein-Uhlenbeck process does
        channels = np.column_stack([truth, steps, walk])
        change = smooth(channels, time) - channels
        assert (change.std(axis=0) < 0.02 * channels.std(axis=0)).all()

    @pytest.mark.parametrize("operation", [smooth, differentiate])
    @pytest.mark.parametrize("cutoff", CUTOFFS)
    def test_flights_do_not_meet(self, operation, cutoff):
        time, _, first = noisy_sine(seed=1)
        _, _, second = noisy_sine(seed=2, frequency=1.1, noise=0.2)
        together = operation(
            np.r_[first, second + 50],
            np.r_[time, time],
            cutoff=cutoff,
            flight=np.repeat(["a", "b"], len(time)),
        )
        apart = np.r_[
            operation(first, time, cutoff=cutoff), operation(second + 50, time, cutoff=cutoff)
        ]
        np.testing.assert_allclose(together, apart, rtol=1e-12, atol=1e-12)

    def test_not_across_a_gap(self):
        time, _, noisy = noisy_sine()
        late = np.r_[time[:1200], time[1200:] + 30]
        stepped = np.r_[noisy[:1200], noisy[1200:] + 10]
        out = smooth(stepped, late, cutoff=2.0)
        np.testing.assert_allclose(
            out[:1200], smooth(noisy[:1200], time[:1200], cutoff=2.0), atol=1e-12
        )

    def test_jittered_clock(self):
        time = clock(2400)
        jittered = time + np.random.default_rng(0).uniform(-0.2, 0.2, 2400) / RATE
        truth = np.sin(2 * np.pi * 0.4 * jittered)
        noisy = truth + np.random.default_rng(1).normal(0, 0.05, 2400)
        assert rms(smooth(noisy, jittered) - truth) < 0.02
        rate = differentiate(truth, jittered, cutoff=None)
        np.testing.assert_allclose(
            rate[5:-5], 0.8 * np.pi * np.cos(0.8 * np.pi * jittered[5:-5]), atol=1e-3
        )

    def test_lost_samples_are_bridged(self):
        time, truth, noisy = noisy_sine()
        kept = np.sort(np.random.default_rng(0).choice(2400, 2350, replace=False))
        assert rms(smooth(noisy[kept], time[kept]) - truth[kept]) < 0.02

    def test_rounded_clock_makes_no_noise(self):
        # float32 seconds late in a flight: the rate must not inherit the rounding.
        time = clock(4000, start=600.0)
        wave = np.sin(2 * np.pi * 0.8 * time)
        rounded = time.astype(np.float32).astype(float)
        exact = 1.6 * np.pi * np.cos(2 * np.pi * 0.8 * time)
        assert rms(differentiate(wave, rounded, cutoff=None) - exact) < 1e-3

    @pytest.mark.parametrize("n", [1, 2, 3, 5, 20, 127])
    def test_short_flights(self, n):
        values = np.linspace(1, 2, n)[:, None] * [1.0, 2.0]
        with pytest.warns(UserWarning, match="too short to tell noise from signal"):
            np.testing.assert_array_equal(smooth(values, clock(n)), values)
        assert smooth(values, clock(n), cutoff=2.0).shape == (n, 2)
        if n > 1:
            slope = differentiate(values, clock(n), cutoff=None)
            np.testing.assert_allclose(slope, [np.array([1, 2]) * RATE / (n - 1)] * n, rtol=1e-9)

    def test_short_stretch_borrows_its_flights_spectrum(self):
        time, truth, noisy = noisy_sine()
        late = np.r_[time[:2300], time[2300:] + 10]
        assert rms((smooth(noisy, late) - truth)[2300:]) < 0.5 * rms((noisy - truth)[2300:])


class TestJoint:
    """Channels that see the same motion: here a vane and a gyro, alpha_dot = q, on a random motion."""

    def motion(self, n=9600, seed=0):
        rng = np.random.default_rng(seed)
        alpha = signal.lfilter(
            [1], np.poly([0.97 * np.exp(0.2j), 0.97 * np.exp(-0.2j)]).real, rng.normal(size=n)
        )
        alpha *= 0.03 / alpha.std()
        truth = np.column_stack([alpha, np.gradient(alpha) * RATE])
        return clock(n), truth, truth + rng.normal(0, [0.01, 0.002], (n, 2))

    @pytest.mark.parametrize("seed", range(3))
    def test_the_gyro_helps_the_vane(self, seed):
        time, truth, noisy = self.motion(seed=seed)
        alone, together = smooth(noisy, time), smooth(noisy, time, joint=True)
        assert rms(together[:, 0] - truth[:, 0]) < 0.8 * rms(alone[:, 0] - truth[:, 0])
        rates = [differentiate(noisy, time, joint=joint)[:, 0] for joint in (False, True)]
        assert rms(rates[1] - truth[:, 1]) < 0.8 * rms(rates[0] - truth[:, 1])

    def test_scale_and_order_of_channels_do_not_matter(self):
        time, _, noisy = self.motion(2400)
        there = smooth(noisy, time, joint=True)
        other = smooth(noisy[:, ::-1] * [1e3, 1e-3], time, joint=True) / [1e3, 1e-3]
        np.testing.assert_allclose(other[:, ::-1], there, atol=1e-9)

    def test_unrelated_channels_are_smoothed_as_if_alone(self):
        time, _, noisy = noisy_sine(9600)
        walk = np.cumsum(np.random.default_rng(3).normal(size=9600)) + np.random.default_rng(
            4
        ).normal(0, 3, 9600)
        both = np.column_stack([noisy, walk])
        apart = smooth(both, time)
        change = smooth(both, time, joint=True) - apart
        assert (change.std(axis=0) < 0.1 * both.std(axis=0)).all()

    def test_channel_sampled_at_other_rows_stays_alone(self):
        time, _, noisy = self.motion(4800)
        noisy[::2, 1] = np.nan
        np.testing.assert_allclose(
            smooth(noisy, time, joint=True)[:, 0], smooth(noisy[:, :1], time, joint=True)[:, 0]
        )


class TestMissing:
    def test_nan_stays_and_does_not_spread(self):
        time, truth, noisy = noisy_sine()
        holes = np.zeros(2400, dtype=bool)
        holes[[700, 1500, 1501, 1502, 1503]] = True
        noisy[holes] = np.nan
        for operation in (smooth, differentiate):
            assert (np.isnan(operation(noisy, time)) == holes).all()
        assert rms((smooth(noisy, time) - truth)[~holes]) < 0.02

    def test_slow_sensor_keeps_its_own_clock(self):
        time, _, noisy = noisy_sine(4800)
        slow = np.where(np.arange(4800) % 8 == 0, noisy, np.nan)
        np.testing.assert_allclose(
            smooth(slow, time)[::8], smooth(noisy[::8], time[::8]), atol=1e-12
        )

    def test_empty_channel_stays_empty(self):
        assert np.isnan(smooth(np.full((300, 2), np.nan), clock(300))).all()

    def test_infinite_is_refused(self):
        with pytest.raises(ValueError, match="1 infinite values"):
            smooth([0.0, np.inf, 0.0], clock(3))


class TestNoiseLevel:
    def test_matches_the_noise_that_was_added(self):
        time, _, noisy = noisy_sine(9600, noise=0.05)
        assert noise_level(noisy, time) == pytest.approx(0.05, rel=0.08)

    def test_unknown_for_a_short_flight(self):
        assert np.isnan(noise_level(np.zeros((50, 2)), clock(50))).tolist() == [True, True]


@pytest.mark.parametrize("cutoff", [0, -1.0, np.nan, "fast", [1.0, 2.0], True])
def test_senseless_cutoffs(cutoff):
    with pytest.raises(ValueError, match=r"expected a number > 0 .Hz, or 'auto', or None"):
        smooth(np.zeros(200), clock(200), cutoff=cutoff)


def test_cutoff_above_half_the_rate():
    with pytest.raises(ValueError, match="less than half the sampling rate"):
        smooth(np.zeros(200), clock(200), cutoff=20.0)


@pytest.mark.shared
@pytest.mark.parametrize("flight", ["viggen_uav_train_latlon", "c172p_train_latlon"])
def test_real_size_flights(shared_data, flight):
    table = pd.read_parquet(shared_data / "flights" / f"{flight}.parquet")
    channels = ["alpha", "beta", "airspeed", "q", "r"]
    measured = table[channels].to_numpy(float)
    truth = table[[f"{name}_true" for name in channels]].to_numpy(float)
    left = [rms(error) for error in (smooth(measured, table.time) - truth).T]
    assert (
        left < np.array([0.4, 0.4, 0.3, 0.9, 0.75]) * [rms(error) for error in (measured - truth).T]
    ).all()
    change = smooth(truth, table.time) - truth
    assert (change.std(axis=0) < 0.01 * truth.std(axis=0)).all()
