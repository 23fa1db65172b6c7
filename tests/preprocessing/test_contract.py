"""What every transformer of flight tables promises."""

import inspect
import pickle
from functools import cache

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal, assert_series_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.preprocessing import StandardScaler
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
    FlightSmoother(),
    FlightSmoother(cutoff=4.0, derivatives=["p", "q", "r"]),
    ElevonSplitter(),
    RateNondimensionalizer(span=2.8, chord=1.2),
    RegressorSelector(),
    RegressorSelector("paper"),
    RegressorSelector(["alpha", "q"]),
]


def flight_table(n=200, flights=("one", "two"), seed=3):
    """Flights with every regressor's raw material, plus strangers: text, truth and an unknown column."""
    rng = default_rng(seed)
    parts = []
    for flight in flights:
        t = 0.02 * np.arange(n)
        waves = {
            name: np.sin((1 + 0.1 * k) * t + k) + rng.normal(0, 0.02, n)
            for k, name in enumerate(
                ["alpha", "beta", "p", "q", "r", "p_dot", "q_dot", "r_dot", "ax", "ay", "az"]
            )
        }
        left, right = 0.1 * np.sin(3 * t), 0.1 * np.cos(2 * t)
        parts.append(
            pd.DataFrame({"time": t, "flight": flight, "airspeed": 30 + np.sin(t), **waves})
            .assign(
                elevon_left=left,
                elevon_right=right,
                elevator=(left + right) / 2,
                aileron=(left - right) / 2,
            )
            .assign(
                phi=0.01 * np.cos(t),
                theta=0.1 + 0.01 * np.sin(t),
                psi=0.2 * np.sin(t),
                v_north=30.0,
                v_east=1.0,
                v_down=0.0,
            )
            .assign(
                rudder=0.05 * np.sin(t), throttle=0.5, alpha_true=0.0, remark="a word", my_sensor=1
            )
        )
    return pd.concat(parts, ignore_index=True)


@cache
def smoothed_table():
    return FlightSmoother().fit_transform(flight_table())


def ready_table():
    return smoothed_table().copy()


def test_every_public_transformer_is_checked():
    public = {obj for obj in vars(preprocessing).values() if inspect.isclass(obj)}
    public -= {preprocessing.FlightDataWarning, preprocessing.AirMotion}
    assert public == {type(transformer) for transformer in TRANSFORMERS}
    assert len(public) == 7


ONE_OF_EACH = [
    transformer
    for k, transformer in enumerate(TRANSFORMERS)
    if type(transformer) not in {*map(type, TRANSFORMERS[:k])}
]


@pytest.mark.filterwarnings("ignore:Can't test estimator:sklearn.exceptions.SkipTestWarning")
@pytest.mark.parametrize("transformer", ONE_OF_EACH, ids=repr)
def test_scikit_learn_contract(transformer):
    """Its checks of arrays do not apply: their contracts are stated for tables, below."""
    results = check_estimator(transformer, on_skip=None, on_fail=None)
    assert {result["status"] for result in results} == {"passed"}
    assert not get_tags(transformer).input_tags.two_d_array


@pytest.mark.parametrize("transformer", TRANSFORMERS, ids=repr)
class TestContract:
    def test_names_out_are_the_columns_that_come_out(self, transformer):
        table = ready_table()
        out = clone(transformer).fit(table)
        assert list(out.transform(table).columns) == list(out.get_feature_names_out())
        assert list(out.feature_names_in_) == list(table.columns)

    def test_strangers_pass_untouched_or_stay_behind(self, transformer):
        table = ready_table()
        out = clone(transformer).fit_transform(table)
        for name in ("flight", "remark", "my_sensor", "alpha_true"):
            assert isinstance(transformer, RegressorSelector) == (name not in out)
            if name in out:
                assert_series_equal(out[name], table[name])

    def test_input_is_not_written_to(self, transformer):
        table = ready_table()
        before = table.copy(deep=True)
        clone(transformer).fit_transform(table)
        assert_frame_equal(table, before)

    def test_index_is_kept(self, transformer):
        table = ready_table().set_index(np.arange(400) + 5000)
        assert clone(transformer).fit_transform(table).index.equals(table.index)

    def test_other_columns_and_order_at_transform_do_not_matter(self, transformer):
        table = ready_table()
        fitted = clone(transformer).fit(table)
        other = table[table.columns[::-1]].drop(columns=["alpha_true", "remark"]).assign(new=2.0)
        expected, got = fitted.transform(table), fitted.transform(other)
        shared = [name for name in expected.columns if name in got]
        assert_frame_equal(got[shared], expected[shared])

    def test_pickle_and_clone(self, transformer):
        table = ready_table()
        fitted = clone(transformer).fit(table)
        again = pickle.loads(pickle.dumps(fitted))
        assert_frame_equal(again.transform(table), fitted.transform(table))

    def test_an_array_is_refused(self, transformer):
        for X in (default_rng(0).normal(size=(20, 3)), ready_table().to_numpy()):
            with pytest.raises(TypeError, match=r"Got ndarray .*but expected a pandas DataFrame"):
                clone(transformer).fit(X)

    @pytest.mark.parametrize("time", [False, True])
    def test_a_table_without_any_of_its_columns_is_refused(self, transformer, time):
        table = pd.DataFrame({"foo": np.zeros(200), "bar": 1.0}).assign(
            **{"time": 0.02 * np.arange(200)} if time else {}
        )
        with pytest.raises(ValueError, match=r"docs/notation\.md|columns of the table"):
            clone(transformer).fit(table)

    def test_needs_a_fit(self, transformer):
        for method in (transformer.transform, lambda _: transformer.get_feature_names_out()):
            with pytest.raises(NotFittedError):
                method(ready_table())

    def test_fitting_again_forgets(self, transformer):
        table = ready_table()
        once = clone(transformer).fit(table)
        twice = clone(transformer).fit(table[:200].assign(new=1.0)).fit(table)
        assert vars(once).keys() == vars(twice).keys()
        assert once.n_features_in_ == twice.n_features_in_ == table.shape[1]
        assert_frame_equal(once.transform(table), twice.transform(table))

    def test_fit_and_transform_keep_the_parameters_and_what_was_learned(self, transformer):
        table, fitted = ready_table(), clone(transformer)
        before = repr(fitted.get_params())
        learned = pickle.dumps(fitted.fit(table))
        fitted.transform(table)
        assert repr(fitted.get_params()) == before
        assert pickle.dumps(fitted) == learned

    def test_reads_the_polars_tables_that_set_output_makes(self, transformer):
        pytest.importorskip("polars")
        table = ready_table()[:200].select_dtypes("number").astype(float)
        first = StandardScaler(with_mean=False, with_std=False).set_output(transform="polars")
        made = first.fit_transform(table)
        expected = clone(transformer).fit_transform(table)
        assert_frame_equal(clone(transformer).fit_transform(made), expected)

    def test_array_after_a_table_is_read_by_position(self, transformer):
        table = ready_table().select_dtypes("number")[:200]
        fitted = clone(transformer).fit(table)
        with pytest.warns(UserWarning, match="does not have valid feature names"):
            out = fitted.transform(table.to_numpy())
        assert_allclose(out.to_numpy(), fitted.transform(table).to_numpy())
