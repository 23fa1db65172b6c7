"""What every transformer of flight tables promises."""

import inspect
import pickle
from functools import cache

import numpy as np
import pandas as pd
import pytest
from made_flights import make_flight
from numpy.random import default_rng
from pandas.testing import assert_frame_equal, assert_series_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.utils import get_tags
from sklearn.utils.estimator_checks import check_estimator

import skdgp.preprocessing as preprocessing
from skdgp.preprocessing import (
    ElevonSplitter,
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
    RateNondimensionalizer,
    RegressorSelector,
)

TRANSFORMERS = [
    FlightCheck(),
    LagCorrector(),
    LagCorrector({"air": 0.08, "p": -0.03}),
    FlightPathReconstruction(),
    FlightSmoother(cutoff=4.0, columns=["alpha", "p", "q", "r"]),
    ElevonSplitter(),
    RateNondimensionalizer(span=2.8, chord=1.2),
    RegressorSelector("paper"),
]


LEVELS = {
    "alpha beta p q r p_dot q_dot r_dot ax ay az": (0, 0.4, 0.02),
    "elevon_left elevon_right rudder phi theta psi": (0, 0.07, 0.02),
    "airspeed": (30, 0.7, 0),
}
# What stands still, and strangers: text, truth and an unknown column
STILL = {
    "throttle": 0.5, "v_north": 30.0, "v_east": 1.0, "v_down": 0.0, "alpha_true": 0.0, "remark": "a word",
    "my_sensor": 1,
}  # fmt: skip


def flight(name, seed):
    """Return a flight with every regressor's raw material."""
    table = make_flight(LEVELS, 150, 0.02, seed=seed)
    left, right = table["elevon_left"], table["elevon_right"]
    surfaces = {"elevator": (left + right) / 2, "aileron": (left - right) / 2}
    return table.assign(flight=name, **surfaces, **STILL)


@cache
def smoothed_table():
    flights = [flight("one", 3), flight("two", 4)]
    return FlightSmoother().fit_transform(pd.concat(flights, ignore_index=True))


@pytest.fixture
def table():
    """Return a table that is ready for every transformer."""
    return smoothed_table().copy()


@pytest.fixture(scope="module", params=TRANSFORMERS, ids=repr)
def transformer(request):
    return request.param


@pytest.fixture(scope="module")
def fitted(transformer):
    """Return the transformer fitted to the table; not to be changed."""
    return clone(transformer).fit(smoothed_table().copy())


@pytest.fixture(scope="module")
def out(fitted):
    return fitted.transform(smoothed_table().copy())


def test_every_public_transformer_is_checked():
    public = {obj for obj in vars(preprocessing).values() if inspect.isclass(obj)}
    assert public == {*ONE_OF_EACH, preprocessing.FlightDataWarning}
    assert len(ONE_OF_EACH) == 7


ONE_OF_EACH = {type(transformer): transformer for transformer in TRANSFORMERS[::-1]}


@pytest.mark.filterwarnings("ignore:Can't test estimator:sklearn.exceptions.SkipTestWarning")
@pytest.mark.parametrize("one", ONE_OF_EACH.values(), ids=repr)
def test_scikit_learn_contract(one):
    """Its checks of arrays do not apply: their contracts are stated for tables, below."""
    results = check_estimator(one, on_skip=None, on_fail=None)
    assert {result["status"] for result in results} == {"passed"}
    assert not get_tags(one).input_tags.two_d_array


@pytest.mark.filterwarnings("ignore:Sensors contradict")  # noise does
class TestContract:
    def test_names_out_are_the_columns_that_come_out(self, fitted, out, table):
        assert list(out) == list(fitted.get_feature_names_out())
        assert list(fitted.feature_names_in_) == list(table)

    def test_strangers_pass_untouched_or_stay_behind(self, transformer, out, table):
        for name in ("flight", "remark", "my_sensor", "alpha_true"):
            assert isinstance(transformer, RegressorSelector) == (name not in out)
            if name in out:
                assert_series_equal(out[name], table[name])

    def test_input_is_not_written_to_and_its_index_is_kept(self, transformer, table):
        table.index += 5000
        before = table.copy(deep=True)
        assert clone(transformer).fit(table).transform(table).index.equals(table.index)
        assert_frame_equal(table, before)

    def test_other_columns_and_order_at_transform_do_not_matter(self, fitted, out, table):
        other = table[table.columns[::-1]].drop(columns=["alpha_true", "remark"]).assign(new=2.0)
        got = fitted.transform(other)
        shared = [name for name in out if name in got]
        assert_frame_equal(got[shared], out[shared])

    def test_pickle(self, fitted, out, table):
        assert_frame_equal(pickle.loads(pickle.dumps(fitted)).transform(table), out)

    @pytest.mark.parametrize("time", [{}, {"time": 0.02 * np.arange(200)}])
    def test_a_table_without_any_of_its_columns_is_refused(self, transformer, time):
        if isinstance(transformer, ElevonSplitter):
            pytest.skip("an aircraft need not have elevons")
        table = pd.DataFrame({"foo": np.zeros(200), "bar": 1.0, **time})
        with pytest.raises(ValueError, match=r"docs/notation\.md|columns of the table"):
            clone(transformer).fit(table)

    def test_needs_a_fit(self, transformer, table):
        with pytest.raises(NotFittedError):
            transformer.transform(table)
        with pytest.raises(NotFittedError):
            transformer.get_feature_names_out()

    def test_fitting_again_forgets(self, transformer, fitted, out, table):
        twice = clone(transformer).fit(table[:150].assign(new=1.0)).fit(table)
        assert vars(fitted).keys() == vars(twice).keys()
        assert fitted.n_features_in_ == twice.n_features_in_ == table.shape[1]
        assert_frame_equal(out, twice.transform(table))

    def test_fit_and_transform_keep_the_parameters_and_what_was_learned(
        self, transformer, fitted, table
    ):
        learned = pickle.dumps(fitted)
        fitted.transform(table)
        assert repr(fitted.get_params()) == repr(transformer.get_params())
        assert pickle.dumps(fitted) == learned

    def test_an_array_is_refused(self, transformer, table):
        for X in (default_rng(0).normal(size=(20, 3)), table.to_numpy()):
            with pytest.raises(TypeError, match=r"ndarray'> .*but expected a pandas DataFrame"):
                clone(transformer).fit(X)

    def test_fit_transform_is_fit_and_transform(self, transformer, out, table):
        assert_frame_equal(clone(transformer).fit_transform(table), out)
