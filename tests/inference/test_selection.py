"""How many latents outputs share, chosen by the evidence."""

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning

from skdgp import DependentGPRegressor, listening
from skdgp.inference import Data, _rows, choose_kernel, fit_exact, held_out_errors, log_likelihood
from skdgp.kernels import ConvolvedGaussian

OPTIONS = {"optimizer": "fmin_l_bfgs_b", "max_iter": 30, "random_state": 0}
N, P = 60, 3
X = np.sort(np.random.default_rng(0).uniform(0, 24, (N, 1)), axis=0)


def drawn(shared, noise=0.1):
    """Return processes of unit variance, (N, P), and their measurements; ``shared`` of it they have in common."""
    rng = np.random.default_rng(4)
    w = np.concatenate([np.sqrt(shared) * np.array([[1.0, -1.0, 1.0]]), np.sqrt(1 - shared) * np.eye(P)])
    kernel = ConvolvedGaussian(1, amplitude=w, length_scale=np.ones((P + 1, P, 1)))
    L = np.linalg.cholesky(kernel(X) + 1e-9 * np.eye(N * P))
    truth = (L @ rng.normal(size=N * P)).reshape(P, N).T
    return truth, truth + noise * rng.normal(size=truth.shape)


def fitted(Y, **parameters):
    return DependentGPRegressor(**({"n_latent": "auto", "max_iter": 25, "random_state": 0} | parameters)).fit(X, Y)


def test_the_criterion_is_the_likelihood_less_half_log_n_for_each_hyperparameter():
    _, Y = drawn(0.8)
    Y[::7, 1] = np.nan
    kernels = [ConvolvedGaussian(k) for k in (0, 1)]
    choice = choose_kernel(kernels, X, Y, **OPTIONS)
    assert choice.index == np.argmax(choice.scores)
    for kernel, score in zip(kernels, choice.scores, strict=True):
        posterior = fit_exact(kernel, X, Y, **OPTIONS).posterior
        value = log_likelihood(posterior.kernel, posterior.noise, Data.from_table(X, Y))
        q, n_values = len(posterior.kernel.theta) + P, np.isfinite(Y).sum()
        assert score == pytest.approx(value - q / 2 * np.log(n_values))


def test_of_many_values_some_are_used(monkeypatch):
    _, Y = drawn(0.0)
    monkeypatch.setattr(_rows, "SEARCH_VALUES", 60)
    rows = _rows.some_rows(Y, np.random.RandomState(0))
    assert 20 <= len(rows) < 30
    found = choose_kernel([ConvolvedGaussian(0)], X, Y, **OPTIONS)
    assert found.scores == pytest.approx(choose_kernel([ConvolvedGaussian(0)], X[rows], Y[rows], **OPTIONS).scores)


def test_independent_outputs_share_nothing():
    _, Y = drawn(0.0)
    model, alone = fitted(Y), fitted(Y, n_latent=0)
    assert model.n_latent_ == 0
    assert list(model.n_latent_scores_) == [0, 1]  # the second lost, so no third was tried
    np.testing.assert_allclose(model.predict(X), alone.predict(X), rtol=1e-6, atol=1e-9)


def test_a_shared_latent_is_found_and_pays_where_an_output_is_missing():
    truth, Y = drawn(0.9)
    Y[np.arange(N) % 5 > 0, 0] = np.nan
    model, alone = fitted(Y), fitted(Y, n_latent=0)
    assert model.n_latent_ >= 1
    assert model.n_latent_scores_[model.n_latent_] == max(model.n_latent_scores_.values())
    error, error_alone = (np.sqrt(np.mean((each.predict(X) - truth)[:, 0] ** 2)) for each in (model, alone))
    assert error < 0.8 * error_alone


def test_one_output_shares_with_nobody():
    model = fitted(drawn(0.9)[1][:, 0], max_iter=3)
    assert (model.n_latent_, list(model.n_latent_scores_)) == (0, [0])


def test_without_private_latents_at_least_one_is_shared():
    assert fitted(drawn(0.0)[1], private_latents=False, max_iter=2).n_latent_ >= 1


def test_a_number_or_a_kernel_leaves_nothing_to_choose():
    _, Y = drawn(0.9)
    given, own = fitted(Y, n_latent=1, max_iter=2), fitted(Y, kernel=ConvolvedGaussian(1), max_iter=2)
    assert (given.n_latent_, given.n_latent_scores_) == (1, {})
    assert (own.n_latent_, own.n_latent_scores_) == (None, {})


def test_regressors_may_be_noisy_and_inference_sparse():
    model = fitted(drawn(0.9)[1], input_noise="learned", inference="sparse", n_inducing=10, max_iter=3)
    assert np.isfinite(list(model.n_latent_scores_.values())).all()


