"""The calibrated regressor as an estimator: what it holds out, what it scales, where it fits in."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm
from sklearn.frozen import FrozenEstimator
from sklearn.linear_model import BayesianRidge, LinearRegression
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.utils.estimator_checks import check_estimator

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.calibration import CalibratedRegressor
from skdgp.dynamics import Aircraft
from skdgp.metrics import SCORERS
from skdgp.model_selection import BlockSplit, thin_targets

AIRCRAFT = Aircraft(
    name="delta", mass=12.0, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55
)
QUICK = DependentGPRegressor(n_latent=1, optimizer=None, random_state=0)


def make_flights(names="abcd", n=200, seed=0):
    """Flights at 20 Hz with two coefficients; every flight is off by something of its own."""
    rng = np.random.default_rng(seed)
    tables = []
    for k, name in enumerate(names):
        t = np.arange(n) * 0.05
        table = pd.DataFrame(
            {"time": t, "flight": name, "airspeed": 20.0, "q": 0.1 * np.sin(0.5 * t + k)}
        )
        for j, column in enumerate(["alpha", "elevator"]):
            table[column] = 0.1 * np.sin((0.7 + 0.31 * j) * t + k + j) + 0.002 * rng.normal(size=n)
        tables.append(table.assign(offset=0.05 * rng.normal()))
    table = pd.concat(tables, ignore_index=True)
    Y = pd.DataFrame(
        {
            "CZ": -4 * table["alpha"] + table.pop("offset"),
            "Cm": -0.5 * table["alpha"] - table["elevator"],
        }
    )
    return table, Y + rng.normal(0, [0.01, 0.003], Y.shape)


pytestmark = pytest.mark.usefixtures("short_fits")


@pytest.fixture(scope="module")
def flights():
    table, Y = make_flights()
    return table, thin_targets(Y, 80)


def pipeline(regressor=QUICK):
    return make_identification_pipeline(
        AIRCRAFT,
        regressors=["alpha", "q_hat", "elevator"],
        cutoff=3.0,
        mixer="passthrough",
        regressor=regressor,
    )


@pytest.fixture(scope="module")
def model(flights, cut_short):
    with cut_short():
        return CalibratedRegressor(pipeline(), level=0.8).fit(*flights)


class TestScikitLearnContract:
    @pytest.mark.parametrize(
        "estimator",
        [CalibratedRegressor(BayesianRidge()), CalibratedRegressor(QUICK, cv=2)],
        ids=["single output", "several outputs"],
    )
    @pytest.mark.filterwarnings("ignore")
    def test_check_estimator(self, estimator):
        results = check_estimator(estimator, on_skip=None, on_fail=None)
        assert [
            (r["check_name"], r["exception"]) for r in results if r["status"] in ("failed", "xfail")
        ] == []
        assert {r["check_name"] for r in results if r["status"] == "skipped"} <= {
            "check_array_api_input"
        }
        assert Counter(r["status"] for r in results)["passed"] >= 49

    def test_serves_in_searches_and_scores(self, flights):
        search = GridSearchCV(
            CalibratedRegressor(pipeline(), level=0.6, cv=2),
            {"estimator__dependentgpregressor__trend": ["linear"], "level": [0.6]},
            cv=LeaveOneGroupOut(),
            scoring=SCORERS["neg_normalized_rmse"],
            error_score="raise",
        )
        search.fit(*flights, groups=flights[0]["flight"].isin(["a", "b"]))  # two folds
        assert np.isfinite(search.best_score_)
        assert np.isfinite(SCORERS["log_predictive_density"](search, *flights))


class TestHeldOut:
    def test_scores_are_of_models_that_lacked_the_flight(self, model, flights):
        table, Y = flights
        expected = []
        for name in "abcd":
            inside = (table["flight"] == name).to_numpy()
            fitted = pipeline().fit(table[~inside], Y[~inside])
            mean, std = fitted.predict(table[inside], return_std=True, include_noise=True)
            scores = (np.abs(Y[inside] - mean) / std).dropna()
            expected.append(scores.to_numpy())
        found = [model.calibration_scores_[model.calibration_units_ == k] for k in range(4)]
        for one in expected:  # the folds come in an order of their own
            assert any(one.shape == two.shape and np.allclose(one, two, rtol=1e-6) for two in found)
        assert model.unit_ == "flight"
        assert model.n_units_.tolist() == [4, 4]

    def test_prefit_and_frozen_models_are_left_as_they_are(self, flights):
        fitted = pipeline().fit(*flights)
        others = make_flights("efgh", seed=5)
        before = fitted.predict(others[0])
        prefit = CalibratedRegressor(fitted, cv="prefit", level=0.8).fit(*others)
        frozen = CalibratedRegressor(FrozenEstimator(fitted), level=0.8).fit(*others)
        assert prefit.estimator_ is fitted
        np.testing.assert_allclose(prefit.predict(others[0]), before, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(prefit.std_scale_, frozen.std_scale_, rtol=1e-6)
        assert len(prefit.calibration_scores_) == 800

    def test_groups_say_what_is_exchangeable(self, flights):
        table, Y = flights
        days = table["flight"].isin(["a", "b"]).to_numpy()
        with pytest.warns(UserWarning, match="2 flights guarantee no more than 0.667"):
            model = CalibratedRegressor(pipeline(), level=0.8).fit(table, Y, groups=days)
        assert model.n_units_.tolist() == [2, 2]

    @pytest.mark.parametrize("cv", [None, 4, "prefit", BlockSplit(4)])
    def test_one_flight_is_cut_into_blocks(self, cv):
        table, Y = make_flights("a", 400)
        inner = pipeline().fit(table, thin_targets(Y, 60)) if cv == "prefit" else pipeline()
        model = CalibratedRegressor(inner, level=0.75, cv=cv)
        if isinstance(cv, BlockSplit):  # who chooses blocks needs no warning
            model.fit(table, thin_targets(Y, 60))
        else:
            with pytest.warns(
                UserWarning, match=r"Got one flight, so [45] of its blocks replace flights"
            ):
                model.fit(table, thin_targets(Y, 60))
        assert model.unit_ == "block"
        assert (model.n_units_ >= 4).all()
        assert model.guaranteed_.all()


class TestScaling:
    def test_the_normal_band_of_the_deviation_is_the_interval(self, model, flights):
        table, _ = flights
        mean, std = model.predict(table, return_std=True)
        lower, upper = model.predict_interval(table)
        np.testing.assert_allclose(upper - mean, norm.ppf(0.9) * std, rtol=1e-12)
        np.testing.assert_allclose(mean - lower, norm.ppf(0.9) * std, rtol=1e-12)
        own = model.estimator_.predict(table, return_std=True, include_noise=True)[1]
        np.testing.assert_allclose(std, own * model.std_scale_)
        without = model.predict(table, return_std=True, include_noise=False)[1]
        np.testing.assert_allclose(
            without, model.estimator_.predict(table, return_std=True)[1] * model.std_scale_
        )

    def test_offsets_that_no_single_flight_shows_widen_their_output_alone(self, model):
        assert model.std_scale_[0] > 1.5 * model.std_scale_[1]

    def test_an_output_seen_in_fewer_flights_guarantees_less(self, flights):
        table, Y = flights
        Y = Y.copy()
        Y.loc[table["flight"] == "a", "Cm"] = np.nan
        with pytest.warns(
            UserWarning, match=r"3 flights guarantee no more than 0.75: the intervals of \['Cm'\]"
        ):
            model = CalibratedRegressor(pipeline(), level=0.8).fit(table, Y)
        assert model.n_units_.tolist() == [4, 3]
        assert model.guaranteed_.tolist() == [True, False]
        lower, upper = model.predict_interval(table)
        assert np.isfinite(upper - lower).all()


class TestErrors:
    def test_no_deviation_no_calibration(self, flights):
        with pytest.raises(TypeError, match="takes no return_std"):
            CalibratedRegressor(pipeline(LinearRegression()), level=0.5).fit(
                flights[0], make_flights()[1]
            )

    def test_never_observed_where_it_counts(self, flights):
        fitted = pipeline().fit(*flights)
        table, Y = make_flights("efgh")
        with pytest.raises(
            ValueError, match=r"no value of the outputs \['Cm'\] in held-out flights"
        ):
            CalibratedRegressor(fitted, cv="prefit").fit(table, Y.assign(Cm=np.nan))

    def test_says_what_it_expects(self, model, flights):
        for parameters in ({"level": 95}, {"cv": "flights"}, {"cv": 1}):
            with pytest.raises(ValueError, match=f"The {next(iter(parameters))!r} parameter"):
                CalibratedRegressor(pipeline(), **parameters).fit(*flights)
        with pytest.raises(ValueError, match="expected at least 6"):
            CalibratedRegressor(BayesianRidge()).fit(np.zeros((4, 1)), np.zeros(4))
        with pytest.raises(ValueError, match="Got 3 flight identifiers"):
            CalibratedRegressor(BayesianRidge()).fit(
                np.zeros((40, 1)), np.zeros(40), groups=[1, 2, 3]
            )
