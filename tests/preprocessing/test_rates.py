"""Non-dimensional rates: the textbook's factors, and similarity."""

import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from skdgp.preprocessing import RateNondimensionalizer

B, C = 2.8, 1.2
LENGTHS = {"p": B, "q": C, "r": B, "alpha_dot": C, "beta_dot": B}
FLIGHT = pd.DataFrame({
    "airspeed": [30.0, 45.0], "p": [0.3, -1.1], "q": [0.2, 0.4], "r": [-0.1, 0.25], "alpha_dot": [0.05, -0.3],
    "beta_dot": [0.15, 0.02], "p_dot": [2.0, -5.0], "q_dot": [1.5, 0.7], "r_dot": [-0.4, 0.9], "time": [0.0, 0.02],
})  # fmt: skip


def test_every_factor():
    """A rate times l / 2V, an angular acceleration times its square."""
    out = RateNondimensionalizer(span=B, chord=C).fit_transform(FLIGHT)
    expected = FLIGHT.copy()
    for name, length in LENGTHS.items():
        factor = length / (2 * FLIGHT["airspeed"])
        expected[f"{name}_hat"] = FLIGHT[name] * factor
        if name in "pqr":
            expected[f"{name}_dot_hat"] = FLIGHT[f"{name}_dot"] * factor**2
    assert_frame_equal(out, expected, check_like=True, rtol=1e-14)


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
