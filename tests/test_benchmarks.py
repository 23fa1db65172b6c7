"""Every benchmark starts, and three run: at tiny sizes, without the packages they compare with."""

import importlib
import json
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("[!_]*.py") if path.stem not in ("jura", "page"))
SMOKED = ("likelihood", "seeds", "published")  # an evaluation, a pipeline, gaps


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark as it is when run: with its own folder first."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setenv(
        "OMP_NUM_THREADS", "1"
    )  # of processes that a benchmark starts, as of this one
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if (FOLDER / f"{name}.py").is_file():
            del sys.modules[name]


@pytest.mark.filterwarnings("ignore:Compacting to")
@pytest.mark.usefixtures("hasty_fits")
@pytest.mark.parametrize("name", SMOKED)
def test_writes_its_tables_and_says_on_which_machine(script, name, tmp_path, capsys):
    script(name).main(["--smoke", "--no-peers", "--repeats", "1", "--out", str(tmp_path)])
    results = json.loads((tmp_path / f"{name}.json").read_text())
    assert results.pop("machine")["cores"] >= 1
    printed = capsys.readouterr().out
    assert any(results.values())
    assert all(title.replace("_", " ") in printed for title in results)


def test_every_script_can_be_asked_for_its_options(script, capsys):
    for name in SCRIPTS:
        with pytest.raises(SystemExit, match="0"):
            script(name).main(["--help"])
    assert capsys.readouterr().out.count("--out") >= len(SCRIPTS)


class TestLikelihoodOfOthers:
    """The peers evaluate what ours evaluates: where filters are tied, ours is the LCM."""

    def test_value_is_gpytorchs(self, script):
        pytest.importorskip("gpytorch", reason="compares with GPyTorch, which is not installed")
        gpytorch, np = script("_gpytorch"), importlib.import_module("numpy")
        likelihood = script("likelihood")
        case = likelihood.Case(20, 3, 2, 4)
        X, Y = case.table()
        model, noise = gpytorch.exact_lcm(X, Y, case.M, length_scale=2.0, noise=0.3)
        factors = [
            kernel.task_covar_module.covar_factor for kernel in model.covar_module.covar_module_list
        ]
        extra = [kernel.task_covar_module.var for kernel in model.covar_module.covar_module_list]
        w = np.concatenate(
            [f.detach().numpy().T for f in factors]
            + [np.diag(np.sqrt(v.detach().numpy())) for v in extra]
        )
        kernel = likelihood.ConvolvedGaussian(
            feeds=w != 0,
            covariance_type="tied",
            amplitude=w,
            length_scale=np.full((len(w), 3, 4), 2.0),
        )
        data = likelihood.Data.from_table(X, Y)
        with gpytorch.cholesky():
            theirs = gpytorch.likelihood_and_gradient(model, noise)()
        assert likelihood.log_likelihood(kernel, np.full(3, 0.3), data) == pytest.approx(
            theirs, rel=1e-6
        )


