"""Further samples (partial_fit) and small models (compact), at the estimator's door."""

import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp._compute import linalg
from skdgp.inference import Data, ExactPosterior

NEW = np.random.default_rng(3).normal(size=(7, 2)) * 1.5


def make_data(n=60, seed=0):
    """Two dependent outputs of two regressors, some of the second not observed."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 2))
    common = np.sin(1.5 * X[:, 0]) + 0.5 * X[:, 1]
    Y = np.column_stack([1e-2 * common + 3.0, -50 * common + 10 * np.cos(X[:, 1])])
    Y += rng.normal(0, [3e-4, 2.0], Y.shape)
    Y[rng.random(n) < 0.3, 1] = np.nan
    return X, Y


@pytest.fixture(scope="module")
def data():
    return make_data()


def fitted_on(X, Y, kind="exact"):
    inference = "exact" if kind == "exact" else "sparse"
    options = {"structure": "joint", "inference": inference, "n_inducing": 25, "max_iter": 15}
    model = DependentGPRegressor(**options, random_state=0).fit(X, Y)
    return model.compact(60) if kind == "compact" else model


KINDS = pytest.mark.parametrize("kind", ["exact", "sparse", "compact"])


@pytest.fixture(scope="module")
def models(data):
    return {
        kind: fitted_on(data[0][:40], data[1][:40], kind) for kind in ("exact", "sparse", "compact")
    }


@pytest.fixture
def model(models, kind):
    """A model of the first forty samples, to be changed."""
    return pickle.loads(pickle.dumps(models[kind]))


class TestPartialFit:
    @KINDS
    def test_is_conditioning_on_everything_at_the_same_hyperparameters(self, data, model, kind):
        X, Y = data
        before, theta = model.posterior_, model.theta_.copy()
        center, scale = model.center_, model.scale_
        for rows in (slice(40, 41), slice(41, 60)):
            assert model.partial_fit(X[rows], Y[rows]) is model
        if kind == "exact":
            reference = ExactPosterior(
                before.kernel, before.noise, Data.from_table(X, (Y - center) / scale)
            )
        else:
            reference = before.updated(Data.from_table(X[40:], (Y[40:] - center) / scale))
        mean, variance = reference.predict(NEW, True)
        got, std = model.predict(NEW, return_std=True)
        np.testing.assert_allclose(got, mean * scale + center, rtol=1e-8)
        np.testing.assert_allclose(std, np.sqrt(variance) * scale, rtol=1e-8)
        assert model.log_marginal_likelihood_value_ == pytest.approx(
            reference.log_marginal_likelihood, rel=1e-8
        )
        np.testing.assert_array_equal(model.theta_, theta)
        assert (model.center_ is center, model.scale_ is scale) == (True, True)

    @KINDS
    def test_rows_without_a_target_change_nothing(self, data, model, kind):
        before = model.predict(NEW)
        model.partial_fit(data[0][40:45], np.full((5, 2), np.nan))
        np.testing.assert_allclose(model.predict(NEW), before, rtol=1e-9, atol=1e-10)

    def test_first_call_is_fit(self, data):
        first, fitted = (DependentGPRegressor(max_iter=5, random_state=0) for _ in range(2))
        first.partial_fit(*data)
        fitted.fit(*data)
        np.testing.assert_allclose(first.predict(NEW), fitted.predict(NEW), rtol=1e-6, atol=1e-9)

    @pytest.mark.parametrize("shape", [(-1,), (-1, 1)])
    def test_one_output(self, data, shape):
        X, y = data[0], data[1][:, 0]
        model = DependentGPRegressor(max_iter=5, random_state=0).fit(X[:30], y[:30].reshape(shape))
        ndim = model.predict(NEW).ndim
        model.partial_fit(X[30:], y[30:])
        model.partial_fit(X[:1], y[:1, None])
        assert model.predict(NEW).ndim == ndim == len(shape)

    def test_tables(self, data):
        X, Y = (
            pd.DataFrame(a, columns=c)
            for a, c in zip(data, (["alpha", "q"], ["CZ", "Cm"]), strict=True)
        )
        model = DependentGPRegressor(max_iter=5, random_state=0).fit(X[:40], Y[:40])
        plain = DependentGPRegressor(max_iter=5, random_state=0).fit(data[0][:40], data[1][:40])
        model.partial_fit(X[40:], Y[40:])
        plain.partial_fit(data[0][40:], data[1][40:])
        np.testing.assert_allclose(model.predict(X), plain.predict(data[0]), rtol=1e-6, atol=1e-9)
        with pytest.raises(ValueError, match="feature names"):
            model.partial_fit(X[["q", "alpha"]], Y)
        with pytest.raises(
            ValueError, match=r"Got y with the columns \['Cm', 'CZ'\].*\['CZ', 'Cm'\]"
        ):
            model.partial_fit(X, Y[["Cm", "CZ"]])
        with pytest.warns(UserWarning, match="indices of X and y differ"):
            model.partial_fit(X[:2], Y[2:4])

    def test_wrong_shapes_and_values(self, data, models):
        X, Y = data
        model = models["exact"]
        before = model.predict(NEW)
        with pytest.raises(ValueError, match=r"Got y with 1 outputs, but expected the 2.*NaN"):
            model.partial_fit(X, Y[:, 0])
        with pytest.raises(ValueError, match=r"3 features.*expecting 2"):
            model.partial_fit(np.ones((2, 3)), Y[:2])
        with pytest.raises(ValueError, match="NaN"):
            model.partial_fit(np.full((2, 2), np.nan), Y[:2])
        with pytest.raises(ValueError, match="inconsistent"):
            model.partial_fit(X[:3], Y[:2])
        with pytest.raises(ValueError, match="infinity"):
            model.partial_fit(X[:2], np.full((2, 2), np.inf))
        np.testing.assert_allclose(model.predict(NEW), before, rtol=1e-9, atol=1e-10)

    def test_memory_is_looked_at_first(self, data, models, monkeypatch):
        monkeypatch.setattr(linalg, "_physical_memory", lambda: 8 * 2 * 80**2)
        with pytest.raises(ValueError, match=r"Exact inference on .*GiB.*Compact the model first"):
            models["exact"].partial_fit(*data)
        pickle.loads(pickle.dumps(models["compact"])).partial_fit(*data)


class TestCompact:
    @pytest.mark.parametrize("kind", ["exact", "sparse"])
    def test_predicts_nearly_the_same(self, models, kind):
        model = models[kind]
        small = model.compact(tolerance=0.02)
        mean, std = model.predict(NEW, return_std=True)
        got, deviation = small.predict(NEW, return_std=True)
        assert np.sqrt(np.mean(((got - mean) / std) ** 2)) < 0.1
        np.testing.assert_allclose(deviation, std, rtol=0.2)
        assert small.compaction_.change <= 0.02

    def test_of_a_sparse_model_no_larger_forgets_its_samples_alone(self, models):
        small = models["sparse"].compact(1000)
        np.testing.assert_allclose(small.predict(NEW), models["sparse"].predict(NEW), rtol=1e-10)
        assert small.compaction_.change == 0.0
        assert small.posterior_.shares is None

    def test_is_another_fitted_model(self, data, models):
        model = models["exact"]
        before = model.predict(NEW)
        small = model.compact(30)
        assert (small.inference_, model.inference_) == ("compact", "exact")
        assert not hasattr(model, "compaction_")
        assert small.get_params() == model.get_params()
        for name in ("n_iter_", "n_evaluations_", "n_features_in_", "output_names_", "kernel_"):
            assert getattr(small, name) is getattr(model, name)
        np.testing.assert_array_equal(small.theta_, model.theta_)
        assert small.log_marginal_likelihood() == pytest.approx(
            small.log_marginal_likelihood_value_
        )
        assert small.log_marginal_likelihood_value_ <= model.log_marginal_likelihood_value_ + 1e-6
        small.partial_fit(*data)
        np.testing.assert_allclose(model.predict(NEW), before, rtol=1e-9, atol=1e-10)
        assert not hasattr(clone(small), "posterior_")
        small.set_params(max_iter=3).fit(*data)
        assert (small.inference_, small.posterior_.__class__) == ("exact", ExactPosterior)
        assert not hasattr(small, "compaction_")

    def test_everything_that_a_model_answers(self, models):
        small = models["compact"]
        mean, cov = small.predict(NEW, return_cov=True)
        _, std = small.predict(NEW, return_std=True)
        np.testing.assert_allclose(np.sqrt(np.diag(cov)).reshape(2, -1).T, std, rtol=1e-6)
        slope, deviation = small.predict_gradient(NEW, return_std=True)
        assert slope.shape == deviation.shape == (7, 2, 2)
        assert small.sample_y(NEW, 3).shape == (7, 2, 3)
        assert small.output_correlation().correlation.shape == (2, 2)
        assert np.isfinite(mean).all()
        with pytest.raises(ValueError, match="holds no samples"):
            small.log_marginal_likelihood(small.theta_)

    def test_a_tolerance_that_cannot_be_kept_is_told(self, models):
        with pytest.warns(
            UserWarning,
            match=r"16 inducing variables changes.*more than the tolerance 0\.001.*Raise "
            r"n_inducing",
        ) as caught:
            models["exact"].compact(10, tolerance=1e-3)
        assert caught[0].filename == __file__

    def test_much_change_is_told_unasked(self, models):
        with pytest.warns(
            UserWarning,
            match=r"16 inducing variables changes.*standard deviation.*Raise n_inducing",
        ):
            models["exact"].compact(10)

    @pytest.mark.parametrize(("n", "trend"), [(2, "linear"), (3, None), (6, "constant")])
    def test_of_few_samples(self, data, n, trend):
        X, y = data[0][:n], data[1][:n, 0]
        model = DependentGPRegressor(optimizer=None, trend=trend, n_latent=1, random_state=0).fit(
            X, y
        )
        small = model.compact()
        np.testing.assert_allclose(small.predict(NEW), model.predict(NEW), rtol=1e-3)
        assert small.partial_fit(X[:1] + 1.0, y[:1]).predict(NEW).shape == (7,)

    @pytest.mark.parametrize(
        ("name", "values", "words"),
        [
            ("n_inducing", [0, -3, 2.5, True, "many", None, np.nan], "from 1 on"),
            ("tolerance", [0, -0.1, np.nan, np.inf, "small", True], "positive fraction"),
            ("max_iter", [-1, 2.5, None, True], "or 0 for none"),
        ],
    )
    def test_numbers_without_sense(self, models, name, values, words):
        for value in values:
            with pytest.raises(ValueError, match=f"Got {name}=.*{words}"):
                models["exact"].compact(**{name: value})

    def test_memory_is_looked_at_first(self, models, monkeypatch):
        monkeypatch.setattr(linalg, "_physical_memory", lambda: 1000)
        with pytest.raises(
            ValueError, match=r"A compact model of 26 values needs.*fewer n_inducing"
        ):
            models["exact"].compact(20)


class TestPlainRows:
    """What passes the door without scikit-learn's full check is what would pass it unchanged."""

    def test_other_forms_give_the_same(self, models):
        small = models["compact"]
        expected = small.predict(NEW)
        for form in (
            NEW.tolist(),
            np.asfortranarray(NEW),
            NEW.astype(">f8"),
            np.repeat(NEW, 2, axis=1)[:, ::2],
        ):
            np.testing.assert_allclose(small.predict(form), expected, rtol=1e-12)
        np.testing.assert_allclose(small.predict(NEW.astype(np.float32)), expected, rtol=1e-4)
        np.testing.assert_allclose(small.predict(pd.DataFrame(NEW)), expected, rtol=1e-12)

    @pytest.mark.parametrize(
        ("X", "says"),
        [
            (np.ones((1, 3)), "3 features.*expecting 2"),
            (np.ones((0, 2)), "0 sample"),
            (np.ones(2), "Expected 2D array"),
            (np.ones((1, 2, 1)), "dim 3"),
            (np.array([[1.0, np.nan]]), "NaN"),
            (np.array([[1.0, -np.inf]]), "infinity"),
            (np.array([[1.0, 1j]]), "Complex"),
            (np.array([["a", "b"]]), "could not convert"),
        ],
    )
    def test_what_is_no_sample_is_refused(self, models, X, says):
        with pytest.raises(ValueError, match=says):
            models["compact"].predict(X)

    def test_callers_array_is_left_alone(self, models):
        X = NEW.copy()
        X.flags.writeable = False
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for model in models.values():
                model.predict(X, return_std=True)
        np.testing.assert_array_equal(X, NEW)
