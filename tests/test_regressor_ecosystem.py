"""DependentGPRegressor among scikit-learn's pipelines and searches, in other processes, and under Ctrl-C."""

import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.model_selection import LeaveOneGroupOut, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import SCORERS


@pytest.fixture(scope="module")
def flights():
    """Three short flights of a table, one coefficient not always observed."""
    rng = np.random.default_rng(0)
    X = pd.DataFrame(
        rng.normal(size=(60, 3)) * [0.05, 0.3, 10.0] + [0.1, 0, 40],
        columns=["alpha", "q", "airspeed"],
    )
    lift = -4 * X["alpha"] + 0.1 * np.sin(5 * X["q"])
    Y = pd.DataFrame({"CZ": lift, "Cm": 0.1 - 0.2 * lift + 0.01 * X["q"]}) + rng.normal(
        0, 0.005, (60, 2)
    )
    Y.loc[::4, "Cm"] = np.nan
    return X, Y, np.repeat(["one", "two", "three"], 20)


def quick(**more):
    return DependentGPRegressor(**({"n_latent": 1, "max_iter": 8, "random_state": 0} | more))


class TestScikitLearn:
    def test_pipeline_passes_the_questions_on(self, flights):
        X, Y, _ = flights
        model = make_pipeline(StandardScaler().set_output(transform="pandas"), quick()).fit(X, Y)
        mean, std = model.predict(X, return_std=True, include_noise=True)
        assert mean.shape == std.shape == (60, 2)
        assert list(model[-1].feature_names_in_) == ["alpha", "q", "airspeed"]
        assert model.score(X, Y) > 0.9  # NaN targets are left out

    def test_fitting_again_forgets(self, flights):
        X, Y, _ = flights
        once = quick().fit(X[:30], Y[:30])
        twice = quick().fit(X, Y["CZ"]).fit(X[:30], Y[:30])
        np.testing.assert_allclose(once.predict(X), twice.predict(X), rtol=1e-6, atol=1e-9)
        assert twice.output_names_ == ["CZ", "Cm"]


class TestFlightsAreGroups:
    """The label of a row's flight is an argument of fit, and the group of a cross-validation."""

    @pytest.fixture
    def time(self):
        return np.tile(0.1 * np.arange(20), 3)

    def drifts(self, flights, time, routing, model, params, **more):
        X, Y, flight = flights
        options = {"cv": LeaveOneGroupOut(), "scoring": SCORERS["neg_normalized_rmse"]}
        with config_context(enable_metadata_routing=routing):
            scores = cross_validate(
                model,
                X,
                Y["CZ"],
                params=params,
                return_estimator=True,
                error_score="raise",
                **options,
                **more,
            )
        return np.array([fitted.drift_variance_ for fitted in scores["estimator"]])

    def test_both_get_them_with_and_without_metadata_routing(self, flights, time):
        """Flights that are told apart have clocks that may start again; of one they would not."""
        flight = flights[2]
        expected = [
            quick().fit(X, y, time=time[rows], flight=flight[rows]).drift_variance_
            for rows in (flight != "one", flight != "three", flight != "two")
            for X, y in [(flights[0][rows], flights[1]["CZ"][rows])]
        ]
        plain = self.drifts(
            flights, time, False, quick(), {"time": time, "flight": flight}, groups=flight
        )
        np.testing.assert_allclose(plain, expected, rtol=1e-6)
        with config_context(enable_metadata_routing=True):
            model = quick().set_fit_request(time=True, flight="groups")
        routed = self.drifts(flights, time, True, model, {"time": time, "groups": flight})
        np.testing.assert_allclose(routed, expected, rtol=1e-6)

    def test_groups_of_the_splitter_alone_need_no_request(self, flights, time):
        drifts = self.drifts(flights, time, True, quick(), {"groups": flights[2]})
        assert (drifts == 0).all()  # without time there is none


class TestFreshProcess:
    """A model that was saved predicts the same where it is loaded."""

    def test_pickle_does_not_grow_by_predicting(self, flights):
        X, Y, _ = flights
        model = quick().fit(X, Y)
        before = len(pickle.dumps(model))
        model.predict(X, return_std=True)
        assert len(pickle.dumps(model)) == before
        assert before < 60_000  # the samples and the hyperparameters
