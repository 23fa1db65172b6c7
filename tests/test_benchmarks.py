"""Every benchmark still runs: at tiny sizes, without the packages it compares with."""

import importlib
import json
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "benchmarks"
SCRIPTS = (
    "likelihood",
    "growth",
    "evaluations",
    "samples",
    "heldout",
    "prediction_peers",
    "prediction",
    "workers",
)


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark as it is when run: with its own folder first."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(FOLDER)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if (FOLDER / f"{name}.py").is_file():
            del sys.modules[name]


@pytest.mark.parametrize("name", SCRIPTS)
def test_writes_its_tables_and_says_on_which_machine(script, name, tmp_path, capsys):
    script(name).main(["--smoke", "--no-peers", "--repeats", "1", "--out", str(tmp_path)])
    results = json.loads((tmp_path / f"{name}.json").read_text())
    assert results.pop("machine")["cores"] >= 1
    printed = capsys.readouterr().out
    assert any(results.values())
    assert all(title.replace("_", " ") in printed for title in results)


def test_interleaving_takes_turns_and_keeps_the_shortest(script):
    common, calls = script("_common"), []
    found = common.interleaved({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert calls == ["a", "b"] * 3
    assert set(found) == {"a", "b"}


def test_page_is_filled_where_there_are_results_and_left_alone_elsewhere(script):
    page = "<!-- growth:samples -->\nold\n<!-- end -->\ntext\n<!-- growth:latents -->\nold\n<!-- end -->\n"
    filled = script("page").filled(page, {"growth": {"samples": [{"N": 120, "seconds": 0.01234}]}})
    assert "| 120 | 0.0123 |" in filled
    assert filled.count("old") == 1
    assert "text" in filled


def test_every_table_on_the_page_has_a_script(script):
    page = script("page")
    marks = page.re.findall(r"<!-- (\w+):\w+ -->", (page.DOCS / "benchmarks.md").read_text(encoding="utf-8"))
    assert marks
    for name in marks:
        script_of = {"tried": "heldout"}.get(name, name)
        assert (FOLDER / f"{script_of}.py").is_file()


def test_fits_interrupted_at_a_deadline_end_there_and_predict(script):
    heldout = script("heldout")
    points = list(heldout.ours(heldout.toy(), heldout.toy().Y, [0.05], inference="exact"))
    assert len(points) == 2
    assert points[0][1] < points[1][1]
    assert points[1][2] < 0.2


class TestLikelihoodOfOthers:
    """The peers evaluate what ours evaluates: where filters are tied, ours is the LCM."""

    def test_value_is_gpytorchs(self, script):
        pytest.importorskip("gpytorch", reason="compares with GPyTorch, which is not installed")
        gpytorch, np = script("_gpytorch"), importlib.import_module("numpy")
        likelihood = script("likelihood")
        case = likelihood.Case(20, 3, 2, 4)
        X, Y = case.table()
        model, noise = gpytorch.exact_lcm(X, Y, case.M, length_scale=2.0, noise=0.3)
        factors = [kernel.task_covar_module.covar_factor for kernel in model.covar_module.covar_module_list]
        extra = [kernel.task_covar_module.var for kernel in model.covar_module.covar_module_list]
        w = np.concatenate(
            [f.detach().numpy().T for f in factors] + [np.diag(np.sqrt(v.detach().numpy())) for v in extra]
        )
        kernel = likelihood.ConvolvedGaussian(
            feeds=w != 0, covariance_type="tied", amplitude=w, length_scale=np.full((len(w), 3, 4), 2.0)
        )
        data = likelihood.Data.from_table(X, Y)
        with gpytorch.cholesky():
            theirs = gpytorch.likelihood_and_gradient(model, noise)()
        assert likelihood.log_likelihood(kernel, np.full(3, 0.3), data) == pytest.approx(theirs, rel=1e-6)
