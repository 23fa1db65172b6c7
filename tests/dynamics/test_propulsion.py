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


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"direction": (0, 0, 0)}, "length zero"),
        ({"position": (1, 2)}, "three finite numbers"),
        ({"position": (1, 2, np.nan)}, "three finite numbers"),
    ],
)
def test_thrust_lines_that_are_none(bad, words):
    with pytest.raises(ValueError, match=words):
        ThrustLine(**bad)


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="thrust"), "lacks the columns 'thrust'"),
        (lambda t: t.assign(propeller_speed=0.0), "propeller_speed <= 0"),
        (lambda t: t.assign(thrust=np.nan), "NaN or infinite"),
        (lambda t: t.iloc[[0, 2]], "do not determine"),
    ],
)
def test_bench_tables_that_are_none(change, words):
    with pytest.raises(ValueError, match=words):
        Propeller.from_table(change(bench()), diameter=0.5)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"diameter": 0.0}, "diameter"),
        ({"thrust_coefficients": ()}, "thrust_coefficients"),
        ({"thrust_coefficients": (1, 2, 3, 4)}, "thrust_coefficients"),
        ({"rotation": 2}, "rotation"),
    ],
)
def test_propellers_that_are_none(bad, words):
    with pytest.raises(ValueError, match=words):
        Propeller(**{"diameter": 0.5, "thrust_coefficients": (0.1,), **bad})


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


def test_columns_win_over_the_propeller_unless_told_otherwise(aircraft):
    powered, table = (
        with_engine(aircraft, propeller=TRUE),
        flight(propeller_speed=500.0, thrust_x=5.0),
    )
    assert propulsive_loads(table, powered)[0][0, 0] == 5.0
    assert propulsive_loads(table, powered, "propeller")[0][0, 0] != 5.0


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


def test_no_word_of_thrust_is_an_error_and_a_glider_says_so(aircraft):
    with pytest.raises(ValueError, match=r"the aircraft has no propeller.*thrust=None"):
        propulsive_loads(flight(), aircraft)
    with pytest.raises(ValueError, match=r"it has no propeller_speed.*thrust=None"):
        propulsive_loads(flight(), with_engine(aircraft, propeller=TRUE))
    np.testing.assert_array_equal(
        propulsive_loads(flight(thrust_x=5.0), aircraft, None), np.zeros((2, 2, 3))
    )


def test_thrust_must_be_a_known_choice(aircraft):
    with pytest.raises(ValueError, match="Got thrust='engine', but expected one of"):
        propulsive_loads(flight(), aircraft, "engine")
    with pytest.raises(ValueError, match="thrust='columns' for a flight without"):
        propulsive_loads(flight(), aircraft, "columns")


def test_external_loads_add_up():
    table = flight(a_x=1.0, a_y=2.0, a_z=3.0, b_x=1.0, b_y=0.0, b_z=-1.0, b_m=0.5)
    force, moment = external_loads(table, ["a", "b"])
    np.testing.assert_allclose(force, [[2, 2, 2]] * 2)
    np.testing.assert_allclose(moment, [[0, 0.5, 0]] * 2)


def test_external_loads_need_their_columns_and_a_list():
    with pytest.raises(ValueError, match="lacks the columns 'rope_x'"):
        external_loads(flight(), ["rope"])
    with pytest.raises(ValueError, match="expected a sequence of names"):
        external_loads(flight(), "rope")
