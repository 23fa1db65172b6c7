"""Sequences of inputs: times, tables, limits."""

import numpy as np
import pytest

from skdgp.design import (
    Wavetrain,
    doublet,
    multisine,
    three_two_one_one,
    wavetrain,
)
from skdgp.dynamics import Aerodynamics, simulate, trim

REGRESSORS = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]


def linear(X):
    alpha, beta, p, q, r, elevator, aileron, rudder = np.moveaxis(np.asarray(X), -1, 0)
    lift = 0.3 + 4.5 * alpha
    return np.stack([
        -0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
        -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
        0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder,
    ], axis=-1)  # fmt: skip


MODEL = Aerodynamics(linear, REGRESSORS)


@pytest.fixture(scope="module")
def point(uav):
    return trim(MODEL, uav, 20.0)


def test_manoeuvres_follow_one_another_with_pauses_at_trim():
    manoeuvres = [
        {"elevator": doublet(0.5, 0.1)},
        {"aileron": three_two_one_one(0.5, 0.1), "rudder": doublet(1.0, 0.2)},
        {"elevator": doublet(1.0, 0.05)},
    ]
    train = wavetrain(manoeuvres, pause=2.0)
    table = train.table(50.0, pause=1.0)
    moving = (table[["elevator", "aileron", "rudder"]] != 0).any(axis=1)
    begins = table["time"][moving & ~moving.shift(fill_value=False)]
    np.testing.assert_allclose(begins, [2.0, 5.0, 10.5])
    assert table["time"].iloc[-1] == train.duration + 1.0 == 13.5
    assert (table.drop(columns="time").iloc[-1] == 0).all()


def test_a_table_with_its_trim_is_flown_and_returns_to_it(uav, point):
    train = wavetrain([{"elevator": doublet(0.2, 0.02)}, {"rudder": doublet(0.5, 0.05)}], pause=1.0)
    flight = simulate(MODEL, uav, point, train.table(50.0, trim=point.controls, pause=10.0))
    assert np.ptp(flight["alpha"]) > 0.01
    assert np.ptp(flight["beta"]) > 0.01
    end = flight.iloc[-1]
    assert abs(end["beta"]) < 2e-3
    assert end["alpha"] == pytest.approx(point.alpha, abs=1e-2)


def test_overlapping_inputs_add_up_within_limits():
    signals = {0.0: doublet(1.0, 0.06), 0.5: doublet(1.0, 0.06)}
    np.testing.assert_allclose(
        Wavetrain({"rudder": signals})("rudder", [0.25, 0.75, 1.25]), [0.06, 0.12, 0.0]
    )
    with pytest.raises(ValueError, match="overlapping inputs of the rudder with a peak of 0"):
        Wavetrain({"rudder": signals}, {"rudder": 0.1}).table(50.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Wavetrain({"elevater": {0.0: doublet(1, 0.1)}}), "nearest: 'elevator'"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(1, 0.1)}}, {"flaps": 0.1}), "flaps"),
        (lambda: Wavetrain({"elevator": {-1.0: doublet(1, 0.1)}}), "a number >= 0"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(1, 0.1)}}, {"elevator": 0.05}), "elevator with a peak"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(0.1, 0.1)}}).table(25.0), "at least 50 Hz"),
        (lambda: Wavetrain({"elevator": {0.0: multisine(10, [60], rms=1)}}).table(50.0), "at least 60 Hz"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(1, 0.1)}}).table(50.0, trim={"rudder": 0.0}), "elevator"),
        (lambda: Wavetrain({"elevator": doublet(1, 0.1)}), "expected {start: signal}"),
        (lambda: Wavetrain({}, {"elevator": -0.1}), "limit of the elevator=-0.1"),
        (lambda: Wavetrain({}).table(0.0), "rate > 0"),
        (lambda: Wavetrain({"elevator": {0.0: doublet(1, 0.1)}}).table(50.0, pause=-5.0), "a pause from 0 on"),
        (lambda: wavetrain({"elevator": doublet(1, 0.1)}), "list of mappings"),
        (lambda: wavetrain([{}]), "list of mappings"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
