"""The walls of the house: who may import whom, what is public, what stays optional."""

import ast
import importlib
import importlib.util
import inspect
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from skdgp._compute.moved import MOVED

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "skdgp"
MODULES = sorted(PACKAGE.rglob("*.py"))

# Every file or folder of the package is a room, which stands on one floor and imports from floors below it alone.
FLOORS = [
    ["_flight", "_compute"],
    ["kernels", "metrics", "io", "preprocessing", "dynamics"],
    ["inference", "design"],
    ["_regressor", "model_selection", "datasets"],
    ["_effects"],
    ["plotting", "calibration"],
    ["report"],  # shows arrays; it knows no models
    ["identification"],  # calibrates its models, and fills their reports
    ["export"],  # writes models of identification for other programs
    ["_cli"],
    ["__main__", "__init__"],
]
FLOOR = {part: number for number, parts in enumerate(FLOORS, start=1) for part in parts}
LEARNING = {"kernels", "inference", "_regressor"}
AIRCRAFT = {"_flight", "io", "preprocessing", "dynamics", "design", "datasets"}
# Imported inside the functions that use them, or not at all.
EXTRAS = {
    *("matplotlib", "pyarrow", "polars", "dask", "distributed", "control", "pyulog", "pymavlink"),
    *("casadi", "onnx", "gymnasium"),
}


class Import(NamedTuple):
    """One imported module, as an absolute name, and whether it is imported when the file is."""

    module: str
    names: tuple[str, ...]
    at_once: bool
    line: int


def part_of(path):
    """The file or folder directly under skdgp that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def dotted(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_in(code, package):
    """Every import of some code that stands in a package, relative ones resolved."""
    tree = ast.parse(code)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    later = {id(node) for function in functions for node in ast.walk(function)}
    found = []
    for node in ast.walk(tree):
        at_once = id(node) not in later
        if isinstance(node, ast.Import):
            found += [Import(alias.name, (), at_once, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            found.append(Import(module, tuple(alias.name for alias in node.names), at_once, node.lineno))
    return found


@cache
def imports(path):
    """Every import of a file."""
    package = dotted(path) if path.name == "__init__.py" else dotted(path.parent / "__init__.py")
    return imports_in(path.read_text(encoding="utf-8"), package)


def own_imports(path):
    """(part, import) of the package's own modules; ``from .. import x`` names x."""
    for item in imports(path):
        if item.module == "skdgp":
            yield from ((name, item) for name in item.names or ("__init__",))
        elif item.module.startswith("skdgp."):
            yield item.module.split(".")[1], item


def ids(path):
    return str(path.relative_to(ROOT))


def test_each_way_of_crossing_a_wall_is_seen():
    """The test of the walls is itself tested."""
    code = """
from .._flight.smoothing import smooth
from . import _frames
import skdgp.io as io
def later():
    from ..kernels import Sum
"""
    found = imports_in(code, "skdgp.dynamics")
    assert {item.module for item in found} == {"skdgp._flight.smoothing", "skdgp.dynamics", "skdgp.io", "skdgp.kernels"}
    assert [item.module for item in found if not item.at_once] == ["skdgp.kernels"]


def test_every_part_has_a_floor():
    assert {part_of(path) for path in MODULES} == set(FLOOR)


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_imports_go_downward(path):
    own = part_of(path)
    for part, item in own_imports(path):
        if own == part:
            continue
        where = f"{ids(path)}:{item.line}, on floor {FLOOR[own]},"
        assert FLOOR[part] < FLOOR[own], f"{where} imports {item.module} of floor {FLOOR[part]}"


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_nothing_inside_imports_the_package_root(path):
    for part, item in own_imports(path):
        assert part in FLOOR, f"{ids(path)}:{item.line} imports {part!r} from the package root"
        assert part != "__init__"


def test_no_module_imports_itself_in_a_circle():
    graph = {dotted(path): set() for path in MODULES}
    for path in MODULES:
        for _, item in own_imports(path):
            if item.at_once:
                targets = {item.module, *(f"{item.module}.{name}" for name in item.names)}
                graph[dotted(path)] |= {t for t in targets if t in graph and t != dotted(path)}
    done, open_ = set(), []

    def visit(module):
        if module in open_:
            pytest.fail(" -> ".join([*open_[open_.index(module) :], module]))
        if module not in done:
            open_.append(module)
            for target in graph[module]:
                if not module.startswith(target + "."):  # a folder's face re-exports what stands inside it
                    visit(target)
            open_.pop()
            done.add(module)

    for module in graph:
        visit(module)


@pytest.mark.parametrize("path", [p for p in MODULES if part_of(p) in LEARNING], ids=ids)
def test_the_learning_half_knows_nothing_of_aircraft(path):
    assert not {part for part, _ in own_imports(path)} & AIRCRAFT


