"""What users do wrong: each gets what was got, what was expected, what to do, and changes no model.

Beyond what scikit-learn's check_estimator states: NaN, infinity, other numbers of features, no fit.
"""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.gaussian_process.kernels import RBF
from sklearn.utils._param_validation import InvalidParameterError

from skdgp import DependentGPRegressor, FewRowsWarning
from skdgp.kernels import ConvolvedGaussian


@pytest.fixture
def X():
    return default_rng(0).normal(size=(30, 2))


@pytest.fixture
def Y(X):
    noise = default_rng(1).normal(0, 0.1, (30, 2))
    return np.column_stack([np.sin(X[:, 0]), X[:, 1] - np.sin(X[:, 0])]) + noise


TIED = ConvolvedGaussian(1, covariance_type="tied")


def quick(**more):
    one = {} if "kernel" in more else {"n_latent": 1}
    short = {"structure": "joint", "max_iter": 3, "random_state": 0}
    return DependentGPRegressor(**one | short | more)


@pytest.fixture
def tables(X, Y):
    return pd.DataFrame(X, columns=["alpha", "q"]), pd.DataFrame(Y, columns=["CZ", "Cm"])


def observed(Y, column, n):
    Y = Y.copy()
    Y[n:, column] = np.nan
    return Y


def many(X, Y):
    """Return more values than any memory has room for."""
    return np.arange(800_000.0).reshape(-1, 2), np.arange(400_000.0)


REFUSED_FITS = [  # parameters, X and Y of others, what is said
    ({}, lambda X, Y: (X, Y[:-1]), r"inconsistent numbers of samples: \[30, 29\]"),
    ({}, lambda X, Y: (X * [1e150, 1.0], Y), r"'x0': '.*e\+1\d\d'.*StandardScaler"),
    ({}, lambda X, Y: (X * [1.0, 1e-150], Y), r"'x1'.*StandardScaler"),
    *(({}, lambda X, Y, size=size: (X, Y * [1.0, size]), r"targets of magnitudes \{'y1': .*StandardScaler")
      for size in (1e300, 1e-300)),
    *(({}, lambda X, Y, n=n: (X, observed(Y, 1, n)), rf"fewer than two samples.*'y1': {n}.*Leave these columns out")
      for n in (0, 1)),
    ({}, lambda X, Y: (X, observed(Y, slice(None), 1)), "fewer than two samples"),
    ({"inference": "exact"}, many,
     r"Exact inference on 400000 values needs about 2384 GiB.*sparse.*thin_targets"),
    ({"inference": "sparse", "n_inducing": 200_000}, many,
     r"Sparse inference with \d+ values needs.*Lower n_inducing"),
    *(({"kernel": ConvolvedGaussian(1, **words), "trend": "constant"}, lambda X, Y: (X, Y), said)
      for words, said in (
        ({"parameter_bounds": {"length_scale": "free"}}, "bounds 'free' of length_scale.*'fixed'"),
        ({"parameter_bounds": {"length_scale": (2.0, 1.0)}}, "of length_scale.*lower <= upper"),
        ({"parameter_bounds": {"length_scale": (-1.0, 1.0)}}, "of length_scale.*0 < lower"),
        ({"length_scale": 3.0, "parameter_bounds": {"length_scale": (1.0, 2.0)}},
         r"length_scale=3 with the bounds \(1, 2\).*inside its bounds"),
        )),
    ({"kernel": RBF(5.0, (0.1, 1.0)), "trend": "constant"}, lambda X, Y: (X, Y),
     r"kernel__length_scale=5 with the bounds \(0.1, 1\).*inside its bounds"),
    ({"noise_variance": 5.0, "noise_variance_bounds": (0.01, 0.1)}, lambda X, Y: (X, Y),
     r"noise_variance=5 with the bounds \(0.01, 0.1\).*inside its bounds"),
]  # fmt: skip
REFUSED_QUESTIONS = [
    (quick(), lambda model, X: model.predict_gradient(np.zeros((4, 3))),
     "X has 3 features, but DependentGPRegressor is expecting 2"),
    (quick(), lambda model, X: model.predict(X * [1e150, 1.0]), r"'x0'.*StandardScaler"),
    (quick(), lambda model, X: model.predict(X, return_std=True, return_cov=True), r"return_cov=True.*at most one"),
    (quick(), lambda model, X: model.predict(np.zeros((200_000, 2)), return_cov=True),
     r"joint covariance of 400000 values.*fewer samples"),
]  # fmt: skip


@pytest.mark.parametrize(("parameters", "change", "match"), REFUSED_FITS)
def test_what_cannot_be_learned(X, Y, parameters, change, match):
    with pytest.raises(ValueError, match=match):
        quick(**parameters).fit(*change(X, Y))


@pytest.mark.parametrize(("model", "ask", "match"), REFUSED_QUESTIONS)
def test_what_cannot_be_asked(X, Y, model, ask, match):
    fitted = clone(model).fit(X, Y)
    with pytest.raises(ValueError, match=match):
        ask(fitted, X)


class TestRefusedFit:
    @pytest.mark.parametrize(
        ("options", "change"),
        [
            ({"structure": "trend", "trend": "constant"}, lambda X, Y: (X, 1000 * Y + 7)),
            (
                {"kernel": ConvolvedGaussian(1, shift=[1.0, 2.0, 3.0])},
                lambda X, Y: (X[:, :1], Y[:, 0]),
            ),
            ({}, lambda X, Y: (X[:, :1], Y[:3])),
        ],
    )
    def test_changes_nothing(self, X, Y, options, change):
        model = quick(n_latent=None).fit(X, Y)
        before = dict(vars(model))
        expected = model.predict(X, return_std=True)
        parameters = model.get_params()
        model.set_params(**options)
        with pytest.raises((ValueError, TypeError)):
            model.fit(*change(X, Y))
        model.set_params(**parameters)
        assert vars(model).keys() == before.keys()
        assert_array_equal(model.predict(X, return_std=True), expected)


