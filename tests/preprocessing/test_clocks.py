"""Channels of slower clocks, whose last sample a log repeats: each sample counts once, at its own time."""

import warnings

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.estimation import flights_of
from skdgp.preprocessing import FlightCheck, LagCorrector

STEP = 0.02
TIME = STEP * np.arange(3000)
VELOCITY = ["v_north", "v_east", "v_down"]


def motion(name):
    """Return a channel that moves below 1 Hz."""
    rng = default_rng([*map(ord, name)])
    frequencies = rng.uniform(0.1, 0.8, 4)
    phases = rng.uniform(0, 2 * np.pi, 4)
    return 0.05 * np.sin(2 * np.pi * frequencies * TIME[:, None] + phases).sum(axis=1)


def log():
    """Return a flight at 50 Hz of sensors with noise, and surfaces."""
    names = [*"pqr", "ax", "ay", "az", "phi", "theta", "psi", *VELOCITY, "airspeed"]
    table = {"time": TIME, "density": 1.2}
    for name in names:
        table[name] = motion(name) + 0.001 * default_rng(len(table)).normal(size=len(TIME))
    surfaces = {name: motion(name) for name in ("elevator", "aileron", "rudder")}
    return pd.DataFrame(table | surfaces).assign(airspeed=lambda t: t["airspeed"] + 15.0)


def held(table, names, rate):
    """Return a table in which channels are sampled at a rate [Hz], and repeated."""
    number = np.floor(TIME * rate + 1e-9)
    is_fresh = np.diff(number, prepend=-1) > 0
    sampled = table.loc[is_fresh, names].reindex(table.index)
    return table.assign(**sampled.ffill()), is_fresh


def checked(table):
    """Return the checked table, and the rates that it was told of."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        out = FlightCheck().fit_transform(table)
    rates = {}
    for warning in said:
        rates |= warning.message.finding.numbers.get("rates", {})
    return out, rates


@pytest.mark.parametrize("rate", [5.0, 10.0, 12.5, 25.0])
def test_surfaces_between_samples_follow_their_motion(rate):
    names = ["elevator", "aileron", "rudder"]
    true = log()
    table, is_fresh = held(true, names, rate)
    out, rates = checked(table)
    assert_allclose(list(rates.values()), [rate], rtol=0.01)
    assert_array_equal(out[names][is_fresh], true[names][is_fresh])
    inner = slice(50, -50)
    error = (out[names] - true[names])[inner].std()
    assert np.all(error < 0.1 * (table[names] - true[names])[inner].std())


def test_sensors_of_slower_clocks_count_each_sample_once():
    table, is_fresh = held(log(), VELOCITY, 5.0)
    sparse = table.assign(**table.loc[is_fresh, VELOCITY].reindex(table.index))
    (expected,) = flights_of(sparse)
    (sensors,) = flights_of(table)
    assert_array_equal(sensors.sensors.velocity, expected.sensors.velocity)
    assert len(np.flatnonzero(np.isfinite(sensors.sensors.velocity[:, 0]))) == 300
    lag = LagCorrector({"gps": 0.1})
    assert_array_equal(lag.fit_transform(table)[VELOCITY], lag.fit_transform(sparse)[VELOCITY])


def steps(width):
    """Return inputs of steps [rows], with pauses."""
    values = np.zeros(len(TIME))
    for k, start in enumerate(range(20, len(TIME) - 9 * width, 9 * width + 7)):
        for first, last, level in ((0, 3, 1), (3, 5, -1), (5, 6, 1), (6, 7, -1)):
            rows = slice(start + first * width, start + last * width)
            values[rows] = level * 0.1 * (-1) ** k
    return values


@pytest.mark.parametrize(
    "elevator",
    [steps(10), np.round(motion("elevator"), 2), np.round(default_rng(0).normal(size=3000))],
    ids=["3-2-1-1", "coarse", "coarse noise"],
)
def test_inputs_that_stand_still_are_no_slow_clock(elevator):
    """Of the other surfaces, which share their clock, none moves."""
    table = log().assign(elevator=elevator).drop(columns=["aileron", "rudder"])
    out, rates = checked(table)
    assert not rates
    assert_array_equal(out["elevator"], elevator)
