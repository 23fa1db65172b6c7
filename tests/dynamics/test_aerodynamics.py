"""The seam: a pipeline as a function of named regressors gives the pipeline's numbers, slopes and beliefs."""

import copy

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from made_outputs import slopes_over
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    FunctionTransformer,
    MaxAbsScaler,
    MinMaxScaler,
    PolynomialFeatures,
    RobustScaler,
    SplineTransformer,
    StandardScaler,
)

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aerodynamics, as_aerodynamics
from skdgp.preprocessing import ElevonSplitter, RateNondimensionalizer, RegressorSelector

REGRESSORS = ["alpha", "beta", "p_hat", "elevator"]


@pytest.fixture(scope="module")
def flight():
    rng = default_rng(0)
    table = pd.DataFrame(
        rng.normal(0, 0.1, (120, 6)),
        columns=["alpha", "beta", "p", "q", "elevon_left", "elevon_right"],
    )
    return table.assign(airspeed=30 + rng.normal(0, 1, 120))


@pytest.fixture(scope="module")
def targets(flight):
    alpha, left = flight["alpha"], flight["elevon_left"]
    waves = [np.sin((k + 1) * alpha * 8) + left * k + 0.3 * flight["beta"] * k for k in range(6)]
    return pd.DataFrame(np.stack(waves, axis=1), columns=COEFFICIENTS)


def pipeline(*behind):
    return make_pipeline(
        ElevonSplitter(),
        RateNondimensionalizer(span=2.8, chord=1.2),
        RegressorSelector(REGRESSORS),
        *behind,
    )


@pytest.fixture(scope="module")
def fitted(flight, targets):
    regressor = DependentGPRegressor(n_latent=1, structure="joint", max_iter=8, random_state=0)
    return pipeline(StandardScaler(), regressor).fit(flight, targets)


@pytest.fixture(scope="module")
def X(fitted, flight):
    return fitted[:3].transform(flight).to_numpy()[::7]


BEHIND = {
    "scaled": lambda: (StandardScaler(), LinearRegression()),
    "scaled to ranges": lambda: (
        MinMaxScaler((-1, 2)),
        RobustScaler(),
        MaxAbsScaler(),
        LinearRegression(),
    ),
    "bare": lambda: (LinearRegression(),),
    "polynomial": lambda: (StandardScaler(), PolynomialFeatures(2), LinearRegression()),
    "sparse": lambda: (SplineTransformer(sparse_output=True), Ridge()),
    "tables": lambda: (
        StandardScaler().set_output(transform="pandas"),
        PolynomialFeatures(2).set_output(transform="pandas"),
        LinearRegression(),
    ),
}


@pytest.mark.parametrize("behind", BEHIND)
def test_gives_the_numbers_of_the_pipeline_for_rows_of_the_table(behind, flight, targets):
    model = pipeline(*BEHIND[behind]()).fit(flight, targets)
    aerodynamics = as_aerodynamics(model)
    assert aerodynamics.regressors == tuple(REGRESSORS)
    rows = model[:3].transform(flight).to_numpy()
    assert_allclose(aerodynamics(rows), model.predict(flight), atol=1e-12)
    assert_allclose(aerodynamics(rows[0]), model.predict(flight)[0], atol=1e-12)


def test_knows_what_was_flown_and_the_lengths_and_the_mixing_of_the_pipeline(fitted, flight):
    aerodynamics = as_aerodynamics(fitted)
    rows = fitted[:3].transform(flight)
    ends = [rows.min(axis=0), rows.max(axis=0)]
    assert_allclose(aerodynamics.limits, ends, rtol=1e-9, atol=1e-10)
    assert (aerodynamics.span, aerodynamics.chord) == (2.8, 1.2)
    assert aerodynamics.mixing.surfaces == ("elevon_left", "elevon_right")


@pytest.mark.parametrize("behind", ["gaussian process", *BEHIND])
def test_slopes_are_those_of_its_values(behind, fitted, flight, targets, X, central_difference):
    model = fitted
    if behind in BEHIND:
        model = pipeline(*BEHIND[behind]()).fit(flight, targets)
    aerodynamics = as_aerodynamics(model)
    expected = central_difference(lambda move: aerodynamics(X + move), np.zeros(4), 1e-5)
    largest = np.abs(expected).max(axis=(0, 1)) + 1e-3
    assert_allclose(aerodynamics.gradient(X) / largest, expected / largest, atol=1e-4)


def test_slopes_over_the_flown_perturbation_are_expected_local_ones(fitted, X):
    """Over a normal perturbation of each regressor alone, by quadrature."""
    local = as_aerodynamics(fitted)
    points = X[:3]
    found = local.over("flown").gradient(points)
    expected = slopes_over(local.gradient, points, local.perturbation, n_nodes=200)
    largest = np.abs(expected).max(axis=(0, 1))
    assert_allclose(found / largest, expected / largest, atol=1e-5)


