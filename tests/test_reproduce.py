"""The scripts that reproduce findings, where they are beside the project, import names that exist."""

import ast
from importlib import import_module
from importlib.util import find_spec

import pytest


def missing_names(path):
    """Return the names that a script imports from the package and that are not there."""
    missing = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or str(node.module).split(".")[0] != "skdgp":
            continue
        if find_spec(node.module) is None:
            missing.append(node.module)
            continue
        names = [alias.name for alias in node.names]
        module = import_module(node.module)
        missing += [f"{node.module}.{name}" for name in names if not hasattr(module, name)]
    return missing


@pytest.mark.shared
def test_names_that_scripts_import_exist(shared_data):
    scripts = sorted((shared_data.parent / "reproduce").rglob("*.py"))
    if not scripts:
        pytest.skip("the scripts that reproduce findings are not beside the project")
    wrong = {path.name: names for path in scripts if (names := missing_names(path))}
    assert wrong == {}


def test_a_name_that_is_gone_is_found(tmp_path):
    path = tmp_path / "script.py"
    path.write_text(
        "import numpy\nfrom skdgp.dynamics import trim, trimmed\nfrom skdgp.gone import x\n"
    )
    assert missing_names(path) == ["skdgp.dynamics.trimmed", "skdgp.gone"]
