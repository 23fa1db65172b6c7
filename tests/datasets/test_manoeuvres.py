import numpy as np
import pytest

from skdgp.datasets._flight_plans import doublet, multisine, pulse, three_two_one_one

TIME = np.arange(0.0, 40.0, 0.01)


def test_pulse_lasts_its_width():
    signal = pulse(TIME, 3.0, 1.5, -0.2)
    assert signal.sum() * 0.01 == pytest.approx(-0.3, abs=2.1e-3)
    assert set(signal) == {0.0, -0.2}


def test_doublet_returns_to_where_it_began():
    signal = doublet(TIME, 2.0, 0.8, 0.1)
    assert signal[TIME < 1.999].max() == 0 == abs(signal[TIME > 3.601]).max()
    assert signal.sum() * 0.01 == pytest.approx(0.0, abs=1e-3)
    assert signal.max() == 0.1 == -signal.min()


def test_three_two_one_one_is_three_two_one_one():
    signal = three_two_one_one(TIME, 1.0, 0.5, 0.1)
    middles = 1.0 + 0.5 * (np.arange(8) + 0.5)
    np.testing.assert_array_equal(np.interp(middles, TIME, signal), [0.1, 0.1, 0.1, -0.1, -0.1, 0.1, -0.1, 0])


def test_multisine_has_its_power_in_its_harmonics_alone():
    harmonics = np.arange(10, 60, 5)
    window = (TIME >= 10.0) & (TIME < 30.0)
    signal = multisine(TIME, 10.0, 30.0, harmonics, rms=0.03)
    assert (signal[~window] == 0).all()
    power = abs(np.fft.rfft(signal[window])) ** 2 / window.sum() ** 2
    np.testing.assert_allclose(2 * power[harmonics], 0.03**2 / len(harmonics), rtol=1e-9)
    assert np.delete(power, harmonics).max() < 1e-12


def test_multisine_peaks_are_lower_than_those_of_equal_phases():
    harmonics = np.arange(2, 60, 2)
    signal = multisine(TIME, 0.0, 40.0, harmonics, rms=1.0)
    aligned = np.cos(2 * np.pi * TIME[:, None] / 40.0 * harmonics).sum(axis=1)
    assert abs(signal).max() < 2.2
    assert abs(aligned).max() / aligned.std() > 5.0