class TestComparison:
    """What other methods are given is what the field means by their names."""

    def test_forward_selection_takes_the_terms_that_made_the_target(self, script):
        np = importlib.import_module("numpy")
        rng = np.random.default_rng(0)
        X = rng.normal(size=(400, 4))
        Y = np.column_stack([X[:, 0] * X[:, 1] - 2 * X[:, 3], X[:, 2] ** 2]) + 0.1 * rng.normal(
            size=(400, 2)
        )
        model = script("_peers").EquationError(2, stepwise=True).fit(X, Y)
        names = model.features.get_feature_names_out()
        assert [set(names[terms]) for terms in model.terms] == [{"x3", "x0 x1"}, {"x2^2"}]
        inside = np.abs(model.predict(X) - Y) < 1.96 * model.bands(X)[1]
        assert 0.9 < inside.mean() < 0.98

    def test_bands_of_least_squares_are_the_textbooks(self, script):
        np = importlib.import_module("numpy")
        rng = np.random.default_rng(0)
        X, asked = rng.normal(size=(30, 2)), rng.normal(size=(5, 2))
        y = X @ [1.0, -2.0] + 0.3 * rng.normal(size=30)
        A, B = (np.column_stack([np.ones(len(x)), x]) for x in (X, asked))
        residual = y - A @ np.linalg.solve(A.T @ A, A.T @ y)
        variance = residual @ residual / 27
        expected = np.sqrt(variance * np.einsum("ij,jk,ik->i", B, np.linalg.inv(A.T @ A), B))
        function, measurement = script("_peers").EquationError().fit(X, y[:, None]).bands(asked)
        assert function[:, 0] == pytest.approx(expected)
        assert measurement[:, 0] == pytest.approx(np.hypot(expected, np.sqrt(variance)))

    def test_a_trend_is_put_back(self, script):
        np = importlib.import_module("numpy")
        X = np.random.default_rng(0).normal(size=(50, 2))
        peers = script("_peers")
        nothing = peers.DummyRegressor(strategy="constant", constant=[0.0, 0.0])
        Y = X @ [[1.0, 2.0], [3.0, -1.0]] + 5 + 1e-3 * np.sin(9 * X)
        assert peers.OnTrend(nothing).fit(X, Y).predict(X) == pytest.approx(Y, abs=0.01)

    def test_finite_differences_stay_within_a_flight(self, script):
        np, pd = importlib.import_module("numpy"), importlib.import_module("pandas")
        t = np.tile(np.arange(5.0), 2)
        table = pd.DataFrame(
            {"time": t, "flight": np.repeat(["a", "b"], 5), "alpha": t, "beta": -2 * t}
        )
        out = script("_comparison_methods").finite_differences(table)
        assert (out["alpha_dot"] == 1).all()
        assert (out["beta_dot"] == -2).all()

    def test_gpytorchs_predictions_are_those_of_its_covariance(self, script):
        pytest.importorskip("gpytorch", reason="compares with GPyTorch, which is not installed")
        np, rng = (
            importlib.import_module("numpy"),
            importlib.import_module("numpy").random.default_rng(0),
        )
        X, asked = rng.normal(size=(20, 3)), rng.normal(size=(5, 3))
        lcm = script("_peers").ExactLCM(n_steps=3, length_scale=3.0).fit(X, np.sin(X[:, :2]))
        joint = lcm.model.covar_module(
            *(2 * [importlib.import_module("torch").as_tensor(np.vstack([X, asked]))])
        )
        K, noise = joint.to_dense().detach().numpy(), lcm.likelihood.task_noises.detach().numpy()
        mean = np.array([each.constant.item() for each in lcm.model.mean_module.base_means])
        seen, new = K[:40, :40] + np.kron(np.eye(20), np.diag(noise)), K[40:, :40]
        expected = new @ np.linalg.solve(seen, (np.sin(X[:, :2]) - mean).ravel())
        variance = np.diag(K)[40:] - np.einsum("ij,ji->i", new, np.linalg.solve(seen, new.T))
        function, measurement = lcm.bands(asked)
        assert lcm.predict(asked) == pytest.approx(mean + expected.reshape(5, 2), abs=1e-5)
        assert function**2 == pytest.approx(variance.reshape(5, 2), abs=1e-5)
        assert measurement**2 == pytest.approx(function**2 + noise)


def test_jsbsim_agrees_where_its_earth_is_accounted_for(script):
    pytest.importorskip("jsbsim", reason="flies JSBSim, which is not installed")
    earth = script("_jsbsim_earth")
    flight, aircraft = script("_jsbsim_flight").fly("c172p", 2.5, 1200)
    assert abs(earth.acceleration_errors(flight, aircraft)).max() < 1e-9
    errors = earth.trajectory(flight, aircraft, 2.0)
    assert max(errors.values()) < 1e-5
