"""Imports between folders, public names, and dependencies that stay optional."""

import ast
import re
import sys
import tomllib
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "skdgp"
MODULES = sorted(PACKAGE.rglob("*.py"))

# Every file or folder of the package is a room, and these are the rooms that it imports, in three layers
GENERAL_REGRESSOR = {
    "_compute": "",
    "kernels": "_compute",
    "inference": "_compute kernels",
    "_regressor": "_compute kernels inference",
    "metrics": "_compute",
    "model_selection": "_compute",
}
FLIGHTS = {
    "_flight": "_compute",
    "dynamics": "_compute _flight",
    "estimation": "_compute _flight dynamics",
    "io": "_compute _flight dynamics",
    "preprocessing": "_compute _flight dynamics estimation",
    "datasets": "_compute _flight dynamics",
    "identification": "_compute _flight dynamics estimation io preprocessing inference _regressor metrics "
    "model_selection",
}
AFTER_THE_MODEL = {
    "plotting": "_compute _flight dynamics",
    "report": "_compute _flight dynamics identification plotting",
    "design": "_compute _flight dynamics plotting",
    "control": "_compute _flight dynamics",
    "export": "_compute _flight dynamics io kernels inference _regressor",
    "_cli": "_compute _flight dynamics io datasets _regressor report identification export design control plotting",
}
ROOT_MODULES = {
    "__main__": "_cli",
    "__init__": "_compute dynamics estimation io preprocessing datasets kernels inference _regressor metrics "
    "model_selection plotting report identification export design control",
}
LAYERS = (GENERAL_REGRESSOR, FLIGHTS, AFTER_THE_MODEL, ROOT_MODULES)
ALLOWED = {room: below for layer in LAYERS for room, below in layer.items()}
# The arrays of a posterior, which exports write
INSIDE_THE_REGRESSOR = {"kernels", "inference"}
READ_ARRAYS = {"inference", "_regressor", "identification", "export", "__init__"}
# Rooms whose files any room above may import; of others it imports what their ``__init__`` shows
SHARED = {"_compute", "_flight"}
# Imported inside the functions that draw; others of pyproject.toml are imported by `extra`
EXTRAS = {"matplotlib"}


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
    found = []
    open_ = [(ast.parse(path.read_text(encoding="utf-8")), False)]
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


def test_rooms_import_those_that_are_listed_and_no_other():
    """The root of the package is none of them, and the list has no circle."""
    found = {}
    for path in MODULES:
        found.setdefault(part_of(path), set()).update(part for part, _ in own_imports(path))
    graph = {own: {*below.split()} for own, below in ALLOWED.items()}
    assert {own: parts - {own} for own, parts in found.items()} == graph
    assert list(TopologicalSorter(graph).static_order())


def test_rooms_import_their_layer_and_those_below():
    below = set()
    for layer in LAYERS:
        below |= layer.keys()
        assert set(" ".join(layer.values()).split()) <= below


def test_the_regressor_is_used_by_its_public_names():
    """But for the arrays of its posterior."""
    inside = {room for room, below in ALLOWED.items() if INSIDE_THE_REGRESSOR & {*below.split()}}
    assert inside <= READ_ARRAYS


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


def test_inference_knows_kernels_by_their_contract_alone():
    """But for the starts of a search, and the structures that it compares, which are of particular kernels."""

    def beyond(path):
        found = [item.names for part, item in own_imports(path) if part == "kernels"]
        return set().union(*found) - contract

    inference = [path for path in MODULES if part_of(path) == "inference"]
    paths = [path for path in inference if path.stem not in {"_starts", "_structures"}]
    functions = {"covariance_paths", "inducing_features", "prior_paths"}
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
