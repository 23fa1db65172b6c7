"""Targets keep their names, whichever library their table is of."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp.model_selection import thin_targets

X = default_rng(0).normal(size=(40, 2))
TARGETS = {"CZ": -4.0 * X[:, 0], "Cm": np.where(np.arange(40) % 4, -X[:, 1], np.nan)}


@pytest.fixture(params=["pandas", "polars"])
def library(request):
    """Return a library of dataframes."""
    return pytest.importorskip(request.param)


def fitted(y, inputs=X):
    return DependentGPRegressor(structure="trend").fit(inputs, y)


def test_names(library):
    Y = library.DataFrame(TARGETS)
    model = fitted(Y, library.DataFrame({"alpha": X[:, 0], "q": X[:, 1]}))
    assert model.output_names_ == ["CZ", "Cm"]
    assert model.feature_names_in_.tolist() == ["alpha", "q"]
    assert fitted(Y["Cm"]).output_names_ == ["Cm"]
    assert fitted(library.Series(X[:, 0])).output_names_ == ["y0"]


@pytest.mark.parametrize(
    "y", [X, X.tolist(), pd.DataFrame(X), pd.DataFrame(X, columns=["CZ", 1])], ids=lambda y: type(y)
)
def test_what_has_no_names(y):
    assert fitted(y).output_names_ == ["y0", "y1"]


def test_missing_values_are_not_observed():
    """Of polars, null is missing as NaN is."""
    polars = pytest.importorskip("polars")
    nulls = [None if np.isnan(value) else value for value in TARGETS["Cm"].tolist()]
    given = polars.DataFrame({"CZ": TARGETS["CZ"], "Cm": nulls})
    assert_allclose(fitted(given).predict(X), fitted(pd.DataFrame(TARGETS)).predict(X))


def test_thinned(library):
    Y = library.DataFrame(TARGETS)
    thin = thin_targets(Y, 10)
    alone = thin_targets(Y["CZ"], 10)
    assert (type(thin), type(alone)) == (type(Y), type(Y["CZ"]))
    assert list(thin.columns) == list(Y.columns)
    assert alone.name == "CZ"
    for values in (np.asarray(thin, float)[:, 0], np.asarray(alone, float)):
        assert np.isfinite(values).sum() == 10
