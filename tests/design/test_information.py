"""Predicted standard errors: dense algebra, scatter of estimates, what a flight cannot tell apart."""

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor
from skdgp.design import (
    coefficient_noise,
    doublet,
    expected_information,
    multisine,
    posterior_information,
)
from skdgp.dynamics import stability_derivatives

TIME = np.arange(0.0, 8.0, 0.04)
NOISE = pd.DataFrame(
    {"white": [0.002, 0.001, 0.0], "drift": [0.003, 0.0, 0.003], "memory": [0.6, 1.0, 0.6]}, index=["Cm", "Cn", "Cl"]
)  # fmt: skip


@pytest.fixture(scope="module")
def flight():
    elevator = doublet(0.6, 0.05)(TIME - 1.0) + multisine(6.0, range(2, 9), rms=0.02)(TIME - 2.0)
    alpha = (
        0.05 + 0.04 * np.sin(2.5 * TIME) * np.exp(-0.2 * TIME) - 0.3 * np.cumsum(elevator) * 0.04
    )
    q = np.gradient(alpha, TIME) + 0.05 * np.sin(1.3 * TIME)
    return pd.DataFrame(
        {"time": TIME, "airspeed": 20.0 + TIME, "alpha": alpha, "q": q, "elevator": elevator}
    )


def dense(time, white, drift, memory):
    lag = np.abs(np.subtract.outer(time, time))
    return white**2 * np.eye(len(time)) + drift**2 * np.exp(-lag / memory)


def columns(flight, chord):
    q_hat = flight["q"] * chord / (2 * flight["airspeed"])
    return np.column_stack([np.ones(len(flight)), flight["alpha"], q_hat, flight["elevator"]])


@pytest.mark.parametrize("about", [None, [0.05, 0.0, 0.01]])
def test_standard_errors_are_those_of_generalised_least_squares(flight, uav, about):
    """Of the slopes at a point, where curvature is estimated too."""
    found = expected_information(flight, uav, ["alpha", "q_hat", "elevator"], NOISE, about=about)
    X = columns(flight, uav.chord)
    if about is not None:
        z = X[:, 1:] - about
        X = np.column_stack([X, *(z[:, i] * z[:, j] for i in range(3) for j in range(i, 3))])
    for k, name in enumerate(NOISE.index):
        scale = np.abs(X).max(axis=0)
        expected = np.linalg.inv(
            (X / scale).T @ np.linalg.solve(dense(TIME, *NOISE.loc[name]), X / scale)
        )
        expected = (expected / np.outer(scale, scale))[1:4, 1:4]
        np.testing.assert_allclose(found.covariance[k], expected, rtol=1e-6)
        np.testing.assert_allclose(found.std.loc[name], np.sqrt(np.diag(expected)), rtol=1e-6)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.correlation(name), expected / np.outer(std, std), rtol=1e-6)


def test_standard_errors_are_the_scatter_of_estimates(flight, uav):
    found = expected_information(flight, uav, ["alpha", "q_hat", "elevator"], NOISE)
    X, rng = columns(flight, uav.chord), np.random.default_rng(0)
    for name in NOISE.index:
        V = dense(TIME, *NOISE.loc[name])
        weights = np.linalg.solve(V, X)
        measured = (
            X @ [0.1, -0.6, -9.0, -1.0]
            + rng.standard_normal((3000, len(TIME))) @ np.linalg.cholesky(V).T
        )
        estimates = np.linalg.solve(X.T @ weights, weights.T @ measured.T)
        np.testing.assert_allclose(estimates[1:].std(axis=1), found.std.loc[name], rtol=0.05)
        np.testing.assert_allclose(estimates[1:].mean(axis=1), [-0.6, -9.0, -1.0], rtol=0.05)


def test_information_of_flights_adds_up(flight, uav):
    names = ["alpha", "elevator"]
    one = expected_information(flight, uav, names, NOISE)
    both = expected_information(
        pd.concat([flight.assign(flight=k) for k in "ab"]), uav, names, NOISE
    )
    np.testing.assert_allclose((one + one).std, both.std)
    np.testing.assert_allclose(both.std, one.std / np.sqrt(2))
    bent = expected_information(flight, uav, names, NOISE, about=[0.05, 0.0])
    assert ((bent + one).std < bent.std).all(axis=None)
    np.testing.assert_allclose((bent + one).std, (one + bent).std)
    with pytest.raises(ValueError, match="same regressors"):
        one + expected_information(flight, uav, ["alpha"], NOISE)


