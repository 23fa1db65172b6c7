"""Smoothing of channels: no delay, no leak between flights, no guess where there is nothing to tell."""

import numpy as np
import pandas as pd
import pytest
from made_flights import rms
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from skdgp.preprocessing import FlightSmoother

RATE = 40.0
CUTOFFS = ["auto", 3.0, None]


def clock(n):
    return np.arange(n) / RATE


def noisy_sine(n=2400, noise=0.05, frequency=0.4, seed=0):
    time = clock(n)
    truth = np.sin(2 * np.pi * frequency * time + 0.3)
    return time, truth, truth + default_rng(seed).normal(0, noise, n)


def filtered(values, time, flight=None, **options):
    """Return channels (n,) or (n, k) that have nothing to do with each other, smoothed, and their rates of change."""
    columns = np.reshape(values, (len(time), -1))
    names = [f"channel {k}" for k in range(columns.shape[1])]
    table = pd.DataFrame(columns, columns=names).assign(time=time)
    if flight is not None:
        table["flight"] = flight
    out = FlightSmoother(columns=names, **options).fit_transform(table)
    rates = [f"{name}_dot" for name in names]
    shape = np.shape(values)
    return out[names].to_numpy().reshape(shape), out[rates].to_numpy().reshape(shape)


def smooth(values, time, **options):
    return filtered(values, time, **options)[0]


class TestSmooth:
    @pytest.mark.parametrize("cutoff", CUTOFFS)
    def test_constant_and_line_are_kept(self, cutoff):
        time = clock(1200)
        lines = np.column_stack([np.full(1200, 7.0), 2.0 - 0.3 * time])
        smoothed, rates = filtered(lines, time, cutoff=cutoff)
        assert_allclose(smoothed, lines, atol=1e-9)
        assert_allclose(rates, [[0.0, -0.3]] * 1200, atol=1e-7)

    @pytest.mark.parametrize(("cutoff", "atol"), [("auto", 1e-9), (3.0, 2e-3), (None, 1e-9)])
    def test_time_reversal_commutes(self, cutoff, atol):
        """A filter without delay treats a log and its mirror image alike; only its start-up differs."""
        time, _, noisy = noisy_sine()
        back = smooth(noisy[::-1], time, cutoff=cutoff)[::-1]
        assert_allclose(smooth(noisy, time, cutoff=cutoff), back, atol=atol)

    def test_butterworth_halves_its_cutoff_frequency(self):
        """Forward and backward: |H|^2 = 1 / (1 + (f / fc)^4), 1/2 at fc."""
        time = clock(8000)
        wave = np.sin(2 * np.pi * 2.0 * time)
        middle = slice(1000, -1000)
        gain = rms(smooth(wave, time, cutoff=2.0)[middle]) / rms(wave[middle])
        assert_allclose(gain, 0.5, rtol=0, atol=2e-3)

    def test_auto_removes_most_noise_and_keeps_the_signal(self):
        time, truth, noisy = noisy_sine()
        smoothed, rate = filtered(noisy, time)
        assert rms(smoothed - truth) < 0.25 * rms(noisy - truth)
        assert rms(rate - np.gradient(truth, time)) < 0.05 * rms(np.gradient(noisy, time))

    @pytest.mark.parametrize("n", [500, 900])
    def test_auto_finds_the_noise_of_short_records(self, n):
        for seed in range(20):
            time, truth, noisy = noisy_sine(n, noise=0.3, seed=seed)
            assert rms(smooth(noisy, time) - truth) < 0.6 * rms(noisy - truth)

    def test_auto_leaves_a_noise_free_channel_alone(self):
        """Commands in steps, whose spectrum falls as f^-2, and a walk, as an Ornstein-Uhlenbeck process does."""
        time, truth, _ = noisy_sine()
        rng = default_rng(0)
        steps = np.repeat(rng.normal(size=80), rng.integers(10, 51, 80))[:2400]
        walk = signal.lfilter([1], [1, -0.95], rng.normal(size=2400))
        channels = np.column_stack([truth, steps, walk])
        change = smooth(channels, time) - channels
        assert (change.std(axis=0) < 0.02 * channels.std(axis=0)).all()

    @pytest.mark.parametrize("place", [0.3, 0.6])
    def test_auto_leaves_a_resonance_alone(self, place):
        """Of a slow log, at a part of half its rate."""
        n, fine = 900, 20
        w = np.pi * place / fine  # [rad/sample]
        system = signal.bilinear([w**2], [1, 0.2 * w, w**2])
        for seed in range(6):
            values = signal.lfilter(*system, default_rng(seed).normal(size=n * fine))[::fine]
            assert rms(smooth(values, clock(n)) - values) < 0.02 * rms(values)

    @pytest.mark.parametrize("cutoff", CUTOFFS)
    def test_flights_do_not_meet(self, cutoff):
        time, _, first = noisy_sine(seed=1)
        _, _, second = noisy_sine(seed=2, frequency=1.1, noise=0.2)
        flights = np.repeat(["a", "b"], len(time))
        together = filtered(np.r_[first, second + 50], np.r_[time, time], flights, cutoff=cutoff)
        apart = [filtered(values, time, cutoff=cutoff) for values in (first, second + 50)]
        assert_allclose(together, np.hstack(apart), rtol=1e-12, atol=1e-12)

    def test_not_across_a_gap(self):
        time, _, noisy = noisy_sine()
        late = time + np.where(time < 30, 0, 30)
        out = smooth(noisy + np.where(time < 30, 0, 10), late, cutoff=2.0)
        assert_allclose(out[:1200], smooth(noisy[:1200], time[:1200], cutoff=2.0), atol=1e-12)

    def test_jittered_clock(self):
        jittered = clock(2400) + default_rng(0).uniform(-0.2, 0.2, 2400) / RATE
        truth = np.sin(2 * np.pi * 0.4 * jittered)
        noisy = truth + default_rng(1).normal(0, 0.05, 2400)
        assert rms(smooth(noisy, jittered) - truth) < 0.02
        _, rate = filtered(truth, jittered, cutoff=None)
        exact = 0.8 * np.pi * np.cos(0.8 * np.pi * jittered)
        assert_allclose(rate[5:-5], exact[5:-5], atol=1e-3)

    @pytest.mark.parametrize("n", [2, 3, 5, 20, 127])
    def test_short_flights(self, n):
        values = np.linspace(1, 2, n)[:, None] * [1.0, 2.0]
        with pytest.warns(UserWarning, match="too short to tell noise from signal"):
            assert_array_equal(smooth(values, clock(n)), values)
        assert np.isfinite(smooth(values, clock(n), cutoff=2.0)).all()
        _, slope = filtered(values, clock(n), cutoff=None)
        assert_allclose(slope, [np.array([1, 2]) * RATE / (n - 1)] * n, rtol=1e-9)

    def test_short_stretch_borrows_its_flights_spectrum(self):
        time, truth, noisy = noisy_sine()
        late = np.r_[time[:2300], time[2300:] + 10]
        assert rms((smooth(noisy, late) - truth)[2300:]) < 0.5 * rms((noisy - truth)[2300:])