class TestInterrupt:
    """Ctrl-C while candidates are tried: the best so far, as from any other fit."""

    @staticmethod
    def interrupted(at, Y, **parameters):
        """Return a model whose search was interrupted after so many evaluations, and the values told until then."""
        told = []

        def interrupt(stage, n_evaluations, log_likelihood):
            told.append((stage, n_evaluations, log_likelihood))
            if len(told) == at:
                raise KeyboardInterrupt

        with listening(interrupt), pytest.warns(ConvergenceWarning, match="interrupted"):
            return fitted(Y, **parameters), told

    def test_before_anything_is_known(self):
        model, _ = self.interrupted(1, drawn(0.9)[1])
        assert (model.n_latent_, model.n_latent_scores_) == (0, {})
        assert np.isfinite(model.predict(X, return_std=True)).all()

    def test_within_the_first_candidate(self):
        _, Y = drawn(0.9)
        model, told = self.interrupted(self.evaluations(Y), Y)
        assert told[-1][0] == "fit"
        assert model.log_marginal_likelihood_value_ == pytest.approx(told[-1][-1])  # the last point it heard of
        assert (model.n_latent_, model.n_latent_scores_) == (0, {})

    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_later_the_best_that_was_done_is_kept(self, inference):
        _, Y = drawn(0.9)
        model, _ = self.interrupted(self.evaluations(Y) + 5, Y, inference=inference, n_inducing=N)
        assert (model.n_latent_, model.inference_) == (0, inference)
        assert list(model.n_latent_scores_) == [0]
        np.testing.assert_allclose(model.predict(X), fitted(Y, n_latent=0).predict(X), atol=0.2)

    @staticmethod
    def evaluations(Y):
        """Return how many the first candidate takes."""
        told = []
        with listening(lambda *news: told.append(news)):
            fitted(Y, n_latent=0)
        return len(told)


class TestStructure:
    """A process beside the trend must earn its place in blocks of rows that were held out."""

    @staticmethod
    def record(curve, n=120, seed=0):
        """A regressor that wanders, and an output whose errors last as long as its excursions do."""
        rng = np.random.default_rng(seed)
        x = np.convolve(rng.normal(size=n + 10), np.ones(10) / 3, "valid")[:n]
        drift = np.convolve(rng.normal(size=n + 10), np.ones(10) / 3, "valid")[:n]
        return x[:, None], x + curve * x**2 + 0.4 * drift

    def test_the_trend_alone_where_the_rest_is_drift(self):
        x, y = self.record(curve=0.0)
        model = DependentGPRegressor(structure="auto", n_latent=0, max_iter=20, random_state=0).fit(x, y)
        errors = {name: values.mean() for name, values in model.structure_errors_.items()}
        assert errors["trend"] < errors["joint"]
        assert model.structure_ == "trend"
        alone = DependentGPRegressor(structure="trend", max_iter=20, random_state=0).fit(x, y)
        np.testing.assert_allclose(model.predict(x), alone.predict(x), rtol=1e-10)
        slope, std = model.predict_gradient(x[:1], return_std=True)
        assert abs(slope[0, 0] - 1) < 4 * std[0, 0] + 0.2

    def test_the_process_where_there_is_a_curve(self):
        x, y = self.record(curve=1.0)
        model = DependentGPRegressor(structure="auto", n_latent=0, max_iter=20, random_state=0).fit(x, y)
        assert model.structure_ == "joint"
        assert model.structure_errors_["joint"].mean() < 0.7 * model.structure_errors_["trend"].mean()

    @pytest.mark.parametrize(("missing", "n_latent"), [(0, 0), (40, 2)])
    def test_shares_latents_where_an_output_lacks_values(self, missing, n_latent):
        x, y = self.record(curve=1.0, n=60)
        Y = np.column_stack([y, -y])
        Y[:missing, 1] = np.nan
        model = DependentGPRegressor(structure="auto", max_iter=2, random_state=0).fit(x, Y)
        assert (model.structure_, model.n_latent_) == ("joint", n_latent)

    def test_few_rows_are_not_cut_into_blocks(self):
        x, y = self.record(curve=0.0, n=30)
        model = DependentGPRegressor(structure="auto", n_latent=0, max_iter=5, random_state=0).fit(x, y)
        assert (model.structure_, model.structure_errors_) == ("joint", {})

    @pytest.mark.parametrize(("compared", "structure"), [(0, "joint"), (1, "joint"), (2, "trend")])
    def test_ctrl_c_keeps_the_best_so_far(self, compared, structure, monkeypatch):
        """In the search of either structure, in the comparison, and in the last search of the trend that won it."""
        x, y = self.record(curve=0.0)
        known = []

        def watched(*args):
            known.append(held_out_errors(*args))
            if len(known) == 1 == compared:
                raise KeyboardInterrupt
            return known[-1]

        def interrupt(stage, n_evaluations, log_likelihood):
            if len(known) == compared and (stage == "fit" or compared == 2):
                raise KeyboardInterrupt

        monkeypatch.setattr("skdgp._regressor._structure.held_out_errors", watched)
        model = DependentGPRegressor(structure="auto", n_latent=0, max_iter=20, random_state=0)
        with listening(interrupt), pytest.warns(ConvergenceWarning, match="interrupted"):
            model.fit(x, y)
        assert (model.structure_, len(model.structure_errors_)) == (structure, 2 * (structure == "trend"))
        assert np.isfinite(model.predict(x)).all()

    @pytest.mark.parametrize("options", [{"kernel": ConvolvedGaussian(1)}, {"trend": "constant"}, {"trend": None}])
    def test_a_trend_alone_needs_a_trend(self, options):
        x, y = self.record(curve=0.0, n=30)
        with pytest.raises(ValueError, match="structure='trend'"):
            DependentGPRegressor(structure="trend", **options).fit(x, y)
