"""Scikit-learn's callbacks on a fit alone, in a pipeline, in a search: they get the likelihood, and may stop it."""

import io
from contextlib import redirect_stdout

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.preprocessing import RateNondimensionalizer

callback = pytest.importorskip(
    "sklearn.callback", reason="scikit-learn knows callbacks from version 1.9 on"
)

RNG = np.random.default_rng(0)
X = RNG.uniform(-2, 2, (40, 2))
Y = np.column_stack([np.sin(X[:, 0]) * X[:, 1], np.cos(X[:, 0])]) + 0.1 * RNG.normal(size=(40, 2))


class Recorder:
    """Keeps its calls, and returns True at one evaluation."""

    def __init__(self, stop_at=None, max_propagation_depth=None):
        self.stop_at, self.max_propagation_depth = stop_at, max_propagation_depth
        self.calls, self.news = [], []

    def setup(self, estimator, context):
        self.calls.append("setup")

    def teardown(self, estimator, context):
        self.calls.append("teardown")

    def on_fit_task_begin(self, estimator, context):
        self.calls.append(("begin", context.estimator_name, context.task_name))

    def on_fit_task_end(
        self, estimator, context, *, X=None, y=None, metadata=None, fitted_estimator=None
    ):
        self.calls.append(("end", context.estimator_name, context.task_name))
        if fitted_estimator is not None and context.parent is None:
            self.score = fitted_estimator.score(X, y)
        if metadata is None or "log_likelihood" not in metadata:
            return False
        self.news.append(metadata)
        return metadata["n_evaluations"] == self.stop_at


def quick(**parameters):
    return DependentGPRegressor(**({"n_latent": 1, "max_iter": 4, "random_state": 0} | parameters))


def check_news(news):
    """One fit: evaluations counted one by one, values finite and within a stage never lower than before."""
    assert [each["n_evaluations"] for each in news] == list(range(1, len(news) + 1))
    values = np.array([each["log_likelihood"] for each in news])
    assert np.isfinite(values).all()
    together = [each["log_likelihood"] for each in news if each["stage"] == "fit"]
    assert together[-1] == max(together)


def test_a_fit_alone():
    recorder, plain = Recorder(), quick().fit(X, Y)
    model = quick().set_callbacks(recorder).fit(X, Y)
    check_news(recorder.news)
    assert len(recorder.news) == model.n_evaluations_
    together = [each["log_likelihood"] for each in recorder.news if each["stage"] == "fit"]
    assert together[-1] == pytest.approx(model.log_marginal_likelihood_value_)
    assert recorder.calls[0] == "setup"
    assert recorder.calls[-1] == "teardown"
    begun, ended = (
        [call[1:] for call in recorder.calls[1:-1] if call[0] == word] for word in ("begin", "end")
    )
    assert sorted(begun) == sorted(ended)
    assert begun[0] == ended[-1] == ("DependentGPRegressor", "fit")
    assert recorder.score == pytest.approx(model.score(X, Y))
    np.testing.assert_allclose(model.predict(X), plain.predict(X), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("inference", "more"), [("exact", {"members"}), ("sparse", set())])
def test_stages(inference, more):
    """Members of a sparse average learn their noise without a search."""
    recorder = Recorder()
    quick(inference=inference, n_inducing=10).set_callbacks(recorder).fit(X, Y)
    check_news(recorder.news)
    assert {each["stage"] for each in recorder.news} == {"outputs", "fit"} | more


def test_transformers_of_flight_tables_carry_callbacks_without_a_word():
    recorder, table = (
        Recorder(),
        pd.DataFrame({"airspeed": 20 + X[:, 0], "p": X[:, 1], "alpha": 0.1 * X[:, 0]}),
    )
    pipeline = make_pipeline(RateNondimensionalizer(span=2.0, chord=0.5), quick())
    pipeline.set_callbacks(recorder).fit(table, Y)
    assert ("end", "RateNondimensionalizer", "fit") in recorder.calls
    check_news(recorder.news)


def test_in_a_search():
    recorder = Recorder()
    search = GridSearchCV(
        make_pipeline(StandardScaler(), quick()), {"dependentgpregressor__n_latent": [0, 1]}, cv=2
    )
    search.set_callbacks(recorder).fit(X, Y)
    starts = [k for k, each in enumerate(recorder.news) if each["n_evaluations"] == 1]
    assert len(starts) == 5  # two numbers of latents on two folds, and the best on all
    for first, last in zip(starts, [*starts[1:], None], strict=True):
        check_news(recorder.news[first:last])


def test_clones_keep_callbacks_and_parameters_know_nothing_of_them():
    recorder = Recorder()
    model = quick().set_callbacks(recorder)
    assert model.get_params() == quick().get_params()
    clone(model).fit(X, Y)
    check_news(recorder.news)
    model.set_callbacks()
    before = len(recorder.news)
    model.fit(X, Y)
    assert len(recorder.news) == before


@pytest.mark.usefixtures("one_thread")
def test_a_callback_may_stop_the_search():
    recorder = Recorder(stop_at=10)
    model = quick(max_iter=1000).set_callbacks(recorder)
    with pytest.warns(ConvergenceWarning, match="interrupted"):
        model.fit(X, Y)
    assert len(recorder.news) == 10
    assert np.isfinite(model.predict(X, return_std=True)).all()


@pytest.mark.parametrize("where", ["alone", "search"])
def test_the_progress_bar_shows_the_log_likelihood(where, monkeypatch):
    pytest.importorskip("rich", reason="the progress bar needs rich")
    monkeypatch.setenv("COLUMNS", "160")
    model = quick()
    if where != "alone":
        model = make_pipeline(StandardScaler(), model)
    if where == "search":
        model = GridSearchCV(model, {"standardscaler__with_mean": [True]}, cv=2)
    shown = io.StringIO()
    with redirect_stdout(shown):
        model.set_callbacks(callback.ProgressBar(max_propagation_depth=None)).fit(X, Y)
    fits = {"alone": 1, "pipeline": 1, "search": 3}[where]
    bars = [line for line in shown.getvalue().splitlines() if "log likelihood" in line]
    assert len(bars) >= fits
    assert all("100%" in line for line in bars)


def test_the_scoring_monitor_scores_the_fitted_model():
    monitor = callback.ScoringMonitor(scoring="r2")
    model = quick().set_callbacks(monitor).fit(X, Y)
    assert [row["r2"] for row in monitor.get_logs().data] == [pytest.approx(model.score(X, Y))]
