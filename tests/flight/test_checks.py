"""Unwrapped radians are told from degrees, by gyros or by how they go round; surfaces that are commands."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from skdgp.dynamics import Aircraft, Turbulence, aerodynamic_coefficients


def orbit(seconds=60.0, rate=40.0, *, noise=0.005, turn=0.2, seed=0):
    """Return a table of an aircraft that orbits, with its bank swinging, angles unwrapped."""
    rng = default_rng(seed)
    time = np.arange(0, seconds, 1 / rate)
    phi = 0.4 + 0.3 * np.sin(0.7 * time)
    psi_dot = turn * (1 + 0.5 * np.sin(0.3 * time))
    exact = {
        "phi": phi,
        "theta": 0.05 * np.sin(time),
        "psi": np.cumsum(psi_dot) / rate,
        "p": np.gradient(phi, 1 / rate),
        "q": psi_dot * np.sin(phi),
        "r": psi_dot * np.cos(phi),
    }
    measured = pd.DataFrame(exact)
    return (measured + rng.normal(0, noise, measured.shape)).assign(time=time, flight="a")


def rolls(**options):
    """Return an aircraft that rolls six times, once in ten seconds."""
    table = orbit(**options)
    angle = 2 * np.pi * table.time / 10
    return table.assign(phi=table.phi + angle, p=table.p + 2 * np.pi / 10)


OTHERS = {
    "airspeed": np.nan, "time": 0.0,
    **dict.fromkeys(("alpha", "beta", "phi", "theta", "psi", "v_north", "v_east", "v_down"), 0.0),
}  # fmt: skip


def said_of(table):
    """Return what is said of a table without airspeed: its angles are judged before its gusts are looked for."""
    whole = table.assign(**{name: value for name, value in OTHERS.items() if name not in table})
    with pytest.raises(ValueError, match="Got") as error:
        Turbulence.from_flight(whole, span=2.0)
    return str(error.value)


def assert_radians(table):
    assert "30 s" in said_of(table)  # there are no gusts


def assert_degrees(table, name):
    assert said_of(table).startswith(f"Got {name} up to ")


WITHOUT_GYROS = ["p", "q", "r"]
LOGS = {"as it is": {}, "noise": {"noise": 0.03}, "no noise": {"noise": 0.0}, "slow": {"rate": 5.0}}


@pytest.mark.parametrize("dropped", [[], WITHOUT_GYROS])
@pytest.mark.parametrize("options", LOGS.values(), ids=LOGS)
@pytest.mark.parametrize(("flown", "name"), [(orbit, "psi"), (rolls, "phi")])
def test_unwrapped_radians_pass_and_degrees_do_not(flown, name, options, dropped):
    table = flown(**options).drop(columns=dropped)
    assert table[name].max() > 2 * np.pi
    assert_radians(table)
    for degrees in (np.rad2deg(table[name]), np.rad2deg(table[name]) % 360):
        wrong = table.assign(**{name: degrees})
        assert_degrees(wrong, name)
        assert "numpy.deg2rad" in said_of(wrong)
        assert "wrapped by numpy.angle" in said_of(wrong)


@pytest.mark.parametrize("rows", [slice(1600, 1640), slice(1600, 1660)])
def test_a_second_of_a_turn_is_enough_with_gyros(rows):
    table = orbit().iloc[rows]
    assert table.psi.min() > 2 * np.pi
    assert_radians(table)
    assert_degrees(table.assign(psi=np.rad2deg(table.psi)), "psi")
    assert_degrees(table.assign(psi=np.rad2deg(table.psi) % 360), "psi")
    assert_degrees(table.drop(columns=WITHOUT_GYROS), "psi")  # nothing says where it began


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_steady_heading_in_degrees_is_refused(noise):
    table = orbit(turn=0.0)
    heading = 90 + default_rng(0).normal(0, noise, len(table))
    wrong = table.assign(psi=heading)
    for part in (wrong, wrong.drop(columns=WITHOUT_GYROS), wrong.iloc[:3]):
        assert_degrees(part, "psi")


def test_gyros_in_degrees_or_with_spikes_do_not_excuse_angles_in_degrees():
    table = orbit()
    assert_degrees(table.assign(**np.rad2deg(table[["psi", *WITHOUT_GYROS]])), "psi")
    spikes = orbit(turn=0.03)
    spikes.loc[100:110, "r"] = 30.0
    assert_degrees(spikes.assign(psi=np.rad2deg(spikes.psi)), "psi")


GLIDER = Aircraft.estimate(3.0, 1.8)


def coefficients(elevator, rows):
    """Return the coefficients of a flight whose elevator has a deflection in its first rows."""
    deflection = np.where(np.arange(1000) < rows, elevator, 0.1)
    table = pd.DataFrame({"time": 0.01 * np.arange(1000), "elevator": deflection, "rudder": 0.2})
    level = {"airspeed": 20.0, "density": 1.2, "az": -9.8}
    still = dict.fromkeys(("p", "q", "r", "ax", "ay"), 0.0)
    return aerodynamic_coefficients(
        table.assign(**level, **still), GLIDER, thrust=None, cutoff=None
    )


@pytest.mark.parametrize(("elevator", "rows"), [(0.9, 900), (1.0, 5), (-1.0, 5)])
def test_commands_from_minus_one_to_one_are_warned_of(elevator, rows):
    """Beyond what servos move, or at the end of a command's range though rarely."""
    words = r"surfaces .* up to elevator [^,]*, more than .* commands from -1 to 1, multiply"
    with pytest.warns(UserWarning, match=words):
        coefficients(elevator, rows)