@pytest.mark.parametrize("path", [p for p in MODULES if part_of(p) in AIRCRAFT], ids=ids)
def test_the_aircraft_half_knows_nothing_of_learning(path):
    assert not {part for part, _ in own_imports(path)} & LEARNING


@pytest.mark.parametrize("path", [p for p in MODULES if part_of(p) == "inference"], ids=ids)
def test_inference_knows_kernels_by_their_contract_alone(path):
    for part, item in own_imports(path):
        if part == "kernels":
            assert set(item.names) <= {"MultiOutputKernel"}


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_nothing_but_the_dependencies_is_imported(path):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    required = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}
    required = {"sklearn" if name == "scikit-learn" else name for name in required}
    allowed = set(sys.stdlib_module_names) | required | {"skdgp"}
    for item in imports(path):
        root = item.module.split(".")[0]
        assert root in (allowed if item.at_once else allowed | EXTRAS), f"{ids(path)}:{item.line} imports {item.module}"


COMPAT = PACKAGE / "_compute" / "sklearn_compat.py"
WATCHED = {"sklearn", "joblib", "argparse", "numpy", "scipy", "pandas"}
DOCUMENTED = {"_replace", "_fields", "_asdict", "_make", "_exit"}  # of named tuples and os, for users


def is_private(name):
    return name.startswith("_") and not name.startswith("__")


@cache
def defined_here():
    """Return every private name that the package itself defines or assigns."""
    nodes = [node for path in MODULES for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    named = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    own = [n for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)]
    stored |= {node.attr for node in own if isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")}
    calls = [n for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)]
    frozen = {n.args[1].value for n in calls if n.func.attr == "__setattr__" and isinstance(n.args[1], ast.Constant)}
    return named | stored | frozen | DOCUMENTED


def private_names(code):
    """Return the private names of other packages that some code imports or reads as attributes, with their lines."""
    found = {}
    for item in imports_in(code, "skdgp"):
        if item.module.split(".")[0] in WATCHED:
            found |= {part: item.line for part in (*item.module.split("."), *item.names) if is_private(part)}
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute) and is_private(node.attr) and node.attr not in defined_here():
            found[node.attr] = node.lineno
    return found


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_private_names_of_other_packages_stand_in_one_file(path):
    if path != COMPAT:
        found = private_names(path.read_text(encoding="utf-8"))
        assert not found, f"{ids(path)} uses {found}: import them from skdgp._compute.sklearn_compat"


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("from sklearn.base import _fit_context", "_fit_context"),
        ("from sklearn.utils._param_validation import Interval", "_param_validation"),
        ("import numpy as np\nnp.core._methods", "_methods"),
        ("def later():\n    import joblib._store_backends", "_store_backends"),
        ("def options(parser):\n    return parser._option_string_actions", "_option_string_actions"),
    ],
)
def test_each_private_name_is_seen(code, name):
    assert name in private_names(code)


def test_extras_are_not_loaded_by_the_package():
    """pandas may bring pyarrow by itself; the package adds none."""
    code = (
        "import sys, numpy, scipy, pandas, sklearn; before = set(sys.modules);"
        "import skdgp, skdgp.kernels, skdgp.inference, skdgp.io, skdgp.preprocessing, skdgp.dynamics, skdgp.metrics,"
        "skdgp.model_selection, skdgp.datasets, skdgp.plotting, skdgp.report, skdgp.identification;"
        "print(sorted({m.split('.')[0] for m in set(sys.modules) - before}))"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    ).stdout
    assert not set(ast.literal_eval(loaded)) & EXTRAS


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_a_file_says_what_it_is(path):
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), f"{ids(path)} does not say what it is"


PUBLIC = [p for p in MODULES if not any(n.startswith("_") for n in dotted(p).split(".")[1:])]


@pytest.mark.parametrize("path", PUBLIC, ids=ids)
def test_public_modules_say_what_is_public(path):
    module = importlib.import_module(dotted(path))
    assert module.__doc__
    assert len(module.__all__) == len(set(module.__all__)) > 0
    for name in module.__all__:
        assert not name.startswith("_") or name == "__version__"
        obj = getattr(module, name)
        if inspect.isclass(obj) or inspect.isfunction(obj):
            assert inspect.getdoc(obj), f"{dotted(path)}.{name} has no docstring"


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_no_assert_and_no_print_stand_in_for_errors(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert not [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    if part_of(path) != "_cli":
        calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
        assert not [node.lineno for node in calls if node.func.id == "print"]


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_no_global_random_state_is_touched(path):
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"np\.random\.(seed|rand|randn|normal|uniform|choice|shuffle|permutation)\b", text)


@pytest.mark.parametrize("old", MOVED)
def test_modules_that_moved_are_found_by_their_old_path(old):
    """Model files name the modules of their classes."""
    assert importlib.import_module(old) is importlib.import_module(MOVED[old])
