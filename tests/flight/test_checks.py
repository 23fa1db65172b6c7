"""Headings beyond a turn, and surfaces that are commands."""

import numpy as np
import pandas as pd
import pytest

from skdgp._flight.units import check_flight
from skdgp.dynamics import Aircraft, aerodynamic_coefficients


def test_an_unwrapped_heading_passes():
    table = pd.DataFrame({"time": 0.01 * np.arange(1000), "psi": np.linspace(0.0, 30.0, 1000)})
    check_flight(table, [])


@pytest.mark.parametrize("heading", [np.linspace(0.0, 359.0, 1000), np.full(1000, 90.0)])
def test_a_heading_in_degrees_is_refused(heading):
    table = pd.DataFrame({"time": 0.01 * np.arange(1000), "psi": heading})
    with pytest.raises(ValueError, match=r"degrees.*wrapped by numpy.angle"):
        check_flight(table, [])


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
