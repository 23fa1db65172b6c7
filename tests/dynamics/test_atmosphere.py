"""The standard atmosphere against its published table, and its own equations where layers meet."""

import numpy as np
import pytest

from skdgp.dynamics import standard_atmosphere, standard_density

# U.S. Standard Atmosphere 1976, by geopotential altitude, to the five digits that it prints:
# altitude [m], temperature [K], pressure [Pa], density [kg/m^3], speed of sound [m/s]
TABLE = [
    (0, 288.15, 101325, 1.2250, 340.29),
    (1000, 281.65, 89875, 1.1116, 336.43),
    (5000, 255.65, 54020, 0.73612, 320.53),
    (11000, 216.65, 22632, 0.36392, 295.07),
    (15000, 216.65, 12045, 0.19367, 295.07),
    (20000, 216.65, 5474.9, 0.088035, 295.07),
    (25000, 221.65, 2511.0, 0.039466, 298.45),
    (32000, 228.65, 868.02, 0.013225, 303.13),
]
EDGES = [0.0, 11000.0, 20000.0]


def five_digits(value):
    return float(f"{value:.5g}")


@pytest.mark.parametrize(("altitude", "temperature", "pressure", "density", "sound"), TABLE)
def test_the_published_table_to_its_digits(altitude, temperature, pressure, density, sound):
    air = standard_atmosphere(altitude)
    assert five_digits(air.temperature) == temperature
    assert five_digits(air.pressure) == five_digits(pressure)
    assert five_digits(air.density) == density
    assert five_digits(air.speed_of_sound) == pytest.approx(
        sound, abs=0.0101
    )  # printed from rounded temperatures
    assert standard_density(altitude) == air.density


def test_air_carries_its_own_weight():
    """Dp/dh = -rho g everywhere, and p = rho R T."""
    h = np.setdiff1d(np.arange(-4990.0, 31990.0, 370.0), EDGES)
    high, low, air = (standard_atmosphere(h + step) for step in (1.0, -1.0, 0.0))
    np.testing.assert_allclose(
        (high.pressure - low.pressure) / 2, -air.density * 9.80665, rtol=1e-8
    )
    np.testing.assert_allclose(air.pressure, air.density * 287.05287 * air.temperature, rtol=1e-14)


def test_any_shape_and_what_is_not_known():
    assert standard_density(np.zeros((2, 3))).shape == (2, 3)
    assert np.isnan(standard_density([np.nan, 0.0])).tolist() == [True, False]


@pytest.mark.parametrize("altitude", [-5000.1, 32000.1, [0.0, 1e5], np.inf])
def test_outside_its_range_it_says_so(altitude):
    for function in (standard_atmosphere, standard_density):
        with pytest.raises(ValueError, match=r"Got altitude .* m, but expected -5000 to 32000 m"):
            function(altitude)
