"""Laws of sizes: sound aircraft break none, and a size of another unit is asked for."""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from log_errors import scale
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp._compute.messages import FindingWarning
from skdgp._flight.findings import Code
from skdgp._flight.physics import question_of_sizes
from skdgp._flight.physics._sizes import LAWS, usual_lift_slope
from skdgp._flight.tables import FlightTable
from skdgp.dynamics import Aircraft, ScaleFactor, ThrustLine, numbers_in_flight

FOOT = 0.3048
POUND = 0.45359237
GRAVITY = 9.80665


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
SIZES = ("mass", "wing_area", "span", "chord", "Ixx", "Iyy", "Izz")
DERIVATIVES = ("CZ_alpha", "Cl_p", "Cm_q", "Cn_r")


@pytest.fixture(scope="module")
def train(first_minute):
    """Return half a minute of flights of an aircraft of 45 kg and 2.8 m."""
    train = first_minute().train
    return train[train["time"] < 30.0].reset_index(drop=True)


def sizes_of(name):
    sizes, inertia, _ = PUBLISHED[name]
    return dict(zip(SIZES, (*sizes, *inertia), strict=True))


def published(name):
    return sizes_of(name) | dict(zip(DERIVATIVES, PUBLISHED[name][2], strict=True))


def asked_for(question):
    """Return what a question asks for: unit and value by size."""
    asked = question.numbers["asked"]
    return {(each.channel, each.numbers["unit"]): each.numbers["value"] for each in asked}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_aircraft_break_no_law(name):
    assert question_of_sizes(published(name), {}) is None


def test_the_page_has_the_laws_of_sizes_with_their_limits():
    page = (Path(__file__).parents[2] / "docs" / "logs.md").read_text("utf-8")
    rows = [f"| {law.text} | {law.least:g} to {law.most:g} | {law.source} |\n" for law in LAWS]
    assert "".join(rows) in page


@pytest.mark.parametrize(("span", "slope"), [(0.1, np.pi * 0.01 / 2), (1e3, 2 * np.pi)])
def test_lift_slope_of_a_slender_and_of_an_infinite_wing(span, slope):
    assert_allclose(usual_lift_slope({"span": span, "wing_area": 1.0}), slope, rtol=0.01)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(
    ("size", "unit", "factor"),
    [
        ("span", "ft", FOOT),
        ("mass", "g", 1e-3),
        ("chord", "cm", 0.01),
        ("wing_area", "ft^2", FOOT**2),
    ],
)
def test_one_size_of_another_unit_is_asked_for(name, size, unit, factor):
    """It is among those that are asked for, unless the number is one that aircraft have."""
    right = sizes_of(name)
    question = question_of_sizes(right | {size: right[size] / factor}, {})
    assert question.code is Code.SIZES_QUESTIONED
    assert_allclose(asked_for(question)[size, unit], right[size])


@pytest.mark.parametrize(
    ("names", "factor", "unit"),
    [
        ("span", 0.5, "m of half the span"),
        ("wing_area", 0.5, "m^2 of one wing"),
        ("Ixx Iyy Izz", 1 / GRAVITY, "kgf m s^2"),
        ("Ixx Iyy Izz", 1000.0, "g m^2"),
    ],
)
def test_the_unit_of_a_size_is_asked_for(names, factor, unit):
    right = sizes_of("Zagi")
    question = question_of_sizes(right | {name: factor * right[name] for name in names.split()}, {})
    assert (names.split()[0], unit) in asked_for(question)


def test_a_slip_of_the_decimal_point_is_asked_about():
    right = sizes_of("Skywalker X8")
    question = question_of_sizes(right | {"mass": 10 * right["mass"], "CL": 3.5}, {})
    assert_allclose(asked_for(question)["mass", "with a decimal place too many"], right["mass"])


def test_an_indicated_airspeed_is_asked_about():
    """Of a jet at 7 km; the coefficients grow by the density's ratio."""
    ratio = 1.225 / 0.59
    flown = {"airspeed": 200.0 / ratio**0.5, "density": 0.59, "CZ_alpha": 6.0 * ratio}
    question = question_of_sizes(sizes_of("Boeing 747") | flown, {})
    assert_allclose(asked_for(question)["airspeed", "m/s of indicated airspeed"], 200.0)


