"""Channels of slower clocks, whose last sample a log repeats: each sample counts once, at its own time."""

import warnings

import numpy as np
import pytest
from flight_columns import SURFACES, VELOCITY
from log_errors import held
from made_flights import make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

from skdgp.design import three_two_one_one
from skdgp.estimation import flights_of
from skdgp.preprocessing import FlightCheck, LagCorrector

N = 3000
LEVELS = {
    "p q r ax ay az phi theta psi v_north v_east v_down": (0, 0.07, 0.001),
    "airspeed": (15, 0.07, 0.001),
    "elevator aileron rudder": (0, 0.07, 0),
}


def log():
    """Return a flight at 50 Hz of sensors with noise, and surfaces, which move below 1 Hz."""
    return make_flight(LEVELS, N, 0.02).assign(density=1.2)


def checked(table):
    """Return the checked table, and the rates that it was told of."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        out = FlightCheck().fit_transform(table)
    rates = {}
    for warning in said:
        rates |= warning.message.finding.numbers.get("rates", {})
    return out, rates


@pytest.mark.parametrize("every", [2, 4, 5, 10])
def test_surfaces_between_samples_follow_their_motion(every):
    true = log()
    table = held(true, SURFACES, every)
    out, rates = checked(table)
    assert_allclose(list(rates.values()), [50 / every], rtol=0.01)
    assert_array_equal(out[SURFACES][::every], true[SURFACES][::every])
    inner = slice(50, -50)
    error = (out[SURFACES] - true[SURFACES])[inner].std()
    assert_array_less(error, 0.1 * (table[SURFACES] - true[SURFACES])[inner].std())


def test_sensors_of_slower_clocks_count_each_sample_once():
    table = held(log(), VELOCITY, 10)
    sparse = table.assign(**table[VELOCITY][::10].reindex(table.index))
    velocity, expected = (flights_of(each)[0].sensors.velocity for each in (table, sparse))
    assert_array_equal(velocity, expected)
    assert np.isfinite(velocity[:, 0]).sum() == 300
    lag = LagCorrector({"gps": 0.1})
    assert_array_equal(lag.fit_transform(table)[VELOCITY], lag.fit_transform(sparse)[VELOCITY])


def steps():
    """Return 3-2-1-1s with pauses."""
    time = 0.02 * np.arange(N)
    starts = np.arange(0.4, 58.0, 1.94)
    inputs = [
        three_two_one_one(0.2, 0.1 * (-1) ** k)(time - start) for k, start in enumerate(starts)
    ]
    return np.sum(inputs, axis=0)


@pytest.mark.parametrize(
    "elevator",
    [steps(), log()["elevator"].round(2), np.round(default_rng(0).normal(size=N))],
    ids=["3-2-1-1", "coarse", "coarse noise"],
)
def test_inputs_that_stand_still_are_no_slow_clock(elevator):
    """Of the other surfaces, which share their clock, none moves."""
    table = log().assign(elevator=elevator).drop(columns=["aileron", "rudder"])
    out, rates = checked(table)
    assert not rates
    assert_array_equal(out["elevator"], elevator)
