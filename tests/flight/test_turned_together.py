"""Mistakes of several channels that hide each other, and vanes against the motion of the aircraft."""

import numpy as np
import pytest

from skdgp._flight.physics import find_contradictions
from skdgp._flight.tables import FlightTable

COLUMNS = [
    "time",
    "airspeed",
    "density",
    "alpha",
    "beta",
    "p",
    "q",
    "r",
    "ax",
    "ay",
    "az",
    "phi",
    "theta",
    "psi",
]
GPS = ["v_north", "v_east", "v_down"]
SURFACES = ["elevator", "aileron", "rudder"]
BODY = ["q", "r", "ay", "az"]


@pytest.fixture(scope="module")
def flight(first_minute):
    """Return a flight with turns and inputs of every surface, as it was measured."""
    train = first_minute().train
    flown = train[train["flight"] == "latlon"].reset_index(drop=True)
    return flown[[*COLUMNS, *GPS, *SURFACES]]


def turned(table, names):
    return table.assign(**{name: -table[name] for name in names})


def named(table):
    """Return the channels of each contradiction."""
    return [{*found.channels} for found in find_contradictions(FlightTable.of(table))]


@pytest.mark.parametrize("without", [[], ["alpha", "beta"], GPS])
def test_a_flight_as_it_was_contradicts_nothing(flight, without):
    assert named(flight.drop(columns=without)) == []


@pytest.mark.parametrize("pair", [{"q", "theta"}, {"p", "phi"}, {"r", "psi"}])
@pytest.mark.parametrize("without", [[], ["alpha", "beta"]])
def test_a_rate_and_its_angle_turned_together(flight, pair, without):
    """They agree with each other, but in turns q = psi_dot sin phi cos theta is positive on either side."""
    assert named(turned(flight.drop(columns=without), pair)) == [pair]


def test_surfaces_turned_in_vain_do_not_hide_it(flight):
    assert "q" in set().union(*named(turned(flight, ["q", "theta", "elevator"])))


@pytest.mark.parametrize(
    "names", [BODY, [*BODY, "theta", "psi"], [*BODY, "theta", "psi", "v_east", "v_down"]]
)
def test_axes_forward_left_up_are_one_mistake(flight, names):
    table = turned(flight.drop(columns=["alpha", "beta"]), names)
    (found,) = find_contradictions(FlightTable.of(table))
    assert {*found.channels} == {*names}
    assert "forward, left, up (ROS)" in found.finding.clause


def test_a_heading_from_east_with_them(flight):
    table = turned(flight.drop(columns=["alpha", "beta"]), [*BODY, "theta"])
    (found,) = find_contradictions(FlightTable.of(table.assign(psi=np.pi / 2 - table["psi"])))
    assert "pi/2 - psi" in found.finding.advice


@pytest.mark.parametrize("rows", [4, 8, 12, 20])
def test_late_vanes_are_named_and_no_surface(flight, rows):
    """Of 0.1 s at most LagCorrector corrects in silence."""
    late = flight[["alpha", "beta"]].shift(rows)
    table = flight.assign(**late).iloc[rows:].reset_index(drop=True)
    vanes = {"alpha", "beta"} if rows > 4 else set()
    assert set().union(*named(table.drop(columns=GPS))) == vanes


@pytest.mark.parametrize("factor", [1 / 0.3048, 3.6])
def test_the_scale_of_the_airspeed_without_gps(flight, factor):
    """alpha follows q + az / V."""
    table = flight.drop(columns=GPS)
    assert named(table.assign(airspeed=factor * table["airspeed"])) == [{"airspeed"}]
