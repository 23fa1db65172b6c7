"""Derivatives: values, axes, deviations, and errors of slopes that the posterior does not contain."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Aerodynamics, Motion, stability_derivatives
from skdgp.inference import FunctionErrors

EXAMPLE = load_example_flights(duration=1.0)
BRUMBY, REGRESSORS, coefficients = EXAMPLE.aircraft, EXAMPLE.regressor_names, EXAMPLE.aerodynamics
NAMES = EXAMPLE.truth.regressors


def derivatives(X):
    """Return d coefficients / d regressors, (..., 6, 10), exact to rounding by complex steps."""
    steps = np.asarray(X)[..., None, :] + 1e-30j * np.eye(10)
    return np.swapaxes(coefficients(steps).imag, -1, -2) / 1e-30


MODEL = Aerodynamics(coefficients, NAMES, slopes=derivatives)
CONTROLS = {"elevator": -0.03, "aileron": 0.02, "rudder": 0.04, "throttle": 0.6}


@pytest.fixture(scope="module")
def regressors(state):
    return Motion(MODEL, BRUMBY).at(state, CONTROLS).regressors


def test_are_the_known_ones(state, regressors):
    table = stability_derivatives(MODEL, BRUMBY, state, CONTROLS)
    assert_allclose(table.loc[COEFFICIENTS, "value"], coefficients(regressors))
    for coefficient, slopes in zip(COEFFICIENTS, derivatives(regressors), strict=True):
        names = [f"{coefficient}_{name}" for name in REGRESSORS]
        assert_allclose(table.loc[names, "value"], slopes)
    assert len(table) == 8 * 11
    assert "std" not in table
    assert table.loc["Cm_q", ["coefficient", "regressor", "per"]].tolist() == ["Cm", "q", "rad"]


@pytest.mark.filterwarnings("ignore:The model's rates were made non-dimensional")
def test_by_whatever_rates_the_model_was_given(state):
    """Rates in rad/s, and non-dimensional by other lengths than the aircraft's."""
    lengths = np.array([BRUMBY.span, BRUMBY.chord, BRUMBY.span, BRUMBY.chord, BRUMBY.span])

    def dimensional(X):
        X = X[:, :10].copy()
        X[:, 2:7] *= lengths / (2 * 36.0)
        return coefficients(X)

    def doubled(X):
        X = X.copy()
        X[:, 2:7] *= 0.5
        return coefficients(X)

    usual = stability_derivatives(MODEL, BRUMBY, state, CONTROLS)["value"]
    plain = Aerodynamics(dimensional, REGRESSORS)
    others = Aerodynamics(doubled, NAMES, span=2 * BRUMBY.span, chord=2 * BRUMBY.chord)
    for model in (plain, others):
        values = stability_derivatives(model, BRUMBY, state, CONTROLS)["value"]
        assert_allclose(values, usual, rtol=5e-7, atol=5e-9)


def test_lift_and_drag_turn_with_alpha(state, regressors):
    def lift_and_drag(alpha):
        CX, _, CZ, *_ = coefficients([alpha, *regressors[1:]])
        s, c = np.sin(alpha), np.cos(alpha)
        return np.array([CX * s - CZ * c, -CX * c - CZ * s])

    table = stability_derivatives(MODEL, BRUMBY, state, CONTROLS)["value"]
    assert_allclose(table[["CL", "CD"]], lift_and_drag(0.1))
    slopes = (lift_and_drag(0.1 + 1e-5) - lift_and_drag(0.1 - 1e-5)) / 2e-5
    assert_allclose(table[["CL_alpha", "CD_alpha"]], slopes, rtol=1e-8)


def of_slopes(draws):
    """Return linear functions of slopes (n_paths, 6, d), and their slopes."""

    def values(X):
        return X @ draws.swapaxes(1, 2)

    return values, lambda X: np.repeat(draws[:, None], X.shape[1], axis=1)


LEARNED = ["alpha", "q", "elevator"]
UNITS = [1.0, 2 * 36.0 / BRUMBY.chord, 1.0]


@pytest.fixture(scope="module")
def flown():
    """Return a flight of `LEARNED`, and a regressor that learned from its time series. It is no mixture."""
    rng = default_rng(0)
    X = pd.DataFrame(0.1 * rng.normal(size=(60, 3)), columns=LEARNED)
    Y = (np.sin(8 * X) @ rng.normal(size=(3, 6))).set_axis(COEFFICIENTS, axis=1)
    Y += 0.01 * rng.normal(size=Y.shape)
    options = {"structure": "joint", "max_iter": 15, "random_state": 0}
    model = DependentGPRegressor(n_latent=1, **options)
    errors = FunctionErrors(0.2 * rng.normal(size=(1, 4, 6)), np.zeros(3))
    return X, model.fit(X, Y, time=0.1 * np.arange(len(X)), errors=errors)


