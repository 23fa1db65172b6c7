"""DependentGPRegressor among scikit-learn's pipelines and searches, in other processes, and under Ctrl-C."""

import numpy as np
import pandas as pd
import pytest
from made_flights import make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.metrics import r2_score
from sklearn.model_selection import LeaveOneGroupOut, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import SCORERS


@pytest.fixture(scope="module")
def flights():
    """Three short flights of a table, one coefficient not always observed."""
    rng = default_rng(0)
    levels = {"alpha": (0.1, 0.05, 0), "q": (0, 0.3, 0), "airspeed": (40, 10, 0)}
    X = make_flight(levels, 60, width=0).drop(columns="time")
    lift = -4 * X["alpha"] + 0.1 * np.sin(5 * X["q"])
    Y = pd.DataFrame({"CZ": lift, "Cm": 0.1 - 0.2 * lift + 0.01 * X["q"]}) + rng.normal(
        0, 0.005, (60, 2)
    )
    Y.loc[::4, "Cm"] = np.nan
    return X, Y, np.repeat(["one", "two", "three"], 20)


def quick(**more):
    short = {"structure": "joint", "n_latent": 1, "max_iter": 8, "random_state": 0}
    return DependentGPRegressor(**short | more)


class TestScikitLearn:
    def test_score_leaves_targets_out_that_were_not_observed(self, flights):
        X, Y, _ = flights
        model = make_pipeline(StandardScaler().set_output(transform="pandas"), quick()).fit(X, Y)
        seen = Y["Cm"].notna()
        mean = model.predict(X)
        scores = [r2_score(Y["CZ"], mean[:, 0]), r2_score(Y["Cm"][seen], mean[seen, 1])]
        assert model.score(X, Y) == pytest.approx(np.mean(scores))
        twice = model.score(pd.concat([X, X[:5]]), pd.concat([Y, Y[:5]]))
        weights = 1.0 + (np.arange(len(X)) < 5)
        assert model.score(X, Y, sample_weight=weights) == pytest.approx(twice)


class TestFlightsAreGroups:
    """The label of a row's flight is an argument of fit, and the group of a cross-validation."""

    TIME = np.tile(0.1 * np.arange(20), 3)

    def test_both_get_them(self, flights):
        """Flights that are told apart have clocks that may start again; of one they would not."""
        X, Y, flight = flights
        model = quick(structure="trend", n_latent=None)
        expected = []
        for left_out in ("one", "three", "two"):
            rows = flight != left_out
            clock = {"time": self.TIME[rows], "flight": flight[rows]}
            expected.append(clone(model).fit(X[rows], Y["CZ"][rows], **clock).drift_variance_)
        params = {"time": self.TIME, "flight": flight}
        options = {"cv": LeaveOneGroupOut(), "scoring": SCORERS["neg_normalized_rmse"]}
        options |= {"return_estimator": True, "error_score": "raise", "params": params}
        scores = cross_validate(model, X, Y["CZ"], groups=flight, **options)
        found = [fitted.drift_variance_ for fitted in scores["estimator"]]
        assert_allclose(found, expected, rtol=1e-6)
