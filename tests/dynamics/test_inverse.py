"""Inverse dynamics: what was flown comes back, and what cannot be right is refused."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS, FORCES, SPIN
from log_errors import elsewhere
from made_flights import GLIDER, rms
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy import signal

from skdgp.dynamics import aerodynamic_coefficients


def relative(got, expected):
    """Root mean square errors over the standard deviations of the truth, (6,)."""
    return rms(got - expected) / np.std(expected, axis=0)


def test_simulated_flight_gives_its_coefficients_back(simulated, aircraft, true_coefficients):
    got = aerodynamic_coefficients(simulated, aircraft, cutoff=None)
    assert list(got.columns) == COEFFICIENTS
    assert_allclose(got, true_coefficients, atol=1e-12)


def test_rates_are_differentiated_where_accelerations_are_not_measured(
    simulated, aircraft, true_coefficients
):
    got = aerodynamic_coefficients(simulated.drop(columns=SPIN), aircraft, cutoff=None)
    assert relative(got, true_coefficients).max() < 2e-3
    two_of_three = simulated.drop(columns="q_dot").assign(p_dot=1e3)
    assert_frame_equal(aerodynamic_coefficients(two_of_three, aircraft, cutoff=None), got)


def test_sensors_half_a_metre_ahead_give_the_same_coefficients(
    simulated, aircraft, true_coefficients
):
    arm = (0.5, 0.1, -0.2)
    flight = elsewhere(simulated, arm, simulated[SPIN])
    placed = replace(aircraft, sensor_position=arm)
    assert (
        relative(aerodynamic_coefficients(flight, aircraft, cutoff=None), true_coefficients).max()
        > 0.5
    )
    got = aerodynamic_coefficients(flight, placed, cutoff=None)
    assert_allclose(got, true_coefficients, atol=1e-12)
    got = aerodynamic_coefficients(flight.drop(columns=SPIN), placed, cutoff=None)
    assert relative(got, true_coefficients).max() < 3e-3


FORCE = 0.5 * 1.2 * 12.0**2 * 0.5  # dynamic pressure and wing area of `surge` [N]


def surge(rng, size, n):
    """Return a glide whose forward acceleration, up to 1 Hz, has noise of 0.1 m/s^2, and its true CX."""
    below = signal.butter(4, 1.0, fs=50, output="sos")
    wave = signal.sosfiltfilt(below, rng.normal(size=n))
    wave *= size / wave.std()
    still = dict.fromkeys(["ay", "p", "q", "r"], 0.0)
    flight = pd.DataFrame({"time": 0.02 * np.arange(n), "airspeed": 12.0, "az": -9.8} | still)
    return flight.assign(density=1.2, ax=wave + rng.normal(0, 0.1, n)), 2.0 * wave / FORCE


def test_smoothing_does_not_shrink_a_signal_that_hardly_exceeds_its_noise():
    """Slopes of targets on what they depend on keep their size. A Wiener smoother has 0.8 here."""
    slopes = []
    for seed in range(6):
        flight, true = surge(default_rng(seed), 0.04, 6000)
        CX = aerodynamic_coefficients(flight, GLIDER, thrust=None)["CX"]
        slopes.append(np.polyfit(true, CX, 1)[0])
    assert_allclose(np.mean(slopes), 1.0, rtol=0, atol=0.05)


def test_a_mass_that_falls_is_that_of_each_row(simulated, aircraft, true_coefficients):
    """The same force gives a lighter aircraft more specific force."""
    burnt = np.linspace(1.0, 0.8, len(simulated))
    lighter = simulated.assign(mass=burnt * aircraft.mass)
    lighter[FORCES] /= burnt[:, None]
    got = aerodynamic_coefficients(lighter, aircraft, cutoff=None)
    assert_allclose(got, true_coefficients, atol=1e-12)
    with pytest.raises(ValueError, match="mass of 0 kg at row 3"):
        aerodynamic_coefficients(
            lighter.assign(mass=[5.0] * 3 + [0.0] * (len(lighter) - 3)), aircraft
        )


def test_forces_of_a_tether_among_those_of_the_thrust_are_taken_away(
    simulated, aircraft, true_coefficients
):
    tether, twist = np.array([3.0, -8.0, 40.0]), [0.4, 0.2, -0.1]
    pulled = simulated.copy()
    pulled[FORCES] += tether / aircraft.mass
    pulled[SPIN] += np.linalg.solve(aircraft.inertia, twist)
    for axis, value in zip(["x", "y", "z", "l", "m", "n"], [*tether, *twist], strict=True):
        pulled[f"thrust_{axis}"] = pulled.get(f"thrust_{axis}", 0.0) + value
    got = aerodynamic_coefficients(pulled, aircraft, cutoff=None)
    assert_allclose(got, true_coefficients, atol=1e-12)


@pytest.mark.parametrize("name", ["airspeed", "density", "ay", "q", "q_dot", "thrust_x"])
@pytest.mark.parametrize("cutoff", [None, "auto"])
def test_nan_rows_give_nan_there_and_nowhere_else(simulated, aircraft, name, cutoff):
    flight = simulated.copy()
    flight.loc[100:109, name] = np.nan
    missing = aerodynamic_coefficients(flight, aircraft, cutoff=cutoff).isna().all(axis=1)
    assert missing.iloc[100:110].all()
    assert missing.sum() == 10


@pytest.mark.filterwarnings("ignore:Faults in the log")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.drop(columns="density"), "lacks the columns 'density'"),
        (lambda f: f.rename(columns={"airspeed": "air_speed"}), "'airspeed' .nearest: 'air_speed'"),
        (
            lambda f: f.assign(airspeed=f["airspeed"].where(f.index < 7, 0.0)),
            "airspeed 0 m/s at row 7 and .* rows",
        ),
        (lambda f: f.assign(time=f["time"].where(f.index != 7, 0.0)), "expected time to increase"),
        (
            lambda f: f.drop(columns=["thrust_x", "thrust_y", "thrust_z"]),
            "thrust is unknown",
        ),
    ],
)
def test_flights_that_cannot_be(simulated, aircraft, change, words):
    with pytest.raises(ValueError, match=words):
        aerodynamic_coefficients(change(simulated), aircraft)
