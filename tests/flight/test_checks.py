"""Unwrapped radians are told from degrees, by gyros or by how they go round; surfaces that are commands."""

import numpy as np
import pandas as pd
import pytest

from skdgp._flight.units import check_flight, check_radians


def orbit(seconds=60.0, rate=40.0, *, noise=0.005, turn=0.2, seed=0):
    """Return a table of an aircraft that orbits, with its bank swinging, angles unwrapped."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, seconds, 1 / rate)
    phi = 0.4 + 0.3 * np.sin(0.7 * time)
    psi_dot = turn * (1 + 0.5 * np.sin(0.3 * time))
    psi = np.cumsum(psi_dot) / rate
    exact = {
        "phi": phi,
        "theta": 0.05 * np.sin(time),
        "psi": psi,
        "p": np.gradient(phi, 1 / rate),
        "q": psi_dot * np.sin(phi),
        "r": psi_dot * np.cos(phi),
    }
    table = pd.DataFrame(
        {name: values + rng.normal(0, noise, time.size) for name, values in exact.items()}
    )
    return table.assign(time=time, flight="a")


def rolls(**options):
    """Return an aircraft that rolls six times, once in ten seconds."""
    table = orbit(**options)
    angle = 2 * np.pi * table.time / 10
    return table.assign(phi=table.phi + angle, p=table.p + 2 * np.pi / 10)


WITHOUT_GYROS = ["p", "q", "r"]
LOGS = {"as it is": {}, "noise": {"noise": 0.03}, "no noise": {"noise": 0.0}, "slow": {"rate": 5.0}}


@pytest.mark.parametrize("dropped", [[], WITHOUT_GYROS])
@pytest.mark.parametrize("options", LOGS.values(), ids=LOGS)
@pytest.mark.parametrize(("flown", "name"), [(orbit, "psi"), (rolls, "phi")])
def test_unwrapped_radians_pass_and_degrees_do_not(flown, name, options, dropped):
    table = flown(**options).drop(columns=dropped)
    assert table[name].max() > 2 * np.pi
    check_radians(table, [name])
    for degrees in (np.rad2deg(table[name]), np.rad2deg(table[name]) % 360):
        with pytest.raises(ValueError, match=rf"Got {name} up to .* numpy.deg2rad.*wrapped by"):
            check_radians(table.assign(**{name: degrees}), [name])


@pytest.mark.parametrize("rows", [slice(1600, 1640), slice(1600, 1660)])
def test_a_second_of_a_turn_is_enough_with_gyros(rows):
    table = orbit().iloc[rows]
    assert table.psi.min() > 2 * np.pi
    check_radians(table, ["psi"])
    for degrees in (np.rad2deg(table.psi), np.rad2deg(table.psi) % 360):
        with pytest.raises(ValueError, match="Got psi up to"):
            check_radians(table.assign(psi=degrees), ["psi"])
    with pytest.raises(ValueError, match="Got psi up to"):  # nothing says where it began
        check_radians(table.drop(columns=WITHOUT_GYROS), ["psi"])


def test_a_steady_heading_in_degrees_is_refused():
    table = orbit(turn=0.0)
    heading = 90 + np.random.default_rng(0).normal(0, 0.3, len(table))
    for part in (table, table.drop(columns=WITHOUT_GYROS), table.iloc[:3]):
        for psi in (heading, 90.0):
            with pytest.raises(ValueError, match="Got psi up to"):
                check_radians(
                    part.assign(psi=np.broadcast_to(psi, len(table))[: len(part)]), ["psi"]
                )


def test_gyros_in_degrees_do_not_excuse_angles_in_degrees():
    table = orbit()
    names = ["psi", "p", "q", "r"]
    with pytest.raises(ValueError, match="Got psi up to"):
        check_radians(table.assign(**np.rad2deg(table[names])), ["psi"])


def test_each_flight_is_unwrapped_by_itself_and_spikes_do_not_matter():
    table = pd.concat([orbit(seed=1), orbit(seed=2).assign(flight="b")], ignore_index=True)
    table.loc[[700, 2000], "psi"] = -40.0
    table.loc[900:950, "psi"] = np.nan
    for part in (table, table.drop(columns=WITHOUT_GYROS)):
        check_radians(part, ["psi"])


def test_other_angles_and_single_states_have_no_turns():
    with pytest.raises(ValueError, match=r"Got theta up to 2, .*deg2rad\(flight\['theta'\]\).$"):
        check_radians(orbit().assign(theta=2.0), ["theta"])
    with pytest.raises(ValueError, match=r"Got psi up to 7\.8"):
        check_radians(pd.DataFrame({"psi": [7.8]}), ["psi"])


@pytest.mark.parametrize(
    ("name", "angle", "remedy"),
    [
        ("theta", 2.5, r"deg2rad\(flight\['theta'\]\)\.$"),
        ("psi", 7.8, "wrapped by numpy.angle"),
        ("phi", 3.3, "wrapped by numpy.angle"),
    ],
)
def test_angles_beyond_a_turn_are_refused_with_the_remedy(name, angle, remedy):
    with pytest.raises(ValueError, match=f"Got {name} up to {angle}.*{remedy}"):
        check_radians(pd.DataFrame({name: [0.0, angle]}), [name])
    check_radians(pd.DataFrame({name: [np.nan, 1.5]}), [name, "q"])


def surfaces(elevator, rows):
    time = 0.01 * np.arange(1000)
    return pd.DataFrame(
        {"time": time, "elevator": np.where(np.arange(1000) < rows, elevator, 0.1), "rudder": 0.2}
    )


@pytest.mark.parametrize(("elevator", "rows"), [(0.9, 900), (1.0, 5), (-1.0, 5)])
def test_commands_from_minus_one_to_one_are_warned_of(elevator, rows):
    """Beyond what servos move, or at the end of a command's range though rarely."""
    with pytest.warns(
        UserWarning,
        match=r"surfaces up to elevator [^,]*, more than .* commands from -1 to 1, multiply",
    ):
        check_flight(surfaces(elevator, rows), [])


def test_deflections_of_thirty_degrees_are_angles():
    check_flight(surfaces(0.5, 900), [])
