"""Frequency responses from flights of a known linear aircraft, whose inputs move together."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, lfilter, lsim

from skdgp.datasets import load_example_flights
from skdgp.dynamics import frequency_response, linearize, trim
from skdgp.preprocessing import ElevonSplitter

STATES = ["v", "phi", "p", "r"]
STEP, DURATION = 0.02, 120.0
NOISE = {"p": 0.02, "r": 0.01, "ay": 0.1}


@pytest.fixture(scope="module")
def linear(glider):
    model = glider.model()
    return linearize(model, glider.aircraft, trim(model, glider.aircraft, 20.0), n_paths=20)


def band_limited(rng, n, low, high):
    """Return noise of unit power in a band [Hz]."""
    spectrum = np.fft.rfft(rng.normal(size=n))
    frequency = np.fft.rfftfreq(n, STEP)
    spectrum[(frequency < low) | (frequency > high)] = 0.0
    values = np.fft.irfft(spectrum, n)
    return values / values.std()


def flown(linear, seed, correlated=0.7, high=3.0, feedback=0.0):
    """Return a flight of the lateral motion with an aileron that the rudder follows in part, and noise."""
    rng = np.random.default_rng(seed)
    n = round(DURATION / STEP)
    time = STEP * np.arange(n)
    aileron = 0.05 * band_limited(rng, n, 0.1, high)
    rudder = correlated * aileron + 0.05 * band_limited(rng, n, 0.1, high)
    A = linear.A.loc[STATES, STATES].to_numpy()
    B = linear.B.loc[STATES, ["aileron", "rudder"]].to_numpy()
    C = linear.C.loc[["p", "r", "ay"], STATES].to_numpy()
    D = linear.D.loc[["p", "r", "ay"], ["aileron", "rudder"]].to_numpy()
    _, Y, _ = lsim((A, B, C, D), np.column_stack([aileron, rudder]), time)
    Y = Y + rng.normal(size=Y.shape) * [NOISE[name] for name in ("p", "r", "ay")]
    table = {"time": time, "aileron": aileron, "rudder": rudder}
    return pd.DataFrame(table | dict(zip(("p", "r", "ay"), Y.T, strict=True)))


def errors(found):
    """Return errors in gain [dB] and phase [deg] of rows with the true model beside them."""
    phase = (found["phase"] - found["model_phase"] + 180) % 360 - 180
    return (found["gain"] - found["model_gain"]).to_numpy(), phase.to_numpy()


def test_correlated_inputs_are_told_apart(linear):
    found = frequency_response(flown(linear, 0), ["aileron", "rudder"], ["p", "r"], linear=linear)
    excited = found[found["excited"]]
    main = pd.concat([excited.loc[("p", "aileron")], excited.loc[("r", "rudder")]])
    frequency = main.index
    assert frequency.min() < 2.0
    assert frequency.max() > 15.0
    gain, phase = errors(main)
    assert np.sqrt(np.mean(gain**2)) < 0.5
    assert np.sqrt(np.mean(phase**2)) < 4.0
    for what in ("gain", "phase"):
        lower, upper = found[f"model_{what}_lower"], found[f"model_{what}_upper"]
        assert found[f"model_{what}"].between(lower, upper).mean() > 0.9


def test_coherence_is_of_what_the_other_input_does_not_explain(linear):
    """A channel that follows the rudder has nothing of the aileron, which the rudder follows."""
    flight = flown(linear, 0, correlated=2.0)
    noise = np.random.default_rng(1).normal(0, 0.01, len(flight))
    follower = flight.assign(y=flight["rudder"] + noise)
    found = frequency_response(follower, ["aileron", "rudder"], ["y"])["coherence"]
    assert found.loc[("y", "rudder")].loc[1.0:15.0].min() > 0.9
    assert found.loc[("y", "aileron")].loc[1.0:15.0].mean() < 0.1


def test_a_linear_model_without_the_outputs_is_refused(linear):
    flight = flown(linear, 0).assign(y=np.random.default_rng(0).normal(size=6000))
    with pytest.raises(ValueError, match="outputs of the linear model lack 'y'"):
        frequency_response(flight, ["aileron"], ["y"], linear=linear)


DECAY = np.exp(-10.0 * STEP)


def fed_back(excitation, gust, noise, gain, late):
    """Return a flight in gusts of an aileron that follows the noisy rate, `late` samples later."""
    n = len(excitation)
    rate, aileron = np.zeros(n), np.zeros(n)
    for k in range(1, n):
        rate[k] = DECAY * rate[k - 1] + (1 - DECAY) * 6.0 * (aileron[k - 1] + gust[k - 1])
        aileron[k] = excitation[k] - gain * (rate[k - late] + noise[k - late])
    return pd.DataFrame({"time": STEP * np.arange(n), "aileron": aileron, "p": rate + noise})


def test_beyond_the_excitation_nothing_counts():
    """A feedback of the noisy rate moves the aileron there: coherence is high, the response that of -1 / K."""
    rng = np.random.default_rng(0)
    n = round(DURATION / STEP)
    excitation = 0.05 * band_limited(rng, n, 0.1, 1.0)
    flight = fed_back(excitation, np.zeros(n), rng.normal(0, 0.05, n), 0.05, late=0)
    found = frequency_response(flight, ["aileron"], ["p"]).loc[("p", "aileron")]
    above = found.loc[15.0:]
    assert above["coherence"].min() > 0.8
    assert_allclose(above["gain"], 20 * np.log10(1 / 0.05), atol=2.0)
    assert not above["excited"].any()
    assert found.loc[1.5:5.0, "excited"].all()


def test_gusts_that_an_autopilot_feeds_back_are_no_excitation():
    """The rate answers gusts far above its noise, the aileron the rate, one sample later."""
    rng = np.random.default_rng(0)
    n = round(DURATION / STEP)
    excitation = lfilter(*butter(2, 1.0, fs=1 / STEP), rng.normal(0, 0.3, n))
    gust = rng.normal(0, 0.05, n)
    flight = fed_back(excitation, gust, rng.normal(0, 0.001, n), 0.2, late=1)
    found = frequency_response(flight, ["aileron"], ["p"]).loc[("p", "aileron")]
    z = np.exp(1j * STEP * found.index.to_numpy(float))
    error = (found["gain"] - 20 * np.log10(np.abs((1 - DECAY) * 6.0 / (z - DECAY)))).abs()
    assert error.loc[30.0:].min() > 5.0
    assert found.loc[30.0:, "coherence"].min() > 0.6
    assert not found.loc[30.0:, "excited"].any()
    assert found["excited"].sum() >= 10
    assert error[found["excited"]].max() < 2.0


@pytest.mark.slow
def test_of_the_example_flights():
    """Their autopilot feeds back what gusts do. The multisine of the aileron ends at 2 Hz."""
    flights = load_example_flights()
    log = ElevonSplitter().fit_transform(flights.train)
    steady = trim(
        flights.truth, flights.aircraft, log["airspeed"].mean(), altitude=log["altitude"].mean()
    )
    true = linearize(flights.truth, flights.aircraft, steady)
    inputs = ["elevator", "aileron", "rudder"]
    found = frequency_response(log, inputs, ["p", "q", "r"], linear=true)
    for pair in (("p", "aileron"), ("q", "elevator"), ("r", "rudder")):
        sure = found.loc[pair].query("excited")
        gain, phase = errors(sure)
        assert np.sqrt(np.mean(gain**2)) < 1.5
        assert np.sqrt(np.mean(phase**2)) < 5.0
        assert 10.0 < sure.index.max() < 1.1 * 2 * np.pi * 2.0


@pytest.mark.parametrize("is_missing", [False, True])
def test_gaps_divide_records(linear, is_missing):
    flight = flown(linear, 2)
    is_gap = flight["time"].between(50, 60)
    parts = flight.assign(p=flight["p"].mask(is_gap)) if is_missing else flight[~is_gap]
    found = frequency_response(parts, ["aileron", "rudder"], ["p"], linear=linear)
    main = found[found["excited"]].loc[("p", "aileron")]
    assert np.sqrt(np.mean(errors(main)[0] ** 2)) < 0.7


class TestRefuses:
    @pytest.mark.parametrize(
        ("inputs", "outputs", "message"),
        [
            ([], ["p"], "but expected names of columns, each once"),
            (["aileron", "aileron"], ["p"], "each once"),
            (["flap"], ["p"], "flap"),
            (["still"], ["p"], r"Got columns \['still'\] that do not move"),
        ],
    )
    def test_names(self, linear, inputs, outputs, message):
        flight = flown(linear, 0).assign(still=0.1)
        with pytest.raises(ValueError, match=message):
            frequency_response(flight, inputs, outputs)

    def test_short_records(self, linear):
        flight = flown(linear, 0)
        message = r"Got records of 4.0 s, .* but expected at least 5 s"
        with pytest.raises(ValueError, match=message):
            frequency_response(flight.iloc[:200], ["aileron"], ["p"])
        assert len(frequency_response(flight.iloc[:500], ["aileron"], ["p"]))
