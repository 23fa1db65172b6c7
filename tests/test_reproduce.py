"""The scripts that reproduce findings, where they are beside the project: their names exist, and short ones run."""

import ast
import runpy
import sys
import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "shared" / "reproduce"
# Those that take seconds; they end with an error where the package has one
SHORT = [
    "all_fixed", "constant_regressors", "fixed_kernel", "units",
    "ahrs_trim", "airspeed_ratio", "ardupilot_flaperons_and_spoilers", "mass_and_flaps",
    "px4_airspeed_source", "px4_ekf_reset", "px4_vtol_throttle_and_lift_motors",
    "rounded_times", "stuck_at_zero", "twin_differential_thrust",
]  # fmt: skip


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


@pytest.fixture
def scripts(shared_data):
    """Return the paths of the scripts by their names in the folder."""
    found = {path.relative_to(SCRIPTS).as_posix(): path for path in sorted(SCRIPTS.rglob("*.py"))}
    if not found:
        pytest.skip("the scripts that reproduce findings are not beside the project")
    return found


@pytest.mark.shared
def test_names_that_scripts_import_exist(scripts):
    wrong = {}
    for name, path in scripts.items():
        if names := missing_names(path):
            wrong[name] = names
    assert wrong == {}


@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize("stem", SHORT)
def test_a_short_script_runs(stem, scripts, tmp_path, monkeypatch):
    (path,) = [path for path in scripts.values() if path.stem == stem]
    (tmp_path / "tmp").mkdir()  # some write there
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(path.parent)
    monkeypatch.setattr(sys, "argv", [str(path)])
    before = {*sys.modules}
    with warnings.catch_warnings(action="ignore"):
        runpy.run_path(str(path), run_name="__main__")
    for name in {*sys.modules} - before:  # folders have files of one name
        if SCRIPTS in Path(getattr(sys.modules[name], "__file__", None) or "").parents:
            del sys.modules[name]
