"""The true aerodynamics of the example flights: symmetric, stable, damped, and not linear."""

from functools import cache

import numpy as np
import pytest
from flight_columns import COEFFICIENTS, SURFACES
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.datasets import load_example_flights

REGRESSORS = ["alpha", "beta", "p", "q", "r", "alpha_dot", "beta_dot", *SURFACES]
SCALES = [0.06, 0.05, 0.03, 0.004, 0.02, 0.003, 0.006, 0.05, 0.06, 0.1]


@cache
def data():
    return load_example_flights(duration=1.0)


def aerodynamics(regressors):
    """Return the six coefficients at regressors (..., 10)."""
    return data().aerodynamics(regressors)


@pytest.fixture
def envelope():
    """States scattered over what is flown, none of them degenerate."""
    rng = default_rng(3)
    points = SCALES * rng.uniform(-1.5, 1.5, (200, len(REGRESSORS)))
    points[:, 0] = rng.uniform(0.0, 0.22, 200)
    return points


def derivative(points, of, by):
    """Return a derivative at regressors (..., 10) by a complex step, which is exact to rounding."""
    step = 1e-30j * (np.array(REGRESSORS) == by)
    return aerodynamics(points + step)[..., COEFFICIENTS.index(of)].imag / 1e-30


def test_mirrored_flight_has_mirrored_coefficients(envelope):
    """Left and right of the aircraft are equal: CX CZ Cm stay, CY Cl Cn change sign."""
    mirrored = np.isin(REGRESSORS, ["beta", "p", "r", "beta_dot", "aileron", "rudder"])
    expected = aerodynamics(envelope) * [1, -1, 1, -1, 1, -1]
    assert_allclose(aerodynamics(np.where(mirrored, -envelope, envelope)), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("of", "by", "sign"),
    [
        ("CZ", "alpha", -1), ("Cm", "alpha", -1), ("Cm", "q", -1), ("Cm", "alpha_dot", -1), ("Cm", "elevator", -1),
        ("CZ", "elevator", -1), ("CY", "beta", -1), ("Cl", "beta", -1), ("Cn", "beta", 1), ("Cl", "p", -1),
        ("Cl", "r", 1), ("Cn", "r", -1), ("Cl", "aileron", 1), ("Cn", "rudder", -1), ("CY", "rudder", 1),
    ],
)  # fmt: skip
def test_aircraft_is_stable_damped_and_answers_its_controls(envelope, of, by, sign):
    assert (sign * derivative(envelope, of, by) > 0).all()


def at(**values):
    """Return regressors that are zero but for these values, (n, 10)."""
    columns = [np.add(values.get(name, 0.0), np.zeros(3)) for name in REGRESSORS]
    return np.stack(columns, axis=-1)


def test_lift_slope_rises_with_the_vortex_and_collapses_where_it_breaks_down():
    low, vortex, broken = -derivative(at(alpha=[0.02, 0.15, 0.40]), "CZ", "alpha")
    assert vortex > 1.1 * low
    assert broken < 0.5 * low


def test_controls_lose_effect_with_deflection_and_elevator_takes_from_aileron():
    small, _, large = -derivative(at(elevator=[0.02, 0.1, 0.25]), "CZ", "elevator")
    assert large < 0.6 * small
    shared, _, alone = derivative(at(elevator=[-0.25, -0.1, 0.0], aileron=0.02), "Cl", "aileron")
    assert shared < 0.6 * alone
