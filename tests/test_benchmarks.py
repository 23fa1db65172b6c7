"""Every benchmark starts, and three run at tiny sizes."""

import json
import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))


@pytest.fixture
def run(monkeypatch):
    """Return a function that runs a benchmark with some words, as a script beside the others."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # of processes that a benchmark starts
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")

    def run(name, *words):
        monkeypatch.setattr(sys, "argv", [name, *words])
        runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")

    yield run
    for name in set(sys.modules) - before:
        if (FOLDER / f"{name}.py").is_file():
            del sys.modules[name]


@pytest.mark.usefixtures("hasty_fits")
@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("bands", []),
        ("dependence", []),
        ("published", [".", "--methods", "skdgp, `predict`"]),
    ],
)
def test_writes_its_tables_and_says_on_which_machine(run, name, methods, tmp_path):
    run(name, "--smoke", "--out", str(tmp_path), *methods)
    results = json.loads((tmp_path / f"{name}.json").read_text())
    assert results.pop("machine")["cores"] >= 1
    assert any(results.values())


def test_every_script_can_be_asked_for_its_options(run, capsys):
    for name in SCRIPTS:
        with pytest.raises(SystemExit, match="0"):
            run(name, "--help")
    assert capsys.readouterr().out.count("--out") >= len(SCRIPTS)
