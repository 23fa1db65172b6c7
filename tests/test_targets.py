"""Targets keep their names, whichever library their table is of."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from skdgp import DependentGPRegressor
from skdgp._compute.files import column_names
from skdgp._regressor import check_targets
from skdgp.datasets._example_flights import BRUMBY
from skdgp.dynamics import STATE_NAMES, aerodynamic_coefficients
from skdgp.dynamics._starts import as_starts
from skdgp.model_selection import thin_targets
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightSmoother,
    RateNondimensionalizer,
    RegressorSelector,
)

X = default_rng(0).normal(size=(40, 2))
TARGETS = {"CZ": -4.0 * X[:, 0], "Cm": np.where(np.arange(40) % 4, -X[:, 1], np.nan)}


@pytest.fixture(params=["pandas", "polars"])
def library(request):
    """Return a library of dataframes."""
    return pytest.importorskip(request.param)


def test_names(library):
    Y = library.DataFrame(TARGETS)
    values, names, single = check_targets(Y, 40, "test")
    assert (names, single) == (["CZ", "Cm"], False)
    assert_array_equal(values, np.column_stack(list(TARGETS.values())))
    assert check_targets(Y["Cm"], 40, "test")[1:] == (["Cm"], True)
    assert column_names(library.Series([1.0, 2.0])) == []


@pytest.mark.parametrize(
    "y", [X, X.tolist(), pd.DataFrame(X), pd.DataFrame(X, columns=["CZ", 1]), pd.Series([1.0])]
)
def test_what_has_no_names(y):
    assert column_names(y) == []


def test_missing_values_are_not_observed():
    polars = pytest.importorskip("polars")
    values, *_ = check_targets(polars.DataFrame({"CZ": [1.0, None], "n": [None, 2]}), 2, "test")
    assert_array_equal(values, [[1.0, np.nan], [np.nan, 2.0]])


def test_regressor(library):
    model = DependentGPRegressor(n_latent=1, max_iter=1, random_state=0)
    inputs, Y = library.DataFrame({"alpha": X[:, 0], "q": X[:, 1]}), library.DataFrame(TARGETS)
    model.fit(inputs, Y)
    assert model.output_names_ == ["CZ", "Cm"]
    assert model.feature_names_in_.tolist() == ["alpha", "q"]


def test_thinned(library):
    for Y in (library.DataFrame(TARGETS), library.DataFrame(TARGETS)["CZ"]):
        thin = thin_targets(Y, 10)
        assert type(thin) is type(Y)
        assert column_names(thin) == column_names(Y)
        assert np.isfinite(np.asarray(thin, float).reshape(40, -1)[:, 0]).sum() == 10


def test_starts_are_taken_by_name(library):
    starts = as_starts(library.DataFrame({name: [1.0] for name in reversed(STATE_NAMES)}))
    assert isinstance(starts, pd.DataFrame)
    assert list(starts) == list(reversed(STATE_NAMES))


def test_flights_of_another_library_are_refused():
    polars = pytest.importorskip("polars")
    flight = polars.DataFrame({"time": [0.0, 0.1], "alpha": [0.0, 0.1]})
    with pytest.raises(TypeError, match=r"expected a pandas DataFrame .* its to_pandas\(\)"):
        aerodynamic_coefficients(flight, BRUMBY)
    assert LinearRegression().fit(flight[["alpha"]], [0, 1]).feature_names_in_.tolist() == ["alpha"]


def test_transformers_hand_tables_of_polars_to_the_regressor():
    polars = pytest.importorskip("polars")
    rng = default_rng(1)
    flight = pd.DataFrame({"time": 0.02 * np.arange(200), "airspeed": 20.0, "note": "calm"})
    waves = np.sin(flight[["time"]].to_numpy() * [3.0, 5.0, 7.0, 4.0]) + 0.01 * rng.normal(
        size=(200, 4)
    )
    flight[["alpha", "q", "elevon_left", "elevon_right"]] = 0.1 * waves
    Y = pd.DataFrame({"CZ": -4.0 * flight["alpha"], "Cm": flight["q"] - flight["elevon_left"]})
    Y.iloc[np.arange(200) % 5 > 0] = np.nan

    def model():
        steps = FlightSmoother(cutoff=4.0), ElevonSplitter(), RateNondimensionalizer(2.0, 0.5)
        regressor = DependentGPRegressor(n_latent=1, max_iter=1, random_state=0)
        return make_pipeline(*steps, RegressorSelector(["alpha", "q_hat", "elevator"]), regressor)

    expected = model().fit(flight, Y).predict(flight, return_std=True)
    pipeline = model()
    pipeline[-2].set_output(transform="polars")
    got = pipeline.fit(flight, polars.from_pandas(Y)).predict(flight, return_std=True)
    assert isinstance(pipeline[:-1].transform(flight), polars.DataFrame)
    assert pipeline[-1].feature_names_in_.tolist() == ["alpha", "q_hat", "elevator"]
    assert_allclose(got, expected, rtol=1e-6, atol=1e-9)

    smoothed = FlightSmoother(cutoff=4.0).set_output(transform="polars").fit_transform(flight)
    assert isinstance(smoothed, polars.DataFrame)
    assert smoothed["note"].to_list() == ["calm"] * 200
    assert smoothed.columns == [*flight.columns, "alpha_dot"]
