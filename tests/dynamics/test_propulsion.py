"""Thrust line and propeller: equation 7 by hand, usual propellers."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.dynamics import (
    Aircraft,
    Propeller,
    ThrustLine,
    aerodynamic_coefficients,
    propeller_loads,
    propulsive_loads,
)

TRUE = Propeller(
    diameter=0.5,
    thrust_coefficients=(0.11, -0.04, -0.09),
    torque_coefficients=(0.006, 0.002, -0.007),
    rotation=-1,
)


def flight(**columns):
    return pd.DataFrame({"airspeed": [20.0, 21.0], "density": 1.1, **columns})


def test_equation_7_by_hand():
    # 10 N along (.8, 0, -.6) at (-.5, .1, -.2): F = (8, 0, -6);
    # r x F = (.1 * -6 - 0, -.2 * 8 - -.5 * -6, 0 - .1 * 8)
    line = ThrustLine(position=(-0.5, 0.1, -0.2), direction=(4.0, 0.0, -3.0))
    force, moment = line.loads(10.0, torque=-2.0)
    assert_allclose(force, [8.0, 0.0, -6.0], atol=1e-14)
    assert_allclose(moment, [-0.6 - 1.6, -4.6, -0.8 + 1.2], atol=1e-14)


def test_thrust_is_the_advance_ratio_formula():
    omega, airspeed, rho = 400.0, 12.0, 1.15
    n = omega / (2 * np.pi)
    j = airspeed / (n * 0.5)
    expected = rho * n**2 * 0.5**4 * (0.11 - 0.04 * j - 0.09 * j**2)
    assert_allclose(TRUE.thrust(omega, airspeed, rho), expected, rtol=1e-13)


def test_coefficients_that_are_not_given_are_zero():
    omega, rho = 400.0, 1.15
    one = Propeller(0.5, (0.11,))
    expected = rho * (omega / (2 * np.pi)) ** 2 * 0.5**4 * 0.11
    assert_allclose(one.thrust(omega, np.array([0.0, 12.0]), rho), expected)
    assert one.torque(omega, 12.0) == 0.0


def test_torque_turns_the_aircraft_against_the_propeller():
    clockwise = Propeller(0.5, (0.1,), (0.01,), rotation=1)
    assert clockwise.torque(300.0, 0.0) < 0, (
        "a propeller clockwise from behind rolls the aircraft left"
    )


def test_propeller_thrust_of_a_flight(aircraft):
    powered = replace(aircraft, propeller=TRUE)
    force, moment = propulsive_loads(flight(propeller_speed=[500.0, 600.0]), powered)
    state = [500.0, 600.0], [20, 21], 1.1
    line = aircraft.thrust_line
    assert_allclose(force, np.outer(TRUE.thrust(*state), line.direction))
    torque = np.outer(TRUE.torque(*state), line.direction)
    assert_allclose(moment, np.cross(line.position, force) + torque)
    assert_allclose(propeller_loads(powered, *state), (force, moment))


@pytest.mark.parametrize(("ask", "words"), [
    (lambda a: ThrustLine(direction=(0, 0, 0)), "length zero"),

    (lambda a: Propeller(0.0, (0.1,)), "diameter"),
    (lambda a: Propeller(0.5, ()), "thrust_coefficients"),

    (lambda a: Propeller(0.5, (0.1,), rotation=2), "rotation"),
    (lambda a: propulsive_loads(flight(), a), r"and no propeller\. .*thrust=None"),
    (lambda a: propulsive_loads(flight(), replace(a, propeller=TRUE)), r"no propeller_speed.*thrust=None"),
    (lambda a: propulsive_loads(flight(), a, "engine"), "Got thrust='engine', but expected"),
])  # fmt: skip
def test_what_is_no_propulsion(aircraft, ask, words):
    with pytest.raises(ValueError, match=words):
        ask(aircraft)


SIZE = {"diameter": 0.254, "pitch": 0.127}
MOTOR = {"motor_constant": 94.2, "voltage": 11.1}


def test_coefficients_by_the_size_are_those_of_the_fit():
    """Of its documentation, where they are rounded."""
    x = 0.6
    propeller = Propeller.from_size(0.3, 0.3 * x)
    thrust = [0.048 + 0.092 * x, -(0.136 - 0.123 * x), -0.104]
    torque = [-0.0017 + 0.0158 * x, -(0.0016 - 0.0057 * x), -0.0118]
    assert_allclose(propeller.thrust_coefficients, thrust, atol=6e-4)
    assert_allclose(propeller.torque_coefficients, torque, atol=6e-5)


def test_a_motor_under_load_turns_at_three_quarters_of_its_free_speed():
    propeller = Propeller.from_size(**SIZE, **MOTOR)
    assert_allclose(propeller.speed_range, (0.0, 0.75 * 94.2 * 11.1))
    assert_allclose(propeller.load_std, np.hypot(0.23, 0.35), rtol=0, atol=0.005)


def test_an_aircraft_file_has_diameter_and_pitch():
    aircraft = Aircraft.from_dict(
        {"kind": "conventional", "mass": 2.0, "span": 1.5, "propeller": SIZE | MOTOR}
    )
    assert aircraft.propeller == Propeller.from_size(**SIZE, **MOTOR)
    assert Aircraft.from_dict(aircraft.to_dict()).propeller == aircraft.propeller
    with pytest.raises(ValueError, match="unknown key 'pich'"):
        Aircraft.from_dict(
            {
                "kind": "conventional",
                "mass": 2.0,
                "span": 1.5,
                "propeller": {"diameter": 1, "pich": 1},
            }
        )


def test_the_throttle_gives_the_thrust_where_the_motor_is_known():
    rng = default_rng(0)
    table = pd.DataFrame({
        "time": 0.05 * np.arange(400), "density": 1.2, "az": -9.8, "ax": 0.0, "ay": 0.0, "p": 0.0, "q": 0.0,
        "r": 0.0, "airspeed": rng.uniform(14, 19, 400), "throttle": rng.uniform(0.4, 0.9, 400),
    })  # fmt: skip
    told = Aircraft.estimate(2.0, 1.5, propeller=SIZE | MOTOR)
    speed = told.propeller.speed_at(table["throttle"])
    thrust = told.propeller.thrust(speed, table["airspeed"], 1.2)
    drag = aerodynamic_coefficients(table, told, cutoff=None)["CX"]
    assert_allclose(drag, -thrust / (0.6 * table["airspeed"] ** 2 * told.wing_area))
