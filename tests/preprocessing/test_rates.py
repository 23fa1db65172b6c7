"""Non-dimensional rates: the textbook's factors, and similarity."""

import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.preprocessing import RateNondimensionalizer

FLIGHT = pd.DataFrame(
    {
        "airspeed": [30.0, 45.0],
        "p": [0.3, -1.1],
        "q": [0.2, 0.4],
        "r": [-0.1, 0.25],
        "alpha_dot": [0.05, -0.3],
        "beta_dot": [0.15, 0.02],
        "p_dot": [2.0, -5.0],
        "q_dot": [1.5, 0.7],
        "r_dot": [-0.4, 0.9],
        "time": [0.0, 0.02],
    }
)
B = 2.8
C = 1.2
# Typed from the equations: value * factor(V).
HAND = {
    "p_hat": lambda t: t.p * B / (2 * t.airspeed),
    "q_hat": lambda t: t.q * C / (2 * t.airspeed),
    "r_hat": lambda t: t.r * B / (2 * t.airspeed),
    "alpha_dot_hat": lambda t: t.alpha_dot * C / (2 * t.airspeed),
    "beta_dot_hat": lambda t: t.beta_dot * B / (2 * t.airspeed),
    "p_dot_hat": lambda t: t.p_dot * B**2 / (4 * t.airspeed**2),
    "q_dot_hat": lambda t: t.q_dot * C**2 / (4 * t.airspeed**2),
    "r_dot_hat": lambda t: t.r_dot * B**2 / (4 * t.airspeed**2),
}


def test_every_factor():
    out = RateNondimensionalizer(span=B, chord=C).fit_transform(FLIGHT)
    assert set(out.columns) - set(FLIGHT.columns) == set(HAND)
    for name, equation in HAND.items():
        assert_allclose(out[name], equation(FLIGHT), rtol=1e-14)


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_standing_still(speed):
    flight = FLIGHT.assign(airspeed=[40.0, speed])
    with pytest.raises(ValueError, match="at row 1 and 1 rows with airspeed <= 0"):
        RateNondimensionalizer(span=B, chord=C).fit(flight)
    fitted = RateNondimensionalizer(span=B, chord=C).fit(FLIGHT)
    with pytest.raises(ValueError, match="need airspeed > 0"):
        fitted.transform(flight)


def test_misspelt_airspeed_and_no_rates():
    with pytest.raises(ValueError, match=r"'airspeed' \(nearest: 'air_speed'\)"):
        RateNondimensionalizer(span=B, chord=C).fit(
            FLIGHT.rename(columns={"airspeed": "air_speed"})
        )
    with pytest.raises(ValueError, match="lacks the columns 'p'"):
        RateNondimensionalizer(span=B, chord=C).fit(FLIGHT[["airspeed", "time"]])


@pytest.mark.parametrize("lengths", [{"span": 0.0, "chord": 1.0}, {"span": 2.0, "chord": "long"}])
def test_lengths_must_be_lengths(lengths):
    with pytest.raises(ValueError, match="parameter of RateNondimensionalizer must be"):
        RateNondimensionalizer(**lengths).fit(FLIGHT)
