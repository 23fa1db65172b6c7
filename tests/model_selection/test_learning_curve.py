"""Learning curves over seconds of flight against fits by hand."""

import joblib
import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from skdgp.metrics import SCORERS, score_outputs
from skdgp.model_selection import BlockSplit, flight_learning_curve, thin_targets


@pytest.fixture
def linear(model):
    return model.set_params(dependentgpregressor=LinearRegression())


class TestPoints:
    def test_are_fits_to_the_first_seconds_of_each_training_flight(self, flights, linear):
        table, Y = flights(names=("a", "b", "c"))
        table["time"] += 1000.0
        curve = flight_learning_curve(linear, table, Y, seconds=[5, 10])
        assert curve[["seconds", "split"]].values.tolist() == [[s, k] for s in (5.0, 10.0) for k in range(3)]
        row = curve.iloc[1]
        train = (table["flight"] != "b") & (table["time"] < 1005.0 - 1e-9)
        test = table["flight"] == "b"
        fitted = clone(linear).fit(table[train], Y[train])
        assert row["n_samples"] == train.sum() == 200
        for name, value in score_outputs(fitted, table[test], Y[test]).items():
            assert row[name] == value

    def test_of_given_test_flights(self, flights, linear):
        table, Y = flights()
        other, other_Y = flights(names=("c",), seed=1)
        curve = flight_learning_curve(linear, table, Y, seconds=15, test_table=other, test_Y=other_Y)
        expected = score_outputs(clone(linear).fit(table, Y), other, other_Y)
        assert len(curve) == 1
        assert {name: curve[name][0] for name in expected} == expected

    def test_seconds_are_those_that_are_left_on_both_sides_of_a_block(self, flights, linear):
        table, Y = flights(names=("a",))
        curve = flight_learning_curve(linear, table, Y, seconds=[9.0], cv=BlockSplit(3, gap=0.0))
        assert curve["n_samples"].tolist() == [180] * 3

    def test_with_as_many_samples_everywhere(self, flights, model):
        table, Y = flights()
        curve = flight_learning_curve(
            model, table, Y, seconds=[4, 12], n_samples=30, cv=[(np.arange(300), np.arange(300, 600))]
        )
        assert curve["n_samples"].tolist() == [30, 30]
        assert curve["continuous_ranked_probability_score_CZ"].notna().all()
        fitted = clone(model).fit(table[:80], thin_targets(Y[:80], 30))
        assert curve["normalized_rmse_Cm"][0] == score_outputs(fitted, table[300:], Y[300:])["normalized_rmse_Cm"]

    def test_scoring_of_any_kind(self, flights, linear):
        table, Y = flights()
        for scoring, names in [
            ("r2", ["score"]),
            (SCORERS["neg_normalized_rmse"], ["score"]),
            ({"r2": "r2", "rmse": SCORERS["neg_normalized_rmse"]}, ["r2", "rmse"]),
        ]:
            curve = flight_learning_curve(linear, table, Y, seconds=[15], scoring=scoring)
            assert list(curve) == ["seconds", "split", "n_samples", *names]
        array = flight_learning_curve(linear, table, Y["CZ"].to_numpy(), seconds=[15])
        np.testing.assert_allclose(
            array["normalized_rmse_0"],
            flight_learning_curve(linear, table, Y[["CZ"]], seconds=[15])["normalized_rmse_CZ"],
        )

    def test_side_by_side_is_the_same(self, flights, linear):
        table, Y = flights()
        with joblib.parallel_config("threading"):
            one, two = (flight_learning_curve(linear, table, Y, seconds=[5, 15], n_jobs=n) for n in (None, 2))
        pd.testing.assert_frame_equal(one, two, rtol=1e-9)


class TestErrors:
    def test_says_what_it_needs(self, flights, linear):
        table, Y = flights()
        single, single_Y = flights(names=("a",))
        with pytest.raises(ValueError, match="longest training flight has 15 s"):
            flight_learning_curve(linear, table, Y, seconds=[5, 16])
        with pytest.raises(ValueError, match="expected a positive number"):
            flight_learning_curve(linear, table, Y, seconds=[0])
        with pytest.raises(ValueError, match="Got one flight, but expected several"):
            flight_learning_curve(linear, single, single_Y, seconds=[5])
        with pytest.raises(ValueError, match="expected its test_Y"):
            flight_learning_curve(linear, table, Y, seconds=[5], test_table=single)
