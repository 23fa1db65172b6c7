"""The band of the motion, and what both sides of an equation lose beyond it."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy import signal

from skdgp._flight.motion_band import motion_band_of, vibrates_beyond
from skdgp._flight.smoothing import FittedFilter, smooth

RATE = 40.0
NAMES = ["p", "q", "r", "elevator"]


def shaken(size):
    """Return motion below 4 Hz, with a vibration of the rates whose frequency changes, 8 to 14 Hz."""
    rng = default_rng(2)
    n = 4800
    window = signal.windows.hann(20)
    motion = signal.fftconvolve(rng.normal(size=(n, 4)), window[:, None], "same", axes=0)
    table = pd.DataFrame(motion, columns=NAMES).assign(time=np.arange(n) / RATE)
    frequency = 11 + 3 * np.sin(0.2 * table["time"])
    wave = np.sin(2 * np.pi * np.cumsum(frequency) / RATE)
    for name in ("p", "q", "r"):
        table[name] += size * table[name].std() * wave
    return table


@pytest.mark.parametrize(("vibration", "noise"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
def test_vibration_of_the_rates_and_noise_of_the_surfaces_do_not_widen_it(vibration, noise):
    table = shaken(vibration)
    table["elevator"] += noise * table["elevator"].std() * default_rng(0).normal(size=len(table))
    assert 1.5 < motion_band_of(table) < 5.0


def test_forces_beyond_it_are_vibration():
    table = shaken(1.0)
    rng = default_rng(1)
    band = motion_band_of(table)
    for name in ("ax", "ay", "az"):
        table[name] = table["elevator"] + 0.5 * table["elevator"].std() * rng.normal(
            size=len(table)
        )
    assert not vibrates_beyond(table, band)
    shaking = table["p"] - shaken(0.0)["p"]
    table["ax"] += 3 * shaking
    assert not vibrates_beyond(table, band)
    table["az"] += 3 * shaking
    assert vibrates_beyond(table, band)


def test_an_equation_of_channels_remains_true():
    """Force by elevator and rate, beside a vibration that both inertial sensors feel."""
    calm = shaken(0.0)
    table = shaken(1.0)
    force = 2.0 * calm["elevator"] - 3.0 * calm["p"] + 5 * (table["p"] - calm["p"])
    columns = np.column_stack([table["elevator"], table["p"], force])
    band = motion_band_of(table)
    out = smooth(columns, table["time"], cutoff=FittedFilter.up_to(band, 3))
    slopes, *_ = np.linalg.lstsq(out[:, :2], out[:, 2], rcond=None)
    assert_allclose(slopes, [2.0, -3.0], rtol=0.01)


def test_a_wave_beyond_it_is_removed_and_one_within_it_is_kept():
    time = np.arange(4800) / RATE
    waves = np.sin(2 * np.pi * np.outer(time, [2.0, 12.0]))
    out = smooth(waves, time, cutoff=FittedFilter.up_to(5.0, 2))
    middle = slice(200, -200)
    assert_allclose(out[middle], waves[middle] * [1.0, 0.0], atol=0.01)


def test_without_rates_and_surfaces_it_is_unknown():
    assert motion_band_of(shaken(0.0)[["time"]].assign(alpha=0.1)) == np.inf
    assert motion_band_of(shaken(0.0).iloc[:60]) == np.inf
