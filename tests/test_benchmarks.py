"""Every benchmark starts, and four run at tiny sizes; what they compare with is what its name says."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng

from skdgp.inference import Data, log_likelihood
from skdgp.kernels import ConvolvedGaussian

FOLDER = Path(__file__).parent / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark as it is when run: with its own folder first."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # of processes that a benchmark starts
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if (FOLDER / f"{name}.py").is_file():
            del sys.modules[name]


@pytest.mark.usefixtures("hasty_fits")
@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("likelihood", []),
        ("bands", []),
        ("dependence", []),
        ("comparison", [".", "--methods", "least squares", "skdgp pipeline"]),
        ("published", [".", "--methods", "skdgp, `predict`"]),
    ],
)
def test_writes_its_tables_and_says_on_which_machine(script, name, methods, tmp_path):
    script(name).main(["--smoke", "--out", str(tmp_path), *methods])
    results = json.loads((tmp_path / f"{name}.json").read_text())
    assert results.pop("machine")["cores"] >= 1
    assert any(results.values())


def test_every_script_can_be_asked_for_its_options(script, capsys):
    for name in SCRIPTS:
        with pytest.raises(SystemExit, match="0"):
            script(name).main(["--help"])
    assert capsys.readouterr().out.count("--out") >= len(SCRIPTS)


def test_marked_tables_of_the_page_are_replaced_and_others_stay(script):
    page = "a\n<!-- pairs:x -->\nold\n<!-- end -->\n<!-- jura:y -->\nkept\n<!-- end -->\n"
    filled = script("page").filled(page, {"pairs": {"x": [{"error": 0.25, "n": 3}]}})
    table = "| error | n |\n| --- | --- |\n| 0.250 | 3 |"
    assert filled == page.replace("old", table)


def test_likelihood_of_tied_filters_is_gpytorchs_lcm(script):
    pytest.importorskip("gpytorch", reason="compares with GPyTorch, which is not installed")
    gpytorch = script("_gpytorch")
    case = script("likelihood").Case(20, 3, 2, 4)
    X, Y = case.table()
    model, noise = gpytorch.exact_lcm(X, Y, case.M, length_scale=2.0, noise=0.3)
    parts = [kernel.task_covar_module for kernel in model.covar_module.covar_module_list]
    shared = [part.covar_factor.detach().numpy().T for part in parts]
    private = [np.diag(np.sqrt(part.var.detach().numpy())) for part in parts]
    w = np.concatenate(shared + private)
    kernel = ConvolvedGaussian(
        feeds=w != 0,
        covariance_type="tied",
        amplitude=w,
        length_scale=np.full((len(w), 3, 4), 2.0),
    )
    with gpytorch.cholesky():
        theirs = gpytorch.likelihood_and_gradient(model, noise)()
    ours = log_likelihood(kernel, np.full(3, 0.3), Data.from_table(X, Y))
    assert ours == pytest.approx(theirs, rel=1e-6)


class TestPeers:
    """Other methods are what the field means by their names."""

    def test_forward_selection_takes_the_terms_that_made_the_target(self, script):
        rng = default_rng(0)
        X = rng.normal(size=(400, 4))
        a, b, c, d = X.T
        Y = np.column_stack([a * b - 2 * d, c**2])
        Y += 0.1 * rng.normal(size=Y.shape)
        model = script("_peers").EquationError(2, stepwise=True).fit(X, Y)
        names = model.features.get_feature_names_out()
        assert [set(names[terms]) for terms in model.terms] == [{"x3", "x0 x1"}, {"x2^2"}]
        inside = np.abs(model.predict(X) - Y) < 1.96 * model.bands(X)[1]
        assert 0.9 < inside.mean() < 0.98

    def test_bands_of_least_squares_are_the_textbooks(self, script):
        rng = default_rng(0)
        X = rng.normal(size=(30, 2))
        asked = rng.normal(size=(5, 2))
        y = X @ [1.0, -2.0] + 0.3 * rng.normal(size=30)
        A, B = (np.column_stack([np.ones(len(x)), x]) for x in (X, asked))
        residual = y - A @ np.linalg.solve(A.T @ A, A.T @ y)
        variance = residual @ residual / 27
        expected = np.sqrt(variance * np.einsum("ij,jk,ik->i", B, np.linalg.inv(A.T @ A), B))
        function, measurement = script("_peers").EquationError().fit(X, y[:, None]).bands(asked)
        assert function[:, 0] == pytest.approx(expected)
        assert measurement[:, 0] == pytest.approx(np.hypot(expected, np.sqrt(variance)))