class TestRegressors:
    def test_by_other_names_or_in_another_order(self, tables):
        X, Y = tables
        ask = quick().fit(X, Y).predict_gradient
        with pytest.raises(ValueError, match="same order"):
            ask(X[["q", "alpha"]])
        with pytest.raises(ValueError, match=r"(?s)unseen at fit time.*beta"):
            ask(X.rename(columns={"alpha": "beta"}))
        with pytest.warns(UserWarning, match="does not have valid feature names"):
            ask(X.to_numpy())

    @pytest.mark.parametrize("constant", [0.1 + 0.2, 0.0])
    def test_a_constant_one_is_named(self, tables, constant):
        """The standard deviation of equal numbers is not zero but rounding: np.std([.6] * 20) is 1e-16."""
        X, Y = tables
        more = X.assign(throttle=constant)
        more.loc[3, "throttle"] *= 1 + 1e-15
        with pytest.warns(UserWarning, match=r"\['throttle'\] are constant"):
            quick(kernel=TIED).fit(more, Y)


class TestTargets:
    def test_of_integers_and_nullable_numbers(self, X, Y):
        whole = (10 * Y).round()
        nullable = pd.DataFrame(whole).astype("Float64")
        expected = quick().fit(X, whole).predict(X)
        for targets in (whole.astype(int), nullable):
            assert_allclose(quick().fit(X, targets).predict(X), expected, rtol=1e-6, atol=1e-9)
        nullable.iloc[0, 0] = pd.NA
        assert np.isfinite(quick().fit(X, nullable).predict(X)).all()


class TestRows:
    def test_repeated(self, tables):
        X, Y = tables
        twice = pd.concat([X, X], ignore_index=True), pd.concat([Y, Y], ignore_index=True)
        with pytest.warns(UserWarning, match=r"30 of 60 samples repeat.*drop repeated rows"):
            quick().fit(*twice)


class TestParameters:
    @pytest.mark.parametrize(
        ("parameters", "message"),
        [
            ({"kernel": ConvolvedGaussian}, "kernel.*Kernel.*Got <class"),
            ({"n_latent": 1.5}, "n_latent"),
            ({"optimizer": "adam"}, "optimizer.*fmin_l_bfgs_b"),
            ({"structure": "auto"}, "structure.*'average'"),
        ],
        ids=lambda p: ", ".join(p) if isinstance(p, dict) else "",
    )
    def test_out_of_range(self, X, Y, parameters, message):
        with pytest.raises(InvalidParameterError, match=f"(?s){message}"):
            quick(**parameters).fit(X, Y)


class TestInference:
    def test_too_few_inducing_inputs_are_said_to_cost_accuracy(self):
        """A fast sine is not told by four inducing inputs; by forty it is, and nothing is said."""
        rng = default_rng(0)
        x = rng.uniform(size=(120, 1))
        y = np.sin(20 * x[:, 0]) + rng.normal(0, 0.05, 120)
        options = {"structure": "joint", "max_iter": 100, "inference": "sparse"}
        with pytest.warns(UserWarning, match="4 inducing inputs leave .* Raise n_inducing"):
            quick(n_inducing=4, **options).fit(x, y)
        quick(n_inducing=40, **options).fit(x, y)

    def test_auto_chooses_by_the_number_of_values(self, X, Y):
        model = quick(n_inducing=20)
        model.settings = replace(
            model.settings, exact_values=59, most_neglected=np.inf, least_neglected=np.inf
        )
        assert model.fit(X, Y).inference_ == "sparse"
        Y[0] = np.nan
        assert model.fit(X, Y).inference_ == "exact"


class TestFewRows:
    """A linear truth with 10 % noise; where too few rows tell it, bands are too narrow."""

    @staticmethod
    def linear(n, d, memory=1):
        rng = default_rng(n + d)
        X = rng.normal(size=(n, d))
        noise = rng.normal(size=(n + memory - 1, 2))
        lasting = sliding_window_view(noise, memory, axis=0).sum(axis=-1) / np.sqrt(memory)
        return X, X @ rng.normal(size=(d, 2)) / np.sqrt(d) + 0.1 * lasting

    @pytest.mark.parametrize(
        ("data", "structure", "told"),
        [
            (
                (30, 8),
                "average",
                r"Got 30 rows for 8 regressors, 3.8 for each, but expected at least 10 for each",
            ),
            (
                (400, 8, 20),
                "trend",
                r"400 rows, worth \d\d independent .* last (1|2)\d rows, for 8",
            ),
        ],
    )
    def test_are_said(self, data, structure, told):
        """So are those that lasting errors leave."""
        with pytest.warns(FewRowsWarning, match=told):
            quick(structure=structure).fit(*self.linear(*data))

    @pytest.mark.parametrize(
        ("data", "structure"), [((30, 8), "trend"), ((120, 8), "joint"), ((40, 1), "average")]
    )
    def test_are_enough(self, data, structure):
        """For the trend alone, whose bands hold with few rows, or if there are more than ten for each regressor."""
        self.fit_in_silence(quick(structure=structure), *self.linear(*data))

    def fit_in_silence(self, model, X, Y):
        with warnings.catch_warnings():
            warnings.simplefilter("error", FewRowsWarning)
            model.fit(X, Y)
