import numpy as np
import pytest

from skdgp._flight.channels import COEFFICIENTS, LATERAL
from skdgp.datasets._brumby import REGRESSORS, brumby_coefficients, brumby_derivatives

SCALES = np.array([0.06, 0.05, 0.03, 0.004, 0.02, 0.003, 0.006, 0.05, 0.06, 0.1])


@pytest.fixture
def envelope():
    """States scattered over what is flown, none of them degenerate."""
    rng = np.random.default_rng(3)
    points = SCALES * rng.uniform(-1.5, 1.5, (200, len(REGRESSORS)))
    points[:, 0] = rng.uniform(0.0, 0.22, 200)
    return points


def derivative(regressors, of, by):
    return brumby_derivatives(regressors)[..., COEFFICIENTS.index(of), REGRESSORS.index(by)]


def test_derivatives_are_those_of_central_differences(envelope):
    steps = 1e-5 * np.eye(len(REGRESSORS))
    points = envelope[:, None, :]
    differences = (brumby_coefficients(points + steps) - brumby_coefficients(points - steps)) / 2e-5
    np.testing.assert_allclose(
        brumby_derivatives(envelope), differences.swapaxes(-1, -2), atol=2e-8
    )


def test_mirrored_flight_has_mirrored_coefficients(envelope):
    """Left and right of the aircraft are equal: CX CZ Cm stay, CY Cl Cn change sign."""
    sides = [name in ("beta", "p", "r", "beta_dot", "aileron", "rudder") for name in REGRESSORS]
    mirrored = brumby_coefficients(np.where(sides, -envelope, envelope))
    signs = [-1.0 if name in LATERAL else 1.0 for name in COEFFICIENTS]
    np.testing.assert_allclose(mirrored, brumby_coefficients(envelope) * signs, atol=1e-15)


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
    regressors = np.zeros(len(REGRESSORS))
    for name, value in values.items():
        regressors[REGRESSORS.index(name)] = value
    return regressors


def test_lift_slope_rises_with_the_vortex_and_collapses_where_it_breaks_down():
    slope = [-derivative(at(alpha=alpha), "CZ", "alpha") for alpha in (0.02, 0.15, 0.40)]
    assert slope[1] > 1.1 * slope[0]
    assert slope[2] < 0.5 * slope[0]


def test_controls_lose_effect_with_deflection_and_elevator_takes_from_aileron():
    small, large = (-derivative(at(elevator=e), "CZ", "elevator") for e in (0.02, 0.25))
    assert large < 0.6 * small
    alone, shared = (
        derivative(at(elevator=e, aileron=0.02), "Cl", "aileron") for e in (0.0, -0.25)
    )
    assert shared < 0.6 * alone


@pytest.mark.parametrize(
    ("of", "by"), [("Cl", "beta"), ("Cl", "p"), ("Cl", "r"), ("Cn", "p"), ("CY", "beta")]
)
def test_lateral_derivatives_change_with_alpha(of, by):
    low, high = (derivative(at(alpha=alpha), of, by) for alpha in (0.05, 0.18))
    assert abs(high - low) > 0.04 * abs(low)
