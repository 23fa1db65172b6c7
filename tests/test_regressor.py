"""DependentGPRegressor: what it says about the data it was given."""

import warnings
from collections import Counter

import numpy as np
import pytest
from made_outputs import in_units
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import r2_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

from skdgp import DependentGPRegressor, listening
from skdgp.kernels import ConvolvedGaussian

TIED = ConvolvedGaussian(1, covariance_type="tied")


@pytest.fixture(scope="module")
def data():
    return in_units()


@pytest.fixture(scope="module")
def new():
    return in_units(6, seed=9)[0]


TREND = DependentGPRegressor(max_iter=2, structure="trend")
OTHERS = [
    DependentGPRegressor(max_iter=2),
    DependentGPRegressor(max_iter=2, inference="sparse", n_inducing=5, n_latent=1),
    DependentGPRegressor(TIED, max_iter=2, trend="constant"),
    DependentGPRegressor(optimizer=None, n_latent=0, structure="joint", trend=None),
    DependentGPRegressor(max_iter=1, n_latent=0, input_noise="learned"),
]
SLOW_OTHERS = [pytest.param(estimator, marks=pytest.mark.slow) for estimator in OTHERS]


class TestScikitLearnContract:
    @pytest.mark.parametrize("estimator", [TREND, *SLOW_OTHERS], ids=repr)
    @pytest.mark.filterwarnings("ignore")
    @pytest.mark.usefixtures("short_fits")
    def test_check_estimator(self, estimator):
        results = check_estimator(estimator, on_skip=None, on_fail=None)
        failed = [
            (r["check_name"], r["exception"]) for r in results if r["status"] in ("failed", "xfail")
        ]
        assert failed == []
        skipped = {r["check_name"] for r in results if r["status"] == "skipped"}
        assert skipped <= {"check_array_api_input"}
        passed = Counter(r["status"] for r in results)["passed"]
        assert passed >= 50  # none vanished: scikit-learn 1.6 has as many

    @pytest.mark.parametrize(
        "options",
        [
            {"trend": "constant", "structure": "joint"},
            {"structure": "joint", "input_noise": "learned"},
            {"inference": "sparse", "n_inducing": 40},
            {"optimizer": None},
        ],
    )
    def test_iterations_are_counted_within_their_limit(self, data, options):
        model = DependentGPRegressor(max_iter=3, n_latent=1, random_state=0, **options)
        with warnings.catch_warnings(action="ignore"):
            # of so few iterations, and what they leave unexplained
            model.fit(*data)
        assert 1 <= model.n_iter_ <= 3 + 3  # with exact regressors, then noisy ones


class TestShapesAndNames:
    @pytest.mark.parametrize("shape", [(40,), (40, 1), (40, 2)])
    def test_predictions_are_shaped_like_the_targets(self, data, new, shape):
        X, Y = data
        rest = shape[1:]
        P = int(np.prod(rest))
        model = DependentGPRegressor(max_iter=2, random_state=0).fit(X, Y[:, :P].reshape(shape))
        mean, std = model.predict(new, return_std=True)
        assert mean.shape == std.shape == (6, *rest)
        assert model.predict(new, return_cov=True)[1].shape == (6 * P, 6 * P)
        assert model.predict_gradient(new).shape == (6, *rest, 2)
        assert model.sample_y(new, 5).shape == (6, *rest, 5)
        paths = model.sample_paths(4)
        assert paths(new).shape == (4, 6, *rest)
        assert paths.gradient(new).shape == (4, 6, *rest, 2)

    def test_rows_where_nothing_was_observed_are_as_if_absent(self, data, new):
        X, Y = data
        model = DependentGPRegressor(structure="joint", n_latent=1, max_iter=5, random_state=0)
        expected = model.fit(X, Y).predict(new)
        more = np.vstack([X, X[:9] + 5.0])
        unobserved = np.full((9, 2), np.nan)
        model.fit(more, np.vstack([Y, unobserved]))
        assert_allclose(model.predict(new), expected, rtol=1e-6, atol=1e-9)

    def test_score_leaves_targets_out_that_were_not_observed(self, data):
        X, Y = data
        short = {"structure": "joint", "n_latent": 1, "max_iter": 8, "random_state": 0}
        model = make_pipeline(StandardScaler(), DependentGPRegressor(**short)).fit(X, Y)
        mean = model.predict(X)
        weights = 1.0 + (np.arange(len(X)) < 5)
        scores = []
        for k, seen in enumerate(np.isfinite(Y).T):
            scores.append(r2_score(Y[seen, k], mean[seen, k], sample_weight=weights[seen]))
        assert model.score(X, Y, sample_weight=weights) == pytest.approx(np.mean(scores))


def ctrl_c(at_stage, n):
    """Return a listener that interrupts the n-th evaluation of a stage."""

    def press(stage, n_evaluations, log_likelihood):
        if stage == at_stage and n_evaluations == n:
            raise KeyboardInterrupt

    return press


class TestInterrupted:
    @pytest.mark.parametrize(
        ("inference", "at"),
        [
            ("exact", ("output 1", 1)),
            ("exact", ("members", 1)),
            ("sparse", ("fit", 3)),
        ],
    )
    def test_ctrl_c_leaves_fit_and_the_estimator_as_it_was(self, data, new, inference, at):
        options = {"n_inducing": 20, "n_latent": 1, "random_state": 0, "max_iter": 3}
        model = DependentGPRegressor(inference=inference, **options)
        with pytest.raises(KeyboardInterrupt), listening(ctrl_c(*at)):
            model.fit(*data)
        assert not [name for name in vars(model) if name.endswith("_")]
        model.fit(data[0], data[1][:, 0])
        expected = model.predict(new)
        with pytest.raises(KeyboardInterrupt), listening(ctrl_c(*at)):
            model.fit(*data)
        assert_array_equal(model.predict(new), expected)


@pytest.mark.filterwarnings("default")
def test_a_fit_stopped_far_from_an_optimum_says_so():
    X = np.linspace(0, 6, 60)[:, None]
    y = np.sin(3 * X[:, 0])
    with pytest.warns(
        ConvergenceWarning,
        match=r"stopped at max_iter=1 before it converged. Raise max_iter\.$",
    ):
        model = DependentGPRegressor(max_iter=1, random_state=0).fit(X, y)
    assert not model.converged_
    assert DependentGPRegressor(random_state=0, max_iter=2000).fit(X, y).converged_