def test_outputs_come_in_the_order_of_the_house_whatever_the_table_had(flight, targets, X):
    turned = targets[COEFFICIENTS[::-1]]
    regressor = DependentGPRegressor(n_latent=1, optimizer=None, random_state=0)
    model = pipeline(StandardScaler(), regressor).fit(flight, turned)
    aerodynamics = as_aerodynamics(model)
    learned = np.sort(aerodynamics.learned.training_rows(), axis=0)
    assert_allclose(learned, np.sort(model[:3].transform(flight), axis=0), atol=1e-12)
    direct = model[3:].predict(pd.DataFrame(X, columns=REGRESSORS))[:, ::-1]
    assert_allclose(aerodynamics(X), direct, atol=1e-12)


def test_a_drift_of_one_output_leaves_the_others(fitted):
    model = copy.deepcopy(fitted)
    model[-1].drift_variance_ = np.eye(6)[2]
    model[-1].drift_memory_ = np.where(np.eye(6)[2], 3.0, np.nan)
    assert_array_equal(as_aerodynamics(model).drift.memory, [1, 1, 3, 1, 1, 1])


def test_sampled_functions_are_those_of_the_regressor(fitted, X):
    at = X[:3]
    drawn = as_aerodynamics(fitted).sample(2, random_state=0)
    scaled = fitted[3:-1].transform(pd.DataFrame(at, columns=REGRESSORS))
    expected = fitted[-1].sample_paths(2, random_state=0)(scaled)
    assert_allclose(drawn(np.stack([at, at])), expected, rtol=1e-9, atol=1e-12)


def test_a_transformer_declares_what_becomes_of_it_in_a_simulation(flight, targets):
    class Choice(TransformerMixin, BaseEstimator):
        """Chooses regressors as RegressorSelector does."""

        def in_simulation(self):
            limits = [[0.0, 0.0], [1.0, 1.0]]
            return {"regressors": self.regressors_, "limits": limits, "flown": {"phi": (-0.5, 0.4)}}

        def fit(self, X, y=None):
            self.regressors_ = ["alpha", "beta"]
            return self

        def transform(self, X):
            return X[self.regressors_]

    # Has nothing to smooth here
    neighbours = FunctionTransformer(lambda X: X.rolling(3, min_periods=1).mean())
    model = make_pipeline(neighbours, Choice(), LinearRegression()).fit(flight, targets)
    aerodynamics = as_aerodynamics(model)
    assert aerodynamics.regressors == ("alpha", "beta")
    assert_array_equal(aerodynamics.limits, [[0, 0], [1, 1]])
    assert aerodynamics.flown == {"phi": (-0.5, 0.4)}
    point = flight[["alpha", "beta"]].iloc[:1]
    assert_allclose(aerodynamics(point), model[-1].predict(point))


def test_an_estimator_that_learned_from_a_table_needs_no_pipeline(flight, targets):
    table = flight[["alpha", "beta"]]
    model = LinearRegression().fit(table, targets)
    aerodynamics = as_aerodynamics(model)
    assert aerodynamics.regressors == ("alpha", "beta")
    assert_allclose(aerodynamics(table), model.predict(table))
    assert hasattr(model, "feature_names_in_")  # the user's model is left as it was


def learned_without_names(flight, targets):
    return LinearRegression().fit(np.zeros((120, 2)), targets)


def scaled_before_chosen(flight, targets):
    first = StandardScaler().set_output(transform="pandas")
    chosen = make_pipeline(first, RegressorSelector(["alpha", "beta"]), LinearRegression())
    return chosen.fit(flight, targets)


@pytest.mark.parametrize(("learned", "match"), [
    (lambda X, Y: pipeline(LinearRegression()).fit(X, Y[["CZ", "Cm"]]), "expected all six coefficients"),
    (lambda X, Y: pipeline(DependentGPRegressor(n_latent=0, optimizer=None)).fit(X, Y[["CZ", "Cm"]]),
     r"lacks \['CX', 'CY', 'Cl', 'Cn'\]"),
    (learned_without_names, "have no names"),
    (scaled_before_chosen, r"Got \['StandardScaler'\] before the choice of regressors"),
    (lambda X, Y: {}, "Got dict as the model"),
])  # fmt: skip
def test_what_is_no_aerodynamic_model(flight, targets, learned, match):
    with pytest.raises((ValueError, TypeError), match=match):
        as_aerodynamics(learned(flight, targets))


@pytest.mark.parametrize(("ask", "match"), [
    (lambda model: Aerodynamics(model, ["alpha", "alpha"]), "each once"),
    (lambda model: Aerodynamics(model, "alpha"), "expected a list of names"),
    (lambda model: Aerodynamics(model, ["alpha"]).sample(3), "without posterior samples"),
])  # fmt: skip
def test_what_an_aerodynamic_model_cannot(fitted, ask, match):
    with pytest.raises(ValueError, match=match):
        ask(as_aerodynamics(fitted))
