"""The flight smoother: no delay, no leak between flights, no guess where there is nothing to tell."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import FORCES, RATES
from log_errors import shake
from made_flights import make_flight, rms, wrapped
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.dynamics import air_velocity
from skdgp.preprocessing import FlightSmoother

RATE = 40.0


def clock(n):
    return np.arange(n) / RATE


def smoothed_table(table, **options):
    return FlightSmoother(**options).fit_transform(table)


@pytest.mark.parametrize(
    ("cutoff", "message"),
    [
        *((wrong, "parameter of FlightSmoother") for wrong in (0, -1.0, np.nan, "fast", [1.0])),
        (True, r"expected a number > 0 .Hz, or 'auto', or None"),
        (20.0, "less than half the sampling rate"),
    ],
)
def test_senseless_cutoffs(cutoff, message):
    with pytest.raises(ValueError, match=message):
        smoothed_table(flight(n=200), cutoff=cutoff)


def flight(name="one", n=1200):
    """Return a table of measured channels whose heading passes through pi."""
    levels = {"airspeed": (30, 0, 0.005), "alpha beta p q r elevator psi": (0, 0, 0.005)}
    table = make_flight(levels, n, 1 / RATE)
    table["psi"] += wrapped(3.0 + 0.3 * table["time"])
    return table.assign(flight=name)


def test_automatic_columns_are_the_measured_ones():
    smoother = FlightSmoother().fit(flight())
    assert smoother.columns_ == ["airspeed", "alpha", "beta", "p", "q", "r"]
    assert smoother.derivatives_ == ["alpha", "beta", "p", "q", "r"]


def test_heading_passes_through_pi():
    table = flight()
    out = smoothed_table(table, columns=["psi"])
    assert_allclose(wrapped(out.psi - 3.0 - 0.3 * table.time), 0.0, atol=0.02)
    assert_allclose(out.psi_dot, 0.3, rtol=0, atol=0.15)
    assert_allclose(out.psi, table.psi, rtol=0, atol=0.1)


def test_vibration_is_removed_with_all_that_is_beyond_the_motion():
    """Of forces, whose spectra show it as a signal, and of the controls."""
    levels = {"alpha beta p q r ax ay az elevator": (0, 0.1, 0.001)}
    table = make_flight(levels, 4800, 1 / RATE, width=4, seed=2)
    shaken = table.copy()
    for k, name in enumerate(FORCES):
        shaken[name] += 0.3 * shake(table["time"], k)
    shaken["elevator"] += 0.1 * shake(table["time"])
    smoother = FlightSmoother()
    with pytest.warns(UserWarning, match="vibrate beyond"):
        smoother.fit(shaken)
    assert 5.0 <= smoother.band_ < 8.0
    out = smoother.transform(shaken)
    for name in (*FORCES, "elevator"):
        assert rms(out[name] - table[name]) < 0.15 * rms(shaken[name] - table[name])
    assert FlightSmoother().fit(table).band_ == np.inf


def test_degrees_are_refused_in_fit_and_transform():
    table = flight().assign(alpha=np.linspace(-1.0, 1.0, 1200))  # rad
    wrong = table.assign(alpha=np.rad2deg(table["alpha"]))
    for use in (FlightSmoother().fit, FlightSmoother().fit(table).transform):
        with pytest.raises(ValueError, match="these look like degrees"):
            use(wrong)


def test_a_missing_column_is_named_once_with_its_flight():
    smoother = FlightSmoother().fit(flight())
    words = r"The flight 'two' lacks the columns 'beta'\. Rename"
    with pytest.raises(ValueError, match=words) as error:
        smoother.transform(flight("two").drop(columns="beta"))
    assert str(error.value).count("'beta'") == 1


@pytest.mark.parametrize("stands", [False, True])
def test_vanes_keep_a_transient_that_the_motion_shows(stands):
    """Of a quiet record, whose spectrum tells nothing of it, also before a landing after which a vane hangs down."""
    time = clock(720)
    alpha = 0.08 * np.exp(-3.0 * time) * np.cos(8.0 * time)
    truth = {"alpha": alpha, "beta": -0.5 * alpha}
    velocity = air_velocity(20.0, **truth)
    force = np.gradient(velocity, time, axis=0, edge_order=2) - [0.0, 0.0, 9.80665]
    still = dict.fromkeys([*RATES, "phi", "theta"], 0.0)
    table = pd.DataFrame({"time": time, "airspeed": 20.0, **truth, **still})
    table[FORCES] = force
    noise = default_rng(0).normal(0.0, 0.01, (2, len(time)))
    table[["alpha", "beta"]] += noise.T
    flown = slice(None)
    if stands:
        flown = slice(600)
        table.loc[600:, ["airspeed", "beta", "az"]] = [0.1, np.pi / 2, -9.9]
    out = smoothed_table(table)
    for name in ("alpha", "beta")[: 1 if stands else 2]:
        assert rms((out[name] - truth[name])[flown]) < 0.003
