"""Trims: known answers, steadiness when flown, and clear words where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Motion,
    Propeller,
    quaternion_to_euler,
    simulate,
    trim,
)

DENSITY, GRAVITY = 1.1, 9.79
EXAMPLE = load_example_flights(duration=1.0)
BRUMBY = EXAMPLE.aircraft
BRUMBYS = EXAMPLE.truth
AIR = {"air": Air(density=DENSITY, gravity=GRAVITY)}


@pytest.fixture(scope="module")
def of_columns(glider):
    """Return a function to the glider without some regressors, or with more, that it does not feel."""

    def of_columns(names, limits=None):
        def values(X):
            given = dict(zip(names, X.T, strict=True))
            columns = [given.get(name, 0.0 * X[:, 0]) for name in glider.names]
            return glider.model()(np.stack(columns, axis=-1))

        return Aerodynamics(values, names, limits=limits)

    return of_columns


ACCELERATIONS = [3, 4, 5, 10, 11, 12]


def test_bank_and_turn_rate_are_two_ways_to_ask_for_a_turn(glider):
    model = glider.model()
    by_bank = trim(model, glider.aircraft, 20.0, bank=-0.5, **AIR)
    by_rate = trim(model, glider.aircraft, 20.0, fixed={"turn_rate": by_bank.turn_rate}, **AIR)
    assert by_bank.turn_rate < 0
    assert_allclose(by_rate.phi, -0.5)
    assert_allclose(by_rate.state, by_bank.state)
    now = Motion(model, glider.aircraft, **AIR).at(by_bank.state, by_bank.controls)
    assert_allclose(now.derivative[ACCELERATIONS], 0.0, atol=1e-8)


class TestSteady:
    @pytest.mark.parametrize(
        "asked",
        [
            {},
            {"climb": 0.08},
            {"climb": -0.1, "bank": 0.4},
            {"fixed": {"turn_rate": -0.2}},
            {"bank": 0.1, "fixed": {"turn_rate": 0.0}},
            {"fixed": {"beta": 0.05}},
            {"fixed": {"rudder": 0.0}, "bank": 0.3},
            {"fixed": {"throttle": 0.8}, "climb": None},
            {"thrust": None, "climb": None},
        ],
        ids=str,
    )
    def test_no_acceleration_is_left(self, asked):
        """Full inertia, propeller torque, coefficients that depend on alpha_dot and beta_dot."""
        found = trim(BRUMBYS, BRUMBY, 36.0, altitude=200.0, **asked)
        now = Motion(BRUMBYS, BRUMBY, thrust=asked.get("thrust", "auto")).at(
            found.state, found.controls
        )
        assert_allclose(now.derivative[ACCELERATIONS], 0.0, atol=1e-8)
        assert found.residual < 1e-8
        assert_allclose(found.coefficients, now.coefficients, rtol=1e-6)
        assert_allclose(now.airspeed, 36.0)
        assert_allclose(found.state[:3], [0.0, 0.0, -200.0])
        assert_allclose(quaternion_to_euler(found.state[6:10])[2], 0.0, atol=1e-12)
        assert_allclose(-now.derivative[2], 36.0 * np.sin(found.climb), rtol=0, atol=1e-9)
        s, c = np.sin(found.theta), np.cos(found.theta)
        down = [-s, c * np.sin(found.phi), c * np.cos(found.phi)]
        assert_allclose(found.state[10:], found.turn_rate * np.array(down), atol=1e-9)
        for name in set(asked) - {"fixed"}:
            value = {"bank": found.phi}.get(name, getattr(found, name, None))
            assert asked[name] is None or value == pytest.approx(asked[name])


@pytest.mark.parametrize("climb", [-0.1, 0.2])
def test_the_speed_of_a_propeller_trims_the_thrust(glider, climb):
    propeller = Propeller(0.5, (0.1, -0.05, -0.08), (0.006, 0.002, -0.007))
    powered = replace(glider.aircraft, propeller=propeller)
    found = trim(glider.model(), powered, 20.0, climb=climb, **AIR)
    state = found.controls["propeller_speed"], 20.0, DENSITY
    assert_allclose(found.thrust, propeller.thrust(*state))


class TestShape:
    def test_what_was_not_flown_is_said(self, glider):
        limits = np.outer([-0.2, 0.2], np.ones(8))
        limits[:, 5] = 0.05, 0.2
        found = trim(glider.model(limits=limits), glider.aircraft, 20.0, **AIR)
        assert list(found.beyond) == ["elevator"]
        assert (found.altitude, found.climb, found.turn_rate, found.beta) == (0.0, 0.0, 0.0, 0.0)
        assert_allclose(found.thrust, found.controls["thrust"])
        assert_allclose(found.beyond["elevator"], (found.controls["elevator"], 0.05, 0.2))
        assert trim(glider.model(), glider.aircraft, 20.0, **AIR).beyond == {}

    @pytest.mark.parametrize(("flown", "limit"), [(0.1, 0.3), (0.01, 0.11)])
    def test_unknowns_at_a_limit_are_named_with_it(self, glider, flown, limit):
        """As far beyond the training range as it is wide, at least 0.1 rad."""
        model = glider.model(limits=np.outer([-flown, flown], np.ones(8)))
        with pytest.raises(ValueError, match=rf"with .*alpha at its limit {limit}\b"):
            trim(model, glider.aircraft, 8.0, **AIR)

    def test_a_throttle_that_sets_no_thrust_stays_in_the_middle_of_what_was_flown(
        self, glider, of_columns
    ):
        limits = np.outer([-0.4, 0.4], np.ones(9))
        limits[:, 8] = 0.3, 0.9
        names = [*glider.names, "throttle"]
        model = of_columns(names, limits)
        assert_allclose(trim(model, glider.aircraft, 20.0, **AIR).controls["throttle"], 0.6)
        assert (
            trim(model, glider.aircraft, 20.0, fixed={"throttle": 0.5}, **AIR).controls["throttle"]
            == 0.5
        )
        with pytest.raises(ValueError, match=r"lacks values of \['throttle'\], .*give fixed="):
            trim(of_columns(names), glider.aircraft, 20.0, **AIR)


@pytest.mark.parametrize(
    ("asked", "match"),
    [
        ({"bank": 30.0}, "Got bank=30, but expected radians"),
        ({"climb": 3.0}, "Got climb=3, but expected radians"),
        ({"altitude": -99999.0}, "altitude -99999 m, but expected six accelerations"),
        ({"fixed": {"ruder": 0.0}}, r"'ruder' \(nearest: 'rudder'\)"),
        ({"climb": 0.6}, r"with throttle at its limit 1\. "),
        ({"climb": -0.7}, r"with throttle at its limit 0\. "),
    ],
)
def test_what_cannot_be_asked(asked, match):
    with pytest.raises(ValueError, match=match):
        trim(BRUMBYS, BRUMBY, 36.0, **asked)


@pytest.mark.parametrize(
    ("model", "match"),
    [
        (
            lambda names: BRUMBYS,
            r"no trim of brumby at airspeed 12, .*w_dot = .*m/s\^2.*, with nothing at a limit.*another airspeed",
        ),
        (lambda names: Aerodynamics(lambda X: X[:, :6] * np.nan, names), "not defined there"),
        (
            lambda names: Aerodynamics(lambda X: X[:, :6], [*names, "flap"]),
            r"unknowns.*flap.*at most 7.*fixed=",
        ),
    ],
)
def test_no_such_flight(model, match, glider):
    with pytest.raises(ValueError, match=match):
        trim(model(glider.names), BRUMBY, 12.0)


def test_a_trim_as_start_holds_relative_to_the_air(glider):
    steady = trim(glider.model(), glider.aircraft, 20.0, altitude=100.0)
    air = Air(wind=[5.0, -3.0, 0.0])
    flown = simulate(
        glider.model(), glider.aircraft, steady, steady.controls, duration=1.0, air=air
    )
    for name in ("airspeed", "alpha", "beta", "altitude"):
        assert_allclose(flown[name], vars(steady)[name], atol=1e-3)
