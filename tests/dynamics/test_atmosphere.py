"""The standard atmosphere against its published table, and its own equations on both sides of 11 km."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import standard_density

# U.S. Standard Atmosphere 1976, by geopotential altitude [m], to the five digits that it prints [kg/m^3]
TABLE = [
    (0, 1.2250),
    (1000, 1.1116),
    (5000, 0.73612),
    (11000, 0.36392),
    (15000, 0.19367),
    (20000, 0.088035),
]


@pytest.mark.parametrize(("altitude", "density"), TABLE)
def test_the_published_table_to_its_digits(altitude, density):
    assert float(f"{standard_density(altitude):.5g}") == density


def test_air_carries_its_own_weight():
    """Dp/dh = -rho g everywhere, with p = rho R T."""
    h = np.setdiff1d(np.arange(-4990.0, 19990.0, 370.0), [11000.0])

    def pressure(h):
        return standard_density(h) * 287.05287 * (288.15 - 0.0065 * np.minimum(h, 11000.0))

    slope = (pressure(h + 1.0) - pressure(h - 1.0)) / 2
    assert_allclose(slope, -standard_density(h) * 9.80665, rtol=1e-8)


def test_any_shape_and_what_is_not_known():
    assert standard_density(np.zeros((2, 3))).shape == (2, 3)
    assert np.isnan(standard_density([np.nan, 0.0])).tolist() == [True, False]


@pytest.mark.parametrize("altitude", [-5000.1, 20000.1, [0.0, 1e5], np.inf])
def test_outside_its_range_it_says_so(altitude):
    with pytest.raises(ValueError, match=r"Got altitude .* m, but expected -5000 to 20000 m"):
        standard_density(altitude)
