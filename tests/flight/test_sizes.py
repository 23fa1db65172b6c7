"""Sizes of an aircraft: published aircraft break no law, and sizes of another unit are asked for."""

import re
import warnings

import numpy as np
import pytest

from skdgp._compute.messages import FindingWarning
from skdgp._flight.findings import Code
from skdgp._flight.physics import question_of_sizes
from skdgp._flight.physics._sizes import usual_lift_slope
from skdgp._flight.tables import FlightTable
from skdgp.dynamics import Aircraft

FOOT = 0.3048
# mass, wing area, span, chord, (Ixx, Iyy, Izz), CZ_alpha, Cl_p, Cm_q, Cn_r: Heffley & Jewell 1972, Beard &
# McLain 2012, Gryte 2018, from memory
PUBLISHED = {
    "Cessna 172": ((1043.0, 16.2, 11.0, 1.49), (1285, 1825, 2667), (-5.1, -0.47, -12.4, -0.099)),
    "F-104": ((7400.0, 18.2, 6.69, 2.92), (4810, 79500, 81300), (-3.44, -0.285, -5.8, -0.265)),
    "X-15": ((7060.0, 18.6, 6.82, 3.13), (4950, 108500, 111200), (-3.5, -0.25, -6.2, -1.0)),
    "Boeing 747": ((288800.0, 511.0, 59.6, 8.32), (24.7e6, 44.9e6, 67.4e6), (-5.5, -0.45, -20.8, -0.3)),
    "Zagi": ((1.56, 0.2589, 1.4224, 0.3302), (0.1147, 0.0576, 0.1712), (-3.5, -0.32, -1.4, -0.0043)),
    "Skywalker X8": ((3.364, 0.75, 2.1, 0.3571), (0.335, 0.14, 0.4), (-4.02, -0.41, -1.3, -0.022)),
}  # fmt: skip
NAMES = ("mass", "wing_area", "span", "chord")
INERTIA = ("Ixx", "Iyy", "Izz")
DERIVATIVES = ("CZ_alpha", "Cl_p", "Cm_q", "Cn_r")


@pytest.fixture(scope="module")
def train(first_minute):
    """Return half a minute of flights of an aircraft of 45 kg and 2.8 m."""
    train = first_minute().train
    return train[train["time"] < 30.0].reset_index(drop=True)


def published(name):
    sizes, inertia, derivatives = PUBLISHED[name]
    return dict(
        zip((*NAMES, *INERTIA, *DERIVATIVES), (*sizes, *inertia, *derivatives), strict=True)
    )


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_aircraft_break_no_law(name):
    assert question_of_sizes(published(name), {}) is None


def test_lift_slope_of_a_slender_and_of_an_infinite_wing():
    assert usual_lift_slope({"span": 0.1, "wing_area": 1.0}) == pytest.approx(
        np.pi * 0.01 / 2, rel=0.01
    )
    assert usual_lift_slope({"span": 1e3, "wing_area": 1.0}) == pytest.approx(2 * np.pi, rel=0.01)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(
    ("size", "unit"), [("span", FOOT), ("mass", 1e-3), ("chord", 0.01), ("wing_area", FOOT**2)]
)
def test_one_size_of_another_unit_is_asked_for(name, size, unit):
    """It is among those that are asked for, unless the number is one that aircraft have."""
    right = published(name)
    bare = {key: right[key] for key in (*NAMES, *INERTIA)}
    question = question_of_sizes(bare | {size: right[size] / unit}, {})
    assert question.code is Code.SIZES_QUESTIONED
    asked = {found.channel: found.numbers["value"] for found in question.numbers["asked"]}
    assert asked[size] == pytest.approx(right[size])


def test_the_aircraft_is_judged_when_it_is_read():
    with pytest.warns(FindingWarning, match=r"Check these .*span 11 m \(1100 cm\)"):
        Aircraft.estimate(1111.0, 1100.0)
    sizes = {"mass": 13.5, "span": 2.9, "wing_area": 0.55, "chord": 0.19}
    inertia = 1e4 * np.diag([0.8, 1.1, 1.8])
    with pytest.warns(FindingWarning, match="radius of gyration in roll"):
        Aircraft.from_dict(sizes | {"inertia": inertia.tolist()})


def test_flights_of_the_right_sizes_ask_nothing(first_minute, train):
    for aircraft in (first_minute().aircraft, Aircraft.estimate(45.0, 2.8, kind="delta")):
        assert aircraft.question_of_sizes(FlightTable.of(train)) is None


@pytest.mark.parametrize(
    ("mass", "span", "factor", "asked"),
    [
        (450.0, 2.8, 1.0, "mass .* kg"),
        (45.0, 280.0, 1.0, r"span 2.8 m \(280 cm\)"),
        (45.0, 2.8 / FOOT, 1.0, r"span 2.8 m \(9.186 ft\)"),
        (45.0, 2.8, 1 / FOOT, r"airspeed 3\d.* m/s \(.* ft/s\)"),
        (45.0, 2.8, 3.6, r"airspeed 3\d.* m/s \(.* km/h\)"),
    ],
)
def test_flights_ask_for_the_wrong_size(mass, span, factor, asked, train):
    """The lift that carried an aircraft has a slope of a wing only with its mass, wing and airspeed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        aircraft = Aircraft.estimate(mass, span, kind="delta")
    flights = FlightTable.of(train.assign(airspeed=factor * train["airspeed"]))
    assert re.search(asked, aircraft.question_of_sizes(flights).text)


def test_a_noisy_vane_accuses_no_size(first_minute, train):
    """Noise of alpha attenuates the slope, and the reverse regression bounds it."""
    rng = np.random.default_rng(0)
    noise = 3 * train["alpha"].std() * rng.standard_normal(len(train))
    noisy = train.assign(alpha=train["alpha"] + noise)
    assert first_minute().aircraft.question_of_sizes(FlightTable.of(noisy)) is None