def test_what_a_flight_cannot_tell_is_said(flight, uav):
    flight = flight.assign(aileron=0.0, beta=2 * flight["elevator"])
    found = expected_information(flight, uav, ["alpha", "aileron", "beta", "elevator"], NOISE)
    std = found.std.loc["Cm"]
    assert np.isinf(std[["aileron", "beta", "elevator"]]).all()
    assert std["alpha"] == pytest.approx(
        expected_information(flight, uav, ["alpha", "elevator"], NOISE).std.loc["Cm", "alpha"],
        rel=1e-6,
    )


def test_pairs_that_move_alike_are_confounded(flight, uav):
    """Pitch rate and alpha_dot differ by the slow turn of the flight path alone."""
    found = expected_information(
        flight, uav, ["alpha", "alpha_dot_hat", "q_hat", "elevator"], NOISE
    )
    pairs = found.confounded(0.7)
    assert {"alpha_dot_hat", "q_hat"} in [
        set(pair) for pair in zip(pairs["first"], pairs["second"], strict=True)
    ]
    assert (pairs["correlation"].abs().diff()[1:] <= 0).all()
    assert pairs["correlation"].abs().min() >= 0.7


def test_the_noise_of_a_model_is_split_into_white_noise_and_drift():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 40.0, 0.1)
    X = rng.uniform(size=(400, 1))
    noise = np.linalg.cholesky(dense(time, 0.05, 0.1, 1.0)) @ rng.standard_normal(400)
    model = DependentGPRegressor(structure="trend", input_noise=None)
    model.fit(X, (2 * X[:, 0] + noise)[:, None], time=time)
    found = coefficient_noise(model).iloc[0]
    assert found["white"] == pytest.approx(0.05, rel=0.3)
    assert found["drift"] == pytest.approx(0.1, rel=0.4)
    assert 0.3 < found["memory"] < 3.0
    with pytest.raises(ValueError, match="fitted DependentGPRegressor"):
        coefficient_noise(DependentGPRegressor())


@pytest.mark.parametrize(
    ("regressors", "noise", "words"),
    [
        (["elevater"], {"Cm": 0.1}, "nearest: 'elevator'"),
        (["beta_dot_hat"], {"Cm": 0.1}, "'beta'"),
        (["alpha"], {}, "at least one of each"),
        ([], {"Cm": 0.1}, "at least one of each"),
        (["alpha"], {"Cm": 0.0}, "one of them > 0"),
        (["alpha"], pd.DataFrame({"white": [0.1]}, index=["Cm"]), "drift"),
    ],
)
def test_what_is_missing_is_said(flight, uav, regressors, noise, words):
    with pytest.raises(ValueError, match=words):
        expected_information(flight, uav, regressors, noise)


def test_rows_that_cannot_be_used_are_said(flight, uav):
    for table, words in (
        (flight[::-1], "increase strictly"),
        (flight.assign(alpha=flight["alpha"].where(flight["time"] < 5.0)), "NaN or infinite"),
    ):
        with pytest.raises(ValueError, match=words):
            expected_information(table, uav, ["alpha"], NOISE)


def test_what_a_model_knows_is_what_its_derivatives_say_of_themselves(uav):
    """Learned with noisy regressors, to the scatter of 400 draws: one number, whoever asks."""
    rng, names = np.random.default_rng(0), ["alpha", "q_hat", "elevator"]
    X = 0.1 * rng.normal(size=(80, 3))
    slopes = np.array([[0.3, 0, -4.5, 0, -0.6, 0], [0, 0, -3, 0, -9, 0], [0, 0, -0.4, 0, -1, 0.0]])
    Y = pd.DataFrame(
        X @ slopes + 0.01 * rng.normal(size=(80, 6)), columns=["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
    )
    model = DependentGPRegressor(structure="trend", input_noise=0.02).fit(
        pd.DataFrame(X, columns=names), Y
    )
    state = np.array([0, 0, -100, 20, 0, 1, 1, 0, 0, 0, 0, 0, 0.0])
    table = stability_derivatives(model, uav, state, {"elevator": 0.0}, n_paths=400, thrust=None)
    found = posterior_information(model, [np.arctan2(1.0, 20.0), 0.0, 0.0]).std
    for name in ("Cm_alpha", "Cm_q", "Cm_elevator", "CZ_q"):
        coefficient, regressor = name.split("_")
        known = found.loc[coefficient, "q_hat" if regressor == "q" else regressor]
        assert known == pytest.approx(table.loc[name, "std_unmerged"], rel=0.06)
    assert table.loc["Cm_q", "std"] > 3 * table.loc["Cm_q", "std_unmerged"]
