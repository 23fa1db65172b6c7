"""Imports between folders, public names, and dependencies that stay optional."""

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "skdgp"
MODULES = sorted(PACKAGE.rglob("*.py"))

# Every file or folder of the package is a room, which stands on one floor and imports from floors
# below it alone.
FLOORS = [
    ["_compute"],
    ["_flight"],
    ["dynamics"],
    ["estimation"],
    [
        "kernels",
        "metrics",
        "model_selection",
        "io",
        "preprocessing",
        "_excitation",
        "_display",
    ],
    ["inference"],
    ["_regressor", "datasets"],
    ["plotting"],
    ["report"],  # shows arrays; it knows no models
    ["identification"],  # fills the reports of its models
    [
        "export",
        "design",
        "control",
    ],  # what is done with a model: written for other programs; what to fly next
    ["_cli"],
    ["__main__", "__init__"],
]
FLOOR = {}
for number, parts in enumerate(FLOORS, start=1):
    FLOOR |= dict.fromkeys(parts, number)
LEARNING = {"kernels", "inference", "_regressor"}
AIRCRAFT = {"_flight", "io", "preprocessing", "dynamics", "estimation", "_excitation", "design"}
AIRCRAFT |= {"datasets"}
LEAVES = {"export", "design"}
MAY_IMPORT_LEAVES = {"_cli", "__init__", "__main__"}
# Rooms whose files any room above may import; of others it imports what their ``__init__`` shows
SHARED = {"_compute", "_flight", "_excitation", "_display"}
# Imported inside the functions that use them, or not at all.
EXTRAS = {
    *("matplotlib", "pyarrow", "polars", "dask", "distributed", "control", "pyulog", "pymavlink"),
    "casadi",
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


def offenders(rule, paths=MODULES):
    """What a rule finds wrong, by file."""
    return {ids(path): found for path in paths if (found := rule(path))}


@cache
def imports(path):
    """Every import of a file; none is relative."""
    found, open_ = [], [(ast.parse(path.read_text(encoding="utf-8")), False)]
    while open_:
        node, later = open_.pop()
        if isinstance(node, ast.Import):
            found += [Import(alias.name, (), not later, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names = tuple(alias.name for alias in node.names)
            found.append(Import(node.module, names, not later, node.lineno))
        later = later or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        open_ += [(child, later) for child in ast.iter_child_nodes(node)]
    return found


def own_imports(path):
    """(part, import) of the package's own modules; ``from skdgp import x`` names x."""
    for item in imports(path):
        if item.module == "skdgp":
            yield from ((name, item) for name in item.names or ("__init__",))
        elif item.module.startswith("skdgp."):
            yield item.module.split(".")[1], item


def ids(path):
    return str(path.relative_to(ROOT))


def test_every_part_has_a_floor():
    assert {part_of(path) for path in MODULES} == set(FLOOR)


def test_imports_go_downward():
    def upward(path):
        own = part_of(path)
        return [
            item for part, item in own_imports(path) if part != own and FLOOR[part] >= FLOOR[own]
        ]

    assert not offenders(upward)


def test_leaves_are_imported_by_the_command_line_alone():
    """Either could become a package of its own by moving a folder."""

    def leaf(path):
        own = part_of(path)
        found = {part for part, _ in own_imports(path)} & LEAVES - {own}
        return found if own not in MAY_IMPORT_LEAVES else set()

    assert not offenders(leaf)


def is_private(name):
    return name.startswith("_") and not name.startswith("__")


def test_rooms_show_each_other_their_faces():
    """``from skdgp.room._module import name`` stays in its room."""

    def behind_the_face(path):
        own = {part_of(path), *SHARED}
        found = [item for part, item in own_imports(path) if part not in own]
        return [
            item
            for item in found
            if any(map(is_private, [*item.module.split(".")[2:], *item.names]))
        ]

    assert not offenders(behind_the_face)


def test_nothing_inside_imports_the_package_root():
    def from_root(path):
        return [item for part, item in own_imports(path) if part not in FLOOR or part == "__init__"]

    assert not offenders(from_root)


def test_no_module_imports_itself_in_a_circle():
    """A folder's face re-exports what stands inside it."""
    graph = {}
    for path in MODULES:
        module = dotted(path)
        targets = set()
        for _, item in own_imports(path):
            if item.at_once:
                targets |= {item.module, *(f"{item.module}.{name}" for name in item.names)}
        inside = {target for target in targets if module.startswith(f"{target}.")}
        graph[module] = (targets - inside - {module}) & {dotted(other) for other in MODULES}
    assert list(TopologicalSorter(graph).static_order())


@pytest.mark.parametrize(("half", "other"), [(LEARNING, AIRCRAFT), (AIRCRAFT, LEARNING)])
def test_neither_half_imports_the_other(half, other):
    paths = [path for path in MODULES if part_of(path) in half]
    assert not offenders(lambda path: {part for part, _ in own_imports(path)} & other, paths)


def test_inference_knows_kernels_by_their_contract_alone():
    """But for the starts of a search, and the structures that it compares, which are of particular kernels."""

    def beyond(path):
        found = [item.names for part, item in own_imports(path) if part == "kernels"]
        return set().union(*found) - contract

    inference = [path for path in MODULES if part_of(path) == "inference"]
    paths = [path for path in inference if path.stem not in {"_starts", "_structures"}]
    functions = {"covariance_paths", "independent_processes", "inducing_features", "prior_paths"}
    classes = {"Features", "InputPair", "LinearPaths", "MultiOutputKernel", "PathBundle"}
    contract = classes | functions
    assert not offenders(beyond, paths)


def test_nothing_but_the_dependencies_is_imported():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    required = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}
    required = {"sklearn" if name == "scikit-learn" else name for name in required}
    allowed = set(sys.stdlib_module_names) | required | {"skdgp"}

    def others(path):
        found = set()
        for item in imports(path):
            root = item.module.split(".")[0]
            if root not in allowed and (item.at_once or root not in EXTRAS):
                found.add(root)
        return found

    assert not offenders(others)


def test_extras_are_not_loaded_by_the_package():
    """pandas may bring pyarrow by itself; the package adds none."""
    code = (
        "import sys, numpy, scipy, pandas, sklearn; before = set(sys.modules);"
        "import skdgp, skdgp.kernels, skdgp.inference, skdgp.io, skdgp.preprocessing, "
        "skdgp.dynamics, skdgp.estimation, skdgp.metrics,"
        "skdgp.model_selection, skdgp.datasets, skdgp.plotting, skdgp.report, skdgp.identification;"
        "print(sorted({m.split('.')[0] for m in set(sys.modules) - before}))"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    ).stdout
    assert not set(ast.literal_eval(loaded)) & EXTRAS
