"""Replay: true coefficients follow the truth, restarts are where they should be."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import replay

STATES = ["v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r"]
EVERY = ["north", "east", "down", *STATES]


def test_true_coefficients_follow_the_flight(simulated, aircraft, true_coefficients, gravity):
    flown = replay(simulated, aircraft, true_coefficients, horizon=2.0, gravity=gravity)
    assert_allclose(flown[EVERY], simulated[EVERY], atol=2e-2)


def test_the_error_is_of_the_loads_interpolation_only(
    simulated, aircraft, true_coefficients, gravity
):
    errors = []
    for every in (8, 4, 2):
        flight, coefficients = simulated.iloc[:593:every], true_coefficients[:593:every]
        flown = replay(flight, aircraft, coefficients, horizon=np.inf, gravity=gravity)
        errors.append(np.abs(flown[STATES] - flight[STATES]).iloc[-1])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert_allclose(
        np.median(orders), 2.0, atol=0.2, err_msg="loads linear between samples: second order"
    )


def test_restarts_stand_every_horizon_and_rows_show_the_end(simulated, aircraft, true_coefficients):
    wrong = true_coefficients + np.array([0.01, 0, 0, 0, 0, 0])
    flown = replay(simulated, aircraft, wrong, horizon=1.0)
    assert flown["window"].tolist() == [0] + [k // 100 for k in range(599)]
    assert_allclose(
        flown["elapsed"].iloc[[0, 1, 100, 101, 599]], [0, 0.01, 1.0, 0.01, 0.99], atol=1e-9
    )
    error = np.abs(flown["v_north"] - simulated["v_north"])
    assert error.iloc[100] > 50 * error.iloc[101]


def test_flights_gaps_and_nan_coefficients_end_windows(simulated, aircraft, true_coefficients):
    flight = pd.concat(
        [simulated.iloc[:300].assign(flight="a"), simulated.iloc[:300].assign(flight="b")]
    )
    flight = flight.reset_index(drop=True).drop(index=range(100, 150)).reset_index(drop=True)
    coefficients = np.vstack(
        [np.delete(true_coefficients[:300], range(100, 150), axis=0), true_coefficients[:300]]
    )
    coefficients[400:410] = np.nan
    flown = replay(flight, aircraft, coefficients, horizon=10.0)
    assert flown["window"].unique().tolist() == [0, 1, 2, -1, 3]
    assert flown[STATES].isna().all(axis=1).sum() == 10
    good = flown["window"] >= 0
    assert_allclose(flown.loc[good, STATES], flight.loc[good, STATES], atol=0.05)


def test_heading_keeps_the_turn_of_the_log(simulated, aircraft, true_coefficients):
    flight = simulated.assign(
        psi=simulated["psi"] + 2 * np.pi * (simulated["psi"] > 2.0) - 2 * np.pi
    )
    flown = replay(flight, aircraft, true_coefficients)
    assert_allclose(flown["psi"], flight["psi"], atol=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"without": "v_east"}, "lacks the columns 'v_east'"),
        ({"coefficients": np.zeros((3, 6))}, r"shape \(3, 6\), but expected \(600, 6\)"),
        ({"horizon": 0.0}, "horizon=0.0"),
    ],
)
def test_requests_that_cannot_be(simulated, aircraft, true_coefficients, options, words):
    options = {"coefficients": true_coefficients, **options}
    flight = simulated.drop(columns=options.pop("without", []))
    with pytest.raises(ValueError, match=words):
        replay(flight, aircraft, **options)