@pytest.fixture
def at(flown, state):
    regressors = Motion(flown[1], BRUMBY).at(state, CONTROLS).regressors
    return pd.DataFrame([regressors], columns=LEARNED)


class TestDeviations:
    def test_are_over_the_flown_perturbation_unless_local_ones_are_asked_for(
        self, state, flown, at
    ):
        """As the regressor says, in the units of the table: means and deviations of functions."""
        X, model = flown
        flight = model, BRUMBY, state, CONTROLS
        table = stability_derivatives(*flight, n_paths=2)
        spread = X.std(ddof=0).to_numpy()
        rows = table.index[table["regressor"] != ""][: 6 * 3]
        slopes = model.predict_gradient(at, spread)[0]
        assert_allclose(table.loc[rows, "value"], (slopes * UNITS).ravel(), rtol=1e-9)
        assert_allclose(table.loc[rows[:3], "perturbation"], spread / UNITS)
        local = stability_derivatives(*flight, n_paths=0, perturbation=None)
        assert "perturbation" not in local
        assert_allclose(local.loc[rows, "value"], (model.predict_gradient(at)[0] * UNITS).ravel())

    @pytest.fixture
    def uncertain(self):
        """CX and CZ err together, so that drag is surer than either."""
        slopes = np.zeros((6, 2))
        slopes[:, 0] = 0.3, -0.5, -4.0, -0.05, -0.5, 0.08

        def sampler(n_paths, random_state):
            error = default_rng(random_state).normal(size=(n_paths, 1, 1))
            s, c = np.sin(0.1), np.cos(0.1)
            spread = np.outer([c, 0, s, 0, 0, 0], [0, 0.2]) + np.outer(
                [s, 0, -c, 0, 0, 0], [0.3, 0]
            )
            draws = slopes + error * spread
            return of_slopes(draws)

        return Aerodynamics(lambda X: X @ slopes.T, ["alpha", "elevator"], sampler=sampler)

    def test_of_sums_know_that_their_parts_err_together(self, uncertain, state):
        table = stability_derivatives(uncertain, BRUMBY, state, CONTROLS, n_paths=400)
        size = default_rng(0).normal(size=400).std(ddof=1)
        drag = -0.2 * CONTROLS["elevator"]
        # CL_alpha = CX_alpha sin(alpha) - CZ_alpha cos(alpha) - CD
        std = table["std"][["CL_alpha", "CD_elevator", "CL_elevator", "CD"]]
        assert_allclose(std / size, [0.3 - drag, 0.2, 0.0, drag], atol=1e-12)
        value, lower, upper = table.loc["CL_alpha", ["value", "lower", "upper"]]
        assert_allclose([value - lower, upper - value], 1.96 * std["CL_alpha"], rtol=1e-4)

    def test_are_those_of_the_learned_slopes(self, state, slope_std, flown, at):
        """In body axes, what the regressor says of its gradient, within the spread of so many paths."""
        _, model = flown
        n_paths = 300
        flight = model, BRUMBY, state, CONTROLS
        table = stability_derivatives(*flight, n_paths=n_paths, perturbation=None)

        def covariance(x):
            table = pd.DataFrame(x, columns=LEARNED)
            return model.predict(table, return_cov=True, include_input_noise=False)[1]

        std = slope_std(covariance, at.to_numpy()[0]) * UNITS
        rows = table.index[table["regressor"].isin(LEARNED)][: 6 * 3]
        ratio = table.loc[rows, "std"] / std.ravel()
        assert_allclose(ratio, 1.0, atol=5 / np.sqrt(2 * n_paths))
        parts = table[["std_posterior", "std_errors"]]
        assert (parts.loc[rows] >= 0).all(axis=None)
        assert_allclose(np.sqrt((parts**2).sum(axis=1)), table["std"], rtol=1e-3)
        assert (table.loc[["Cm_q", "Cm_elevator", "CL_alpha"], "std_merged"] > 0).all()
        assert table.loc["CL", "std_merged"] == 0


NOWHERE = Aerodynamics(lambda X: np.full((len(X), 6), np.nan), ["alpha", "elevator"])


@pytest.mark.parametrize(("model", "change", "controls", "match"), [
    (MODEL, {"point": np.eye(13)[6]}, CONTROLS, "at rest"),
    (MODEL, {}, None, "controls lack"),
    (NOWHERE, {}, CONTROLS, "not defined there"),

])  # fmt: skip
def test_what_has_no_derivatives(state, model, change, controls, match):
    with pytest.raises(ValueError, match=match):
        stability_derivatives(model, BRUMBY, **{"point": state, "controls": controls} | change)
