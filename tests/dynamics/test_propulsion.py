"""Thrust line and propeller: equation 7 by hand, the bench table given back, every way to say the thrust."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import (
    Aircraft,
    Propeller,
    ThrustLine,
    external_loads,
    propeller_loads,
    propulsive_loads,
)

TRUE = Propeller(
    diameter=0.5,
    thrust_coefficients=(0.11, -0.04, -0.09),
    torque_coefficients=(0.006, 0.002, -0.007),
    rotation=-1,
)


def bench(airspeeds=(0.0, 8.0, 16.0), densities=(1.2, 1.1)):
    speed, airspeed, density = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(200, 700, 6), airspeeds, densities, indexing="ij")
    )
    state = (speed, airspeed, density)
    return pd.DataFrame(
        {
            "propeller_speed": speed,
            "airspeed": airspeed,
            "density": density,
            "thrust": TRUE.thrust(*state),
            "torque": -TRUE.rotation * TRUE.torque(*state),
        }
    )


def flight(**columns):
    return pd.DataFrame({"airspeed": [20.0, 21.0], "density": 1.1, **columns})


def with_engine(aircraft, **changes):
    return Aircraft(
        **{**{key: getattr(aircraft, key) for key in aircraft.__dataclass_fields__}, **changes}
    )


def test_equation_7_by_hand():
    # 10 N along (.8, 0, -.6) at (-.5, .1, -.2): F = (8, 0, -6); r x F = (.1 * -6 - 0, -.2 * 8 - -.5
    # * -6, 0 - .1 * 8)
    force, moment = ThrustLine(position=(-0.5, 0.1, -0.2), direction=(4.0, 0.0, -3.0)).loads(
        10.0, torque=-2.0
    )
    np.testing.assert_allclose(force, [8.0, 0.0, -6.0], atol=1e-14)
    np.testing.assert_allclose(moment, [-0.6 - 1.6, -4.6, -0.8 + 1.2], atol=1e-14)


def test_a_table_with_airspeed_gives_the_propeller_back():
    fitted = Propeller.from_table(bench(), diameter=0.5, rotation=-1)
    np.testing.assert_allclose(fitted.thrust_coefficients, TRUE.thrust_coefficients, atol=1e-12)
    np.testing.assert_allclose(fitted.torque_coefficients, TRUE.torque_coefficients, atol=1e-12)
    assert fitted.max_advance_ratio == pytest.approx(2 * np.pi * 16 / (200 * 0.5))


def test_thrust_is_the_advance_ratio_formula():
    omega, airspeed, rho = 400.0, 12.0, 1.15
    n = omega / (2 * np.pi)
    j = airspeed / (n * 0.5)
    expected = rho * n**2 * 0.5**4 * (0.11 - 0.04 * j - 0.09 * j**2)
    np.testing.assert_allclose(TRUE.thrust(omega, airspeed, rho), expected, rtol=1e-13)
    np.testing.assert_allclose(TRUE.advance_ratio(omega, airspeed), j)


def test_a_propeller_at_rest_is_drag_and_finite():
    assert TRUE.thrust(0.0, 20.0) == pytest.approx(1.225 * 0.5**2 * -0.09 * 400)
    assert TRUE.thrust(0.0, 0.0) == 0.0


def test_torque_turns_the_aircraft_against_the_propeller():
    clockwise = Propeller(0.5, (0.1,), (0.01,), rotation=1)
    assert clockwise.torque(300.0, 0.0) < 0, (
        "a propeller clockwise from behind rolls the aircraft left"
    )


def test_a_static_table_says_that_it_is_one():
    static = bench(airspeeds=(0.0,)).drop(columns=["airspeed"])
    with pytest.warns(UserWarning, match="no airspeed > 0.*is overstated"):
        fitted = Propeller.from_table(static, diameter=0.5)
    np.testing.assert_allclose(fitted.thrust_coefficients, [0.11], atol=1e-12)


def test_a_static_table_with_pitch_loses_its_thrust_at_the_pitch_speed():
    fitted = Propeller.from_table(bench(airspeeds=(0.0,)), diameter=0.5, pitch=0.4)
    n = 300.0 / (2 * np.pi)
    np.testing.assert_allclose(fitted.thrust(300.0, n * 0.4), 0.0, atol=1e-12)
    np.testing.assert_allclose(fitted.thrust(300.0, 0.0), TRUE.thrust(300.0, 0.0))


def test_propeller_thrust_of_a_flight(aircraft):
    powered = with_engine(aircraft, propeller=TRUE)
    table = flight(propeller_speed=[500.0, 600.0])
    force, moment = propulsive_loads(table, powered)
    thrust, torque = (
        TRUE.thrust([500.0, 600.0], [20, 21], 1.1),
        TRUE.torque([500.0, 600.0], [20, 21], 1.1),
    )
    line = aircraft.thrust_line
    np.testing.assert_allclose(force, thrust[:, None] * line.direction)
    np.testing.assert_allclose(
        moment, np.cross(line.position, force) + torque[:, None] * line.direction
    )
    np.testing.assert_allclose(
        propeller_loads(powered, [500.0, 600.0], [20, 21], 1.1), (force, moment)
    )


def test_columns_win_over_the_propeller(aircraft):
    powered = with_engine(aircraft, propeller=TRUE)
    table = flight(propeller_speed=500.0, thrust_x=5.0)
    assert propulsive_loads(table, powered)[0][0, 0] == 5.0


def test_a_propeller_without_a_line_pulls_forward_through_the_centre(aircraft):
    plain = with_engine(aircraft, thrust_line=None, propeller=Propeller(0.5, (0.1,)))
    force, moment = propulsive_loads(flight(propeller_speed=500.0), plain)
    assert (force[:, 0] > 0).all()
    np.testing.assert_array_equal(force[:, 1:], 0)
    np.testing.assert_array_equal(moment, 0)


def test_beyond_the_bench_is_warned_of(aircraft):
    propeller = Propeller(0.5, (0.1, -0.05), max_advance_ratio=0.2)
    with pytest.warns(
        UserWarning, match=r"100 % of the samples .* exceeds the largest one on the bench \(0.20\)"
    ):
        propulsive_loads(flight(propeller_speed=500.0), with_engine(aircraft, propeller=propeller))


def test_external_loads_add_up():
    table = flight(a_x=1.0, a_y=2.0, a_z=3.0, b_x=1.0, b_y=0.0, b_z=-1.0, b_m=0.5)
    force, moment = external_loads(table, ["a", "b"])
    np.testing.assert_allclose(force, [[2, 2, 2]] * 2)
    np.testing.assert_allclose(moment, [[0, 0.5, 0]] * 2)


@pytest.mark.parametrize(("ask", "words"), [
    (lambda a: ThrustLine(direction=(0, 0, 0)), "length zero"),
    (lambda a: ThrustLine(position=(1, 2)), "3 finite numbers"),
    (lambda a: ThrustLine(position=(1, 2, np.nan)), "3 finite numbers"),
    (lambda a: Propeller.from_table(bench().drop(columns="thrust"), diameter=0.5), "lacks the columns 'thrust'"),
    (lambda a: Propeller.from_table(bench().assign(propeller_speed=0.0), diameter=0.5), "propeller_speed <= 0"),
    (lambda a: Propeller.from_table(bench().assign(thrust=np.nan), diameter=0.5), "with NaN"),
    (lambda a: Propeller.from_table(bench().iloc[[0, 2]], diameter=0.5), "do not determine"),
    (lambda a: Propeller(0.0, (0.1,)), "diameter"),
    (lambda a: Propeller(0.5, ()), "thrust_coefficients"),
    (lambda a: Propeller(0.5, (1, 2, 3, 4)), "thrust_coefficients"),
    (lambda a: Propeller(0.5, (0.1,), rotation=2), "rotation"),
    (lambda a: propulsive_loads(flight(), a), r"and no propeller\. .*thrust=None"),
    (lambda a: propulsive_loads(flight(), with_engine(a, propeller=TRUE)), r"no propeller_speed.*thrust=None"),
    (lambda a: propulsive_loads(flight(), a, "engine"), "Got thrust='engine', but expected"),
    (lambda a: external_loads(flight(), ["rope"]), "lacks the columns 'rope_x'"),
    (lambda a: external_loads(flight(), "rope"), "expected a sequence of names"),
])  # fmt: skip
def test_what_is_no_propulsion(aircraft, ask, words):
    with pytest.raises(ValueError, match=words):
        ask(aircraft)


def test_a_glider_has_no_thrust(aircraft):
    loads = propulsive_loads(flight(thrust_x=5.0), aircraft, None)
    np.testing.assert_array_equal(loads, np.zeros((2, 2, 3)))