def test_a_size_of_another_source_is_asked_for():
    weighed = {"weight": ScaleFactor(0.02, {"mass": 1.0}, "scale of 2021")}
    inertia = np.diag([0.8, 1.1, 1.8])
    sizes = {"mass": 13500.0, "inertia": inertia, "wing_area": 0.55, "span": 2.9, "chord": 0.19}
    assert ("mass", "g") in asked_for(Aircraft(**sizes, deviations=weighed).question_of_sizes())


@pytest.mark.parametrize(
    ("changed", "law"),
    [
        ({"Ixx": 79500.0, "Iyy": 4810.0}, "Ixx / Iyy over the aspect ratio"),
        ({"Ixx": 81300.0, "Izz": 4810.0}, "Izz over Ixx + Iyy"),
        ({"Ixz": 12000.0}, "Ixz over the root of Ixx Izz"),
    ],
)
def test_moments_of_inertia_that_no_aeroplane_has(changed, law):
    question = question_of_sizes(published("F-104") | changed, {})
    assert law in {found.channel for found in question.numbers["laws"]}
    assert {*changed} <= {channel for channel, _ in asked_for(question)}


@pytest.mark.parametrize(("std", "is_asked"), [(0.01, True), (1.0, False)])
def test_a_number_above_a_limit_is_asked_about_if_it_is_surely_there(std, is_asked):
    """Cn_r has no lower limit, and 3 is the upper one."""
    question = question_of_sizes(published("F-104") | {"Cn_r": 3.5}, {"Cn_r": std})
    assert (question is not None) == is_asked


def question_of(aircraft, table):
    """Return the question for the sizes of an aircraft that flights ask."""
    return aircraft.question_of_sizes(*numbers_in_flight(FlightTable.of(table), aircraft))


def test_an_error_of_the_wing_area_is_one_of_the_lift(first_minute, latlon):
    """CL goes with its inverse; CL_alpha over that of a wing with its power of 0.65, beside the error of the slope."""
    aircraft = first_minute().aircraft
    error = {"wing": ScaleFactor(0.1, {"wing_area": 1.0})}
    flights = FlightTable.of(latlon)
    _, exact = numbers_in_flight(flights, replace(aircraft, deviations={}))
    numbers, stds = numbers_in_flight(flights, replace(aircraft, deviations=error))
    assert_allclose(stds["CL"], 0.1 * numbers["CL"])
    expected = np.hypot(exact["CZ_alpha"], 0.065 * numbers["CZ_alpha"])
    assert_allclose(stds["CZ_alpha"], expected)


def names_asked(aircraft, table):
    question = question_of(aircraft, table)
    return set() if question is None else {channel for channel, _ in asked_for(question)}


@pytest.mark.parametrize(("size", "factor"), [("mass", 1 / 0.45359237), ("thrust_x", 1 / 4.44822)])
def test_the_thrust_tells_the_mass(first_minute, latlon, size, factor):
    """Newton's second law: the slope of ax over the thrust is 1 / mass."""
    aircraft = first_minute().aircraft
    assert question_of(aircraft, latlon) is None
    if size == "mass":
        aircraft = replace(aircraft, mass=factor * aircraft.mass)
    else:
        latlon = scale({size: factor})(latlon)
    assert size.removesuffix("_x") in names_asked(aircraft, latlon)