class TestMissing:
    def test_nan_stays_and_does_not_spread(self):
        time, truth, noisy = noisy_sine()
        holes = [700, 1500, 1501, 1502, 1503]
        noisy[holes] = np.nan
        smoothed, rate = filtered(noisy, time)
        assert np.flatnonzero(np.isnan(smoothed)).tolist() == holes
        assert np.flatnonzero(np.isnan(rate)).tolist() == holes
        assert rms(np.delete(smoothed - truth, holes)) < 0.02

    def test_slow_sensor_keeps_its_own_clock(self):
        time, _, noisy = noisy_sine(4800)
        slow = np.where(np.arange(4800) % 8 == 0, noisy, np.nan)
        assert_allclose(smooth(slow, time)[::8], smooth(noisy[::8], time[::8]), atol=1e-12)

    def test_a_single_sample_has_no_rate(self):
        smoothed, rate = filtered([[1.0, 2.0]], clock(1), cutoff=2.0)
        assert_array_equal(smoothed, [[1.0, 2.0]])
        assert np.isnan(rate).all()

    def test_empty_channel_stays_empty(self):
        assert np.isnan(smooth(np.full((300, 2), np.nan), clock(300))).all()

    def test_infinite_is_refused(self):
        with pytest.raises(ValueError, match="1 infinite values"):
            smooth([0.0, np.inf, 0.0], clock(3))


def test_a_flight_of_jsbsim(jsbsim_flight):
    table = jsbsim_flight("c172p", "light")
    channels = ["alpha", "beta", "airspeed", "q", "r"]
    measured = table[channels].to_numpy(float)
    truth = table[[f"{channel}_true" for channel in channels]].to_numpy(float)
    left = rms(smooth(measured, table.time) - truth)
    assert (left < [0.65, 0.5, 0.5, 0.9, 0.75] * rms(measured - truth)).all()
    change = smooth(truth, table.time) - truth
    assert (change.std(axis=0) < 0.01 * truth.std(axis=0)).all()
