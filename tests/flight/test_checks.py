"""Degrees and unwrapped angles are refused; surfaces that are commands."""

import numpy as np
import pandas as pd
import pytest

from skdgp._flight.checks import check_flight, check_radians


def test_degrees_and_unwrapped_angles_are_refused_where_flights_are_read():
    time = 0.01 * np.arange(1000)
    for psi in (np.rad2deg(0.2 * time), 3.0 * time):
        with pytest.raises(ValueError, match=r"Got magnitudes up to .*'psi'.*can be wrapped"):
            check_flight(pd.DataFrame({"time": time, "psi": psi}), ["time"])


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
        check_flight(surfaces(elevator, rows), ["time"])


def test_deflections_of_thirty_degrees_are_angles():
    check_flight(surfaces(0.5, 900), ["time"])
