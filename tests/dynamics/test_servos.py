"""Servos with delay, lag and rate limit, against independent solutions of T d'(t) = c(t - tau) - d(t), |d'| <= R."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import (
    Servos,
    simulate,
    trim,
)


@pytest.fixture(scope="module")
def level(glider):
    return trim(glider.model(), glider.aircraft, 20.0)


def flown(glider, level, servos, controls, dt=0.02, duration=2.0):
    model = glider.model(servos=servos)
    return simulate(model, glider.aircraft, level, controls, dt, duration=duration)


def steps_of(time, size=0.05):
    """Return commands that are held for 0.1 s each."""
    wave = np.array([0, 0, 1, 1, -1, -1, 1, 0, -1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    return size * wave[np.floor(time / 0.1 + 1e-6).astype(int).clip(0, 19)]


@pytest.mark.parametrize("dt", [0.02, 0.0125])
@pytest.mark.parametrize("delay", [0.0, 0.007, 0.02, 0.033, 0.1])
def test_held_commands_arrive_after_the_delay_and_are_followed(glider, level, followed, delay, dt):
    def law(t, state):
        return level.controls | {"aileron": steps_of(t)}

    table = flown(glider, level, Servos(0.04, delay), law, dt)
    time = table["time"].to_numpy()

    def held(t):
        return steps_of(dt * np.floor(t / dt + 1e-6))

    assert_allclose(table["aileron"], followed(held, time, 0.04, delay), atol=2e-4)


@pytest.mark.parametrize("delay", [0.007, 0.033])
def test_commands_that_change_within_steps_are_late_and_followed(glider, level, followed, delay):
    """Those of a table are linear between its rows."""
    time = 0.02 * np.arange(101)
    table = pd.DataFrame({"time": time, **level.controls, "aileron": 0.05 * np.sin(5 * time)})
    found = flown(glider, level, Servos(0.04, delay), table)

    def command(t):
        return np.interp(t, time, table["aileron"])

    expected = followed(command, found["time"].to_numpy(), 0.04, delay)
    assert_allclose(found["aileron"], expected, atol=2e-4)


@pytest.mark.parametrize("lag", [0.0, 0.04])
def test_a_rate_limit_holds_and_the_rest_is_followed(glider, level, followed, lag):
    def law(t, state):
        return level.controls | {"aileron": steps_of(t, 0.3)}

    table = flown(glider, level, Servos(lag, 0.03, rate_limit=5.0), law, 0.005, 1.5)
    rate = np.abs(np.diff(table["aileron"])) / 0.005
    assert_allclose(rate.max(), 5.0)
    assert np.abs(table["aileron"]).max() <= 0.3 + 1e-12
    if lag:
        expected = followed(lambda t: steps_of(t, 0.3), table["time"].to_numpy(), lag, 0.03, 5.0)
        assert_allclose(table["aileron"], expected, atol=2e-3)


def test_an_unknown_deflection_is_forgotten_in_the_settling_time(glider, level):
    """One of 0.05 rad before commands of zero."""
    servos = Servos(lag=0.04, delay=0.03)

    def law(t, state):
        return level.controls | {"aileron": 0.05 if t < 0.5 - 1e-6 else 0.0}

    table = flown(glider, level, servos, law)
    later = table["time"] >= 0.5 + servos.settling_time
    assert table["aileron"][~later].iloc[-3] > 0.0005
    assert_allclose(table["aileron"][later], 0.0, atol=0.0005)