@pytest.mark.parametrize(
    ("diameter", "speed", "direction", "asked"),
    [
        (1.0, 1.0, 1.0, set()),
        (1.0, 1.0, -1.0, {"thrust_line.direction"}),
        (1 / 0.0254, 1.0, 1.0, {"propeller.diameter"}),
        (100.0, 1.0, 1.0, {"propeller.diameter"}),
        (0.5, 1.0, 1.0, {"propeller.diameter"}),
        (2.0, 1.0, 1.0, {"propeller.diameter"}),
        (1.0, 30 / np.pi, 1.0, {"propeller_speed"}),
    ],
)
def test_flights_ask_for_the_propeller_and_the_thrust_line(
    first_minute, latlon, diameter, speed, direction, asked
):
    aircraft = first_minute().aircraft
    propeller = replace(aircraft.propeller, diameter=diameter * aircraft.propeller.diameter)
    line = ThrustLine(direction=direction * aircraft.engine_line.direction)
    by_propeller = latlon.drop(columns=latlon.filter(like="thrust").columns)
    names = names_asked(
        replace(aircraft, propeller=propeller, thrust_line=line),
        scale({"propeller_speed": speed})(by_propeller),
    )
    assert asked <= names
    assert bool(asked) == bool(names)
    assert names.isdisjoint({"chord", "wing_area", "Ixx"})


@pytest.mark.parametrize(
    ("name", "value"), [("propeller_speed", 0.0), ("propeller_speed", np.nan), ("thrust_z", np.nan)]
)
def test_an_engine_that_is_off_or_unknown_asks_nothing(first_minute, latlon, name, value):
    if name == "propeller_speed":
        latlon = latlon.drop(columns=latlon.filter(like="thrust").columns)
    assert question_of(first_minute().aircraft, latlon.assign(**{name: value})) is None


@pytest.mark.parametrize(
    ("name", "factor", "rows"), [("alpha", 3, 1), ("az", 10, 1), ("thrust_x", 3, 10)]
)
def test_noise_questions_no_size(first_minute, train, name, factor, rows):
    """Of alpha or the thrust it attenuates a slope, of az the correlation; the reverse regression bounds it.

    Each value lasts for some rows.
    """
    noise = np.repeat(default_rng(0).standard_normal(len(train) // rows + 1), rows)[: len(train)]
    noisy = train.assign(**{name: train[name] + factor * train[name].std() * noise})
    assert question_of(first_minute().aircraft, noisy) is None


def test_the_aircraft_is_judged_when_it_is_read():
    with pytest.warns(FindingWarning, match="is it .*span 1100 cm, which is 11 m"):
        Aircraft.estimate(1111.0, 1100.0)
    sizes = {"mass": 13.5, "span": 2.9, "wing_area": 0.55, "chord": 0.19}
    inertia = 1e4 * np.diag([0.8, 1.1, 1.8])
    with pytest.warns(FindingWarning, match="radius of gyration in roll"):
        Aircraft.from_dict(sizes | {"inertia": inertia.tolist()})


def test_flights_of_the_right_sizes_ask_nothing(first_minute, train):
    for aircraft in (first_minute().aircraft, Aircraft.estimate(45.0, 2.8, kind="delta")):
        assert question_of(aircraft, train) is None


@pytest.mark.parametrize(
    ("mass", "span", "factor", "asked"),
    [
        (450.0, 2.8, 1.0, "mass .* kg"),
        (45.0 / POUND, 2.8, 1.0, r"CL_alpha over .* mass 99.2.* lb, which is 45 kg"),
        (
            45.0,
            1.4,
            1.0,
            r"CL_alpha over that of a wing .* span 1.4 m of half the span, which is 2.8 m",
        ),
        (45.0, 280.0, 1.0, "span 280 cm, which is 2.8 m"),
        (45.0, 2.8 / FOOT, 1.0, "span 9.186 ft, which is 2.8 m"),
        (45.0, 2.8, 1 / FOOT, r"airspeed .* ft/s, which is 3\d.* m/s"),
        (45.0, 2.8, 3.6, r"airspeed .* km/h, which is 3\d.* m/s"),
    ],
)
def test_flights_ask_for_the_wrong_size(mass, span, factor, asked, train):
    """The lift that carried an aircraft has a slope of a wing only with its mass, wing and airspeed.

    A mass of 45 g has a small slope, whose error is as small.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        aircraft = Aircraft.estimate(mass, span, kind="delta")
    question = question_of(aircraft, scale({"airspeed": factor})(train)).text
    assert re.search(asked, question)
    assert "45 g" not in question
