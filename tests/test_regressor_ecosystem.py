"""DependentGPRegressor among scikit-learn's pipelines and searches, in other processes, and under Ctrl-C."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time

import joblib
import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import GridSearchCV, GroupKFold, LeaveOneGroupOut, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.metrics import SCORERS


@pytest.fixture(scope="module")
def flights():
    """Three short flights of a table, one coefficient not always observed."""
    rng = np.random.default_rng(0)
    X = pd.DataFrame(rng.normal(size=(60, 3)) * [0.05, 0.3, 10.0] + [0.1, 0, 40], columns=["alpha", "q", "airspeed"])
    lift = -4 * X["alpha"] + 0.1 * np.sin(5 * X["q"])
    Y = pd.DataFrame({"CZ": lift, "Cm": 0.1 - 0.2 * lift + 0.01 * X["q"]}) + rng.normal(0, 0.005, (60, 2))
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

    def test_grid_search_over_held_out_flights(self, flights):
        X, Y, flight = flights
        model = make_pipeline(StandardScaler(), quick(max_iter=3))
        grid = {"dependentgpregressor__n_latent": [0, 1], "dependentgpregressor__trend": ["linear", "constant"]}
        search = GridSearchCV(model, grid, cv=GroupKFold(3), scoring=SCORERS, refit="neg_normalized_rmse")
        search.fit(X, Y, groups=flight)
        assert np.isfinite(search.cv_results_["mean_test_neg_normalized_rmse"]).all()
        assert search.predict(X).shape == (60, 2)

    def test_cross_validation_over_flights_in_processes(self, flights):
        X, Y, flight = flights
        options = {"groups": flight, "cv": LeaveOneGroupOut(), "scoring": SCORERS}
        here, there = (cross_validate(quick(max_iter=3), X, Y, n_jobs=n, **options) for n in (1, 2))
        for name in ("neg_normalized_rmse", "log_predictive_density", "interval_coverage"):
            np.testing.assert_allclose(here[f"test_{name}"], there[f"test_{name}"], rtol=0.05)  # other threads

    def test_fitting_again_forgets(self, flights):
        X, Y, _ = flights
        once = quick().fit(X[:30], Y[:30])
        twice = quick().fit(X, Y["CZ"]).fit(X[:30], Y[:30])
        np.testing.assert_allclose(once.predict(X), twice.predict(X), rtol=1e-6, atol=1e-9)
        assert twice.output_names_ == ["CZ", "Cm"]


class TestFreshProcess:
    """A model that was saved predicts the same where it is loaded."""

    script = """
        import joblib, numpy as np
        X = np.load("X.npy")
        for name in ("exact", "sparse"):
            model = joblib.load(f"{name}.joblib")
            mean, std = model.predict(X, return_std=True)
            slope = model.predict_gradient(X)
            np.savez(f"{name}.npz", mean=mean, std=std, slope=slope, sample=model.sample_y(X[:3], 2, random_state=0))
    """

    def test_predicts_bit_identically(self, flights, tmp_path):
        X, Y, _ = flights
        X = X.to_numpy()
        np.save(tmp_path / "X.npy", X)
        models = {name: quick(inference=name, n_inducing=12).fit(X, Y) for name in ("exact", "sparse")}
        for name, model in models.items():
            joblib.dump(model, tmp_path / f"{name}.joblib")
        subprocess.run([sys.executable, "-c", textwrap.dedent(self.script)], cwd=tmp_path, check=True, timeout=120)
        for name, model in models.items():
            mean, std = model.predict(X, return_std=True)
            with np.load(tmp_path / f"{name}.npz") as found:
                np.testing.assert_allclose(found["mean"], mean, rtol=1e-9, atol=1e-10)
                np.testing.assert_allclose(found["std"], std, rtol=1e-9, atol=1e-10)
                np.testing.assert_allclose(found["slope"], model.predict_gradient(X), rtol=1e-9, atol=1e-10)
                np.testing.assert_allclose(
                    found["sample"], model.sample_y(X[:3], 2, random_state=0), rtol=1e-9, atol=1e-10
                )

    def test_pickle_does_not_grow_by_predicting(self, flights):
        X, Y, _ = flights
        model = quick().fit(X, Y)
        before = len(pickle.dumps(model))
        model.predict(X, return_std=True)
        assert len(pickle.dumps(model)) == before
        assert before < 60_000  # the samples and the hyperparameters


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is sent otherwise there")
def test_a_real_ctrl_c_keeps_the_best_so_far(tmp_path):
    script = """
        import warnings, numpy as np
        from skdgp import DependentGPRegressor
        from skdgp._compute.progress import listening

        rng = np.random.default_rng(0)
        X = rng.normal(size=(150, 6))
        Y = np.column_stack([np.sin(X @ rng.normal(size=6)) + 0.1 * rng.normal(size=150) for _ in range(2)])

        def tell(stage, n, value):
            if stage == "fit" and n == 3:
                print("running", flush=True)

        with warnings.catch_warnings(record=True) as caught, listening(tell):
            warnings.simplefilter("always")
            model = DependentGPRegressor(max_iter=10000, random_state=0).fit(X, Y)
        assert np.isfinite(model.predict(X[:5], return_std=True)).all()
        print([w.category.__name__ for w in caught], flush=True)
    """
    environment = os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    command = [sys.executable, "-c", textwrap.dedent(script)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=tmp_path) as process:
        assert process.stdout.readline() == "running\n"
        pressed = time.monotonic()
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert "ConvergenceWarning" in rest
        assert time.monotonic() - pressed < 30
