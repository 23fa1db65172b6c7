"""A table of thrust: linear between its points, held beyond, and an engine to fly and trim with."""

import numpy as np
import pandas as pd
import pytest

from skdgp.dynamics import Aerodynamics, ThrustTable, simulate, trim

THROTTLE, AIRSPEED = np.array([0.0, 0.4, 1.0]), np.array([0.0, 12.0, 30.0])


def plane(throttle, airspeed):
    return 5.0 + 80.0 * throttle - 1.5 * airspeed + 0.7 * throttle * airspeed  # bilinear: exact between points


@pytest.fixture
def engine():
    return ThrustTable(THROTTLE, AIRSPEED, plane(THROTTLE[:, None], AIRSPEED), density=1.2)


def test_is_exact_where_thrust_is_bilinear_and_goes_with_density(engine):
    rng = np.random.default_rng(0)
    throttle, airspeed = rng.uniform(0, 1, (4, 5)), rng.uniform(0, 30, (4, 5))
    np.testing.assert_allclose(engine({"throttle": throttle}, airspeed, 1.2), plane(throttle, airspeed))
    np.testing.assert_allclose(engine({"throttle": throttle}, airspeed, 0.6), 0.5 * plane(throttle, airspeed))


def test_is_held_beyond_the_table_and_unknown_where_its_input_is(engine):
    assert engine({"throttle": 0.5}, 99.0, 1.2) == pytest.approx(plane(0.5, 30.0))
    assert engine({"throttle": 1.7}, 10.0, 1.2) == pytest.approx(plane(1.0, 10.0))
    assert np.isnan(engine({"throttle": 0.5}, np.nan, 1.2))


def test_a_bench_table_in_any_order_and_one_airspeed(engine):
    rows = [{"throttle": t, "airspeed": v, "thrust": plane(t, v)} for v in AIRSPEED[::-1] for t in THROTTLE]
    again = ThrustTable.from_table(pd.DataFrame(rows), density=1.2)
    assert again({"throttle": 0.3}, 7.0, 1.2) == pytest.approx(plane(0.3, 7.0))
    static = ThrustTable([0.0, 1.0], [0.0], [[0.0], [50.0]], density=0.3)
    assert static({"throttle": 0.5}, 20.0, 0.3) == pytest.approx(25.0)


def test_an_aircraft_is_trimmed_and_stays_so(engine, aircraft):
    slopes = np.zeros((6, 5))
    slopes[2, 0], slopes[4, 0], slopes[4, 2] = -4.0, -0.5, -0.6
    slopes[1, 1], slopes[3, 1], slopes[5, 1], slopes[3, 3], slopes[5, 4] = -0.5, -0.03, 0.06, 0.1, -0.05
    intercept = np.array([-0.03, 0, -0.1, 0, 0.03, 0])
    model = Aerodynamics(lambda X: intercept + X @ slopes.T, ["alpha", "beta", "elevator", "aileron", "rudder"])
    steady = trim(model, aircraft, airspeed=20.0, thrust=engine)
    flown = simulate(model, aircraft, steady, steady.controls, duration=0.5, thrust=engine)
    np.testing.assert_allclose(flown["airspeed"], 20.0, atol=1e-5)
    assert 0 < steady.controls["throttle"] < 1


@pytest.mark.parametrize(("arguments", "match"), [
    (([0, 0.5, 0.2], [0, 1], np.zeros((3, 2))), "throttle=.*numbers that increase"),
    (([0, 1], [0, 1], np.zeros((2, 3))), r"expected finite numbers, \(2, 2\)"),
    (([0, 1], [0, np.nan], np.zeros((2, 2))), "airspeed=.*finite"),
])  # fmt: skip
def test_impossible_tables_are_told(arguments, match):
    with pytest.raises(ValueError, match=match):
        ThrustTable(*arguments)


def test_holes_and_repeats_of_a_bench_are_told():
    bench = pd.DataFrame({"throttle": [0, 1, 1], "airspeed": [0.0, 0.0, 9.0], "thrust": 1.0})
    with pytest.raises(ValueError, match="full grid of 2 throttles times 2 airspeeds"):
        ThrustTable.from_table(bench)
    with pytest.raises(ValueError, match="a point twice"):
        ThrustTable.from_table(bench.assign(airspeed=0.0))
    with pytest.raises(ValueError, match="controls lack 'throttle'"):
        ThrustTable([0, 1], [0, 1], np.zeros((2, 2)))({"thrust": 3.0}, 1.0, 1.2)
