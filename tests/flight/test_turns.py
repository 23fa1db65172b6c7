"""Airspeed from turns: the wind triangle, its deviations, and flights that do not tell."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import Aircraft
from skdgp.dynamics._aircraft import PRESSURE, ScaleFactor, relative_errors
from skdgp.identification._assumed import with_airspeed_errors
from skdgp.identification._flights import named_flights
from skdgp.preprocessing import FlightDataWarning, airspeed_from_turns

GROUND = ["time", "flight", "v_north", "v_east", "v_down"]


def circling(wind=(6.0, -3.0), bank=0.4, offset=0.0, seed=0):
    """Return a coordinated flight of 2 minutes that climbs in circles, whose airspeed rises from 19 to 21 m/s."""
    t, rng = np.arange(0, 120, 0.1), np.random.default_rng(seed)
    speed = 19 + t / 60
    psi, climb = np.tan(bank) * 9.81 / 20 * t, 0.05
    v = rng.normal(0, 0.1, (3, len(t)))
    v += [
        speed * np.cos(climb) * np.cos(psi) + wind[0],
        speed * np.cos(climb) * np.sin(psi) + wind[1],
        -climb * speed,
    ]
    table = dict(zip(GROUND[2:], v, strict=True)) | {"phi": bank, "psi": psi + offset}
    # The body's x axis is alpha = .1 above the path, in the plane of symmetry: its sink is
    # -sin(theta).
    theta = np.arctan(np.cos(bank) * np.tan(0.1)) + climb
    return pd.DataFrame({"time": t, "flight": "a", **table, "theta": theta, "truth": speed})


@pytest.mark.parametrize("heading", [True, False])
def test_airspeed_and_wind_are_those_of_the_triangle(heading):
    flight = circling()
    found = airspeed_from_turns(flight if heading else flight[GROUND])
    error = (found["airspeed"] - flight["truth"]).to_numpy()
    assert np.sqrt(np.mean(error**2)) < 0.4
    assert np.mean(np.abs(error) < 2 * found["airspeed_std"]) > 0.9
    assert np.abs(found[["wind_north", "wind_east"]].mean() - [6, -3]).max() < 0.4


def test_an_offset_of_the_heading_is_found():
    flight = circling(offset=0.1)
    error = airspeed_from_turns(flight)["airspeed"] - flight["truth"]
    assert np.sqrt(np.mean(error**2)) < 0.4


def test_flights_are_told_apart_and_missing_velocity_is_not_used():
    one, other = circling(), circling(wind=(-8.0, 0.0)).assign(flight="b")
    one.loc[10:20, "v_east"] = np.nan
    found = airspeed_from_turns(pd.concat([one, other], ignore_index=True))
    assert found["airspeed"].isna().sum() == 11
    assert found["wind_north"].iloc[0] > 4 > -6 > found["wind_north"].iloc[-1]


@pytest.mark.parametrize("columns", [GROUND, [*GROUND, "phi", "theta", "psi"]])
def test_straight_flight_does_not_tell(columns):
    t = np.arange(0, 60, 0.1)
    straight = pd.DataFrame(
        {"time": t, "flight": "a", "v_north": 20.0, "v_east": 3.0, "v_down": 0.0}
    )
    straight = straight.assign(phi=0.0, theta=0.05, psi=0.1)[columns]
    with pytest.raises(ValueError, match=r"Got flight 'a' without airspeed.*fly a circle or two"):
        airspeed_from_turns(straight)


def test_identification_takes_it_and_carries_its_deviation():
    with pytest.warns(FlightDataWarning, match="has no airspeed: its turns give it"):
        (flight,) = named_flights(circling(), needed=["airspeed"]).values()
    expected = airspeed_from_turns(circling())
    assert flight["airspeed"].equals(expected["airspeed"])
    factor = with_airspeed_errors(Aircraft.estimate(2.0, 1.6), [flight]).deviations["airspeed"]
    assert factor.std == pytest.approx(
        2 * expected["airspeed_std"].mean() / 20, rel=0.05
    )  # of qbar, twice that of V


def test_errors_of_dynamic_pressure_scale_coefficients_and_slopes():
    """C = 2 F / (rho V^2 S): V^2 1 % too large makes C 1 % too small, and p b / 2V .5 % too small."""
    errors = relative_errors({"airspeed": ScaleFactor(0.01, {PRESSURE: 1.0})}, ("alpha", "p"))
    assert errors[0] == pytest.approx(np.tile([-0.01, -0.01, -0.005], (6, 1)))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "most"), [("c172p_test_calm", 0.5), ("viggen_uav_test_twoalt", 1.0)]
)
def test_flights_of_other_aerodynamics(shared_data, name, most):
    """In calm air and in gusts to 14 kt: root mean square of the error [m/s], and what the deviation says of it."""
    flight = pd.read_parquet(shared_data / "flights" / f"{name}.parquet")
    found = airspeed_from_turns(flight[["time", *GROUND[2:], "phi", "theta", "psi"]])
    error = found["airspeed"] - flight["airspeed_true"]
    assert np.sqrt(np.mean(error**2)) < most
    assert np.mean(np.abs(error) < 1.96 * found["airspeed_std"]) > 0.85
