"""Headings beyond a turn, surfaces that are commands, and densities of another altitude."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import Aircraft, aerodynamic_coefficients

GLIDER = Aircraft.estimate(3.0, 1.8)
LEVEL = {"airspeed": 20.0, "density": 1.2, "az": -9.8}
LEVEL |= dict.fromkeys(("p", "q", "r", "ax", "ay"), 0.0)


def coefficients(**channels):
    """Return the coefficients of a level flight with further channels."""
    table = pd.DataFrame({"time": 0.01 * np.arange(1000), **channels}).assign(**LEVEL)
    return aerodynamic_coefficients(table, GLIDER, thrust=None, cutoff=None)


@pytest.mark.parametrize("most", [30.0, 359.0])
def test_a_heading_in_degrees_or_beyond_a_turn_is_refused(most):
    with pytest.raises(ValueError, match=r"degrees.*wrapped by numpy.angle"):
        coefficients(psi=np.linspace(0.0, most, 1000))


@pytest.mark.parametrize(("elevator", "rows"), [(0.9, 900), (1.0, 5), (-1.0, 5)])
def test_commands_from_minus_one_to_one_are_warned_of(elevator, rows):
    """Beyond what servos move, or at the end of a command's range though rarely."""
    words = r"surfaces .* up to elevator [^,]*, more than .* commands from -1 to 1, multiply"
    with pytest.warns(UserWarning, match=words):
        coefficients(elevator=np.where(np.arange(1000) < rows, elevator, 0.1), rudder=0.2)


def test_deflections_of_thirty_degrees_are_angles():
    assert len(coefficients(elevator=0.5)) == 1000


def test_a_density_of_another_altitude_is_warned_of():
    with pytest.warns(UserWarning, match=r"density is 1.82 times that of the standard atmosphere"):
        coefficients(altitude=6000.0)
