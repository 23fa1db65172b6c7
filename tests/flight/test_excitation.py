"""Inputs: shapes, spectra, peaks, limits; sequences and their tables."""

import numpy as np
import pytest
from flight_columns import SURFACES
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.design import (
    Multisine,
    Steps,
    Wavetrain,
    doublet,
    multisine,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)

SIGNALS = {
    "doublet": doublet(0.8, 0.1),
    "3-2-1-1": three_two_one_one(0.5, -0.08),
    "steps": Steps([1.0, 0.5, 2.0], [0.02, 0.1, -0.04]),
    "multisine": multisine(20.0, range(3, 20, 2), rms=0.05).from_zero(),
}


@pytest.mark.parametrize("signal", SIGNALS.values(), ids=SIGNALS)
def test_a_signal_keeps_its_stated_peak_and_duration(signal):
    time = np.linspace(-0.1, signal.duration + 0.1, 200_001)
    values = signal(time)
    inside = (time >= -1e-5) & (time < signal.duration - 1e-5)  # clocks are rounded
    assert_allclose(values[~inside], 0.0, atol=1e-15)
    assert abs(values).max() <= signal.peak <= 1.001 * abs(values).max()
    rms = np.sqrt(np.mean(values[inside] ** 2))
    assert_allclose(getattr(signal, "rms", rms), rms, rtol=1e-3)


def test_a_multisine_from_zero_begins_and_ends_at_zero():
    signal = SIGNALS["multisine"]
    assert_allclose(signal([0.0, signal.duration - 1e-4]), 0.0, atol=2e-3 * signal.peak)


def test_three_two_one_one_is_three_two_one_one():
    middles = 0.5 * (np.arange(8) + 0.5)
    levels = [0.1, 0.1, 0.1, -0.1, -0.1, 0.1, -0.1, 0.0]
    assert_array_equal(three_two_one_one(0.5, 0.1)(middles), levels)


def test_a_multisine_has_its_power_in_its_harmonics_alone():
    harmonics = np.arange(10, 60, 5)
    power = np.linspace(1.0, 3.0, 10)
    amplitudes = 0.03 * np.sqrt(2 * power / power.sum())
    signal = Multisine(20.0, harmonics, amplitudes, np.arange(10.0))
    found = abs(np.fft.rfft(signal(np.arange(2000) * 0.01))) ** 2 / 2000**2
    assert_allclose(2 * found[harmonics], 0.03**2 * power / power.sum(), rtol=1e-9)
    angles = 2 * np.pi * harmonics * 3.7 / 20.0 + np.arange(10.0)
    assert_allclose(signal(3.7), amplitudes @ np.sin(angles))
    assert np.delete(found, harmonics).max() < 1e-20


def test_phases_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match=r"phases=.*expected 2 finite numbers"):
        Multisine(20.0, [1, 2], [0.1, 0.1], [0.0, np.nan])


@pytest.mark.parametrize(("axes", "tones", "more"), [(1, 1, 0), (2, 2, 1), (3, 1, 30), (3, 7, 2)])
def test_tones_are_dealt_out_over_the_band(axes, tones, more):
    count = axes * tones + more  # harmonics 1, 2 ... of 10 s
    limits = dict.fromkeys(SURFACES[:axes], 0.1)
    inputs = orthogonal_multisines(limits, 10.0, (0.1 - 1e-3, 0.1 * count + 1e-3), n_tones=tones)
    found = sorted(np.concatenate([one.harmonics for one in inputs.values()]))
    assert len({*found}) == axes * tones
    assert found[0] == 1
    assert 1 + 0.7 * (count - 1) * (len(found) > 1) <= found[-1] <= count


PULSE = {0.0: doublet(1.0, 0.1)}
TWO_HERTZ = Multisine(4.0, [1, 8], [0.1, 0.1], [0.0, 0.0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Steps([], []), "no durations of steps"),
        (lambda: orthogonal_multisines({"elevator": 0.1}, 4.0, (0.3, 0.4)), "fly longer"),
        (lambda: Wavetrain({"elevater": PULSE}), "nearest: 'elevator'"),
        (lambda: Wavetrain({"elevator": PULSE}, {"elevator": 0.0995}), "elevator with a peak"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(0.1, 0.1)}}).table(49.9), "at least 50 Hz"),
        (lambda: Wavetrain({"elevator": {0.0: TWO_HERTZ}}).table(19.9), "at least 20 Hz"),
        (lambda: Wavetrain({"elevator": PULSE}).table(50.0, trim={"rudder": 0.0}), "elevator"),
        (lambda: wavetrain({"elevator": doublet(1, 0.1)}), "expected mappings"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_manoeuvres_follow_one_another_with_pauses_at_trim():
    manoeuvres = [
        {"elevator": doublet(0.5, 0.1)},
        {"aileron": three_two_one_one(0.5, 0.1), "rudder": doublet(1.0, 0.2)},
        {"elevator": doublet(1.0, 0.05)},
    ]
    train = wavetrain(manoeuvres, pause=2.0)
    table = train.table(50.0, pause=1.0)
    moving = (table[SURFACES] != 0).any(axis=1)
    begins = table["time"][moving & ~moving.shift(fill_value=False)]
    assert_allclose(begins, [2.0, 5.0, 10.5])
    assert table["time"].iloc[-1] == train.duration + 1.0 == 13.5
    assert (table.drop(columns="time").iloc[-1] == 0).all()


def test_overlapping_inputs_add_up_within_limits():
    signals = {0.0: doublet(1.0, 0.06), 0.5: doublet(1.0, 0.06)}
    assert_allclose(Wavetrain({"rudder": signals})("rudder", [0.25, 0.75, 1.25]), [0.06, 0.12, 0.0])
    with pytest.raises(ValueError, match="overlapping inputs of the rudder with a peak of 0"):
        Wavetrain({"rudder": signals}, {"rudder": 0.1}).table(50.0)
