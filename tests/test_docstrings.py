"""Every public name is in the reference, annotated, and its docstring is what numpydoc expects."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import skdgp

REFERENCE = Path(__file__).resolve().parents[1] / "docs" / "api"
MODULES = ["skdgp"] + [
    module.name
    for module in pkgutil.walk_packages(skdgp.__path__, "skdgp.")
    if "._" not in module.name
]
NOT_ASKED = {
    "GL08",  # a docstring: a method may inherit one, which is asked for below
    "SA01",  # See Also
    "ES01",  # more than a line
    "EX01",  # an example of every method
    "PR04",  # a type, where a parameter is said to be as elsewhere
    "PR07",  # words for a parameter, where its type says it
    "RT02",  # a single return value without a name
    "RT03",  # words for what is returned, where its type says it
    "PR08",  # descriptions begin with a capital letter, or with a symbol
    "RT04",
    "YD01",  # what a context manager yields, where it is nothing
}
OF_SECTIONS = {"PR01", "RT01"}  # one line may say it all, arguments and what is returned included
MOST_IN_A_LINE = 3  # parameters of such a function
# the annotation of a method that returns its object or makes one needs no section Returns
ITSELF = "Self"


def of(cls):
    """Names of the public methods and properties that a class has from this package."""
    for base in cls.__mro__:
        if base.__module__.startswith("skdgp."):
            for name, value in vars(base).items():
                function = getattr(value, "__func__", value)
                public = not name.startswith("_") and (
                    inspect.isfunction(function) or isinstance(value, property)
                )
                if public and inspect.getattr_static(cls, name) is value:
                    yield name


def public_things():
    """Each public function, class and method, by name."""
    for module in map(importlib.import_module, MODULES):
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isfunction(thing) or inspect.isclass(thing):
                yield f"{module.__name__}.{name}", thing
            if inspect.isclass(thing):
                yield from (
                    (f"{module.__name__}.{name}.{own}", getattr(thing, own)) for own in of(thing)
                )


THINGS = dict(public_things())


def faults(name, validate):
    """Return what numpydoc finds wrong in the docstring of a public name."""
    if not inspect.getdoc(THINGS[name]):
        return {"GL08": "no docstring"}
    found = validate(name)
    wrong = {code: text for code, text in found["errors"] if code not in NOT_ASKED}
    if "\nParameters\n" not in found["docstring"]:
        wrong = {code: text for code, text in wrong.items() if code not in OF_SECTIONS}
        function = inspect.isfunction(THINGS[name]) and name.rpartition(".")[0] in MODULES
        if function and len(inspect.signature(THINGS[name]).parameters) > MOST_IN_A_LINE:
            wrong["PR01"] = f"more than {MOST_IN_A_LINE} parameters without a section Parameters"
    if getattr(THINGS[name], "__annotations__", {}).get("return") == ITSELF:
        wrong.pop("RT01", None)
    return wrong


def test_docstrings_are_numpydocs():
    reason = 'reads docstrings with numpydoc: pip install -e ".[docs]"'
    numpydoc = pytest.importorskip("numpydoc.validate", reason=reason)
    assert {name: wrong for name in THINGS if (wrong := faults(name, numpydoc.validate))} == {}


def is_bare(thing):
    """Return whether a parameter, or what is returned, has no annotation; of a class those of its constructor."""
    if inspect.isclass(thing):
        thing = vars(thing).get("__init__")
    if not inspect.isroutine(thing):
        return False
    signature = inspect.signature(thing)
    annotations = [signature.return_annotation]
    for name, parameter in signature.parameters.items():
        if name not in ("self", "cls"):
            annotations.append(parameter.annotation)
    return signature.empty in annotations


def test_every_public_function_is_annotated():
    """mypy checks the rest."""
    assert [name for name, thing in THINGS.items() if is_bare(thing)] == []


def test_type_checkers_see_the_names_of_the_package_root():
    """They are imported when asked for, which only the root's own code says."""
    assert (Path(skdgp.__file__).parent / "py.typed").exists()
    tree = ast.parse(Path(skdgp.__file__).read_text(encoding="utf-8"))
    (typed,) = [block for block in tree.body if isinstance(block, ast.If)]
    named = []
    for line in typed.body:
        named += [alias.asname for alias in line.names if alias.asname == alias.name]
    folders = [name.removeprefix("skdgp.") for name in MODULES if name.count(".") == 1]
    assert sorted(named) == sorted([*skdgp.__all__, *folders])
    assert {*named} <= {*dir(skdgp)}
    assert all(getattr(skdgp, name) is not None for name in named)


@pytest.mark.parametrize("name", MODULES)
def test_modules_say_what_is_public_and_the_reference_has_it(name):
    module = importlib.import_module(name)
    assert module.__doc__
    page = (REFERENCE / f"{name}.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", page, flags=re.MULTILINE)
    data = re.findall(rf"^\.\. data:: {re.escape(name)}\.(\w+)$", page, flags=re.MULTILINE)
    assert sorted(module.__all__) == sorted({*listed, *data})
    assert not [own for own in module.__all__ if own.startswith("_") and own != "__version__"]
