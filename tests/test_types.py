"""Public functions say what they take and return: mypy checks the rest."""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path

import skdgp

ROOMS = ["skdgp"] + [
    f"skdgp.{room.name}"
    for room in pkgutil.iter_modules(skdgp.__path__)
    if not room.name.startswith("_")
]


def public_functions(room):
    """Return the functions of a room, and the methods of its classes, by name."""
    found = {}
    for name in room.__all__:
        thing = getattr(room, name)
        if inspect.isfunction(thing):
            found[name] = thing
        elif inspect.isclass(thing) and thing.__module__.startswith("skdgp."):
            for method, value in vars(thing).items():
                function = getattr(value, "__func__", value)
                written_here = inspect.isfunction(function) and function.__module__.startswith(
                    "skdgp."
                )
                if written_here and (method == "__init__" or not method.startswith("_")):
                    found[f"{name}.{method}"] = function
    return found


def test_every_public_function_is_annotated():
    bare = []
    for name in ROOMS:
        functions = public_functions(importlib.import_module(name))
        assert functions
        bare += [f"{name}.{called}" for called, one in functions.items() if is_bare(one)]
    assert bare == []


def is_bare(function):
    """Return whether a parameter, or what is returned, has no annotation."""
    signature = inspect.signature(function)
    parameters = [one for one in signature.parameters.values() if one.name not in ("self", "cls")]
    annotations = [one.annotation for one in parameters]
    return signature.empty in [*annotations, signature.return_annotation]


def test_type_checkers_see_the_names_of_the_package_root():
    """They are imported when asked for, which only the root's own code says."""
    assert (Path(skdgp.__file__).parent / "py.typed").exists()
    tree = ast.parse(Path(skdgp.__file__).read_text(encoding="utf-8"))
    (typed,) = [block for block in tree.body if isinstance(block, ast.If)]
    named = []
    for line in typed.body:
        named += [alias.asname for alias in line.names if alias.asname == alias.name]
    folders = [room.partition(".")[2] for room in ROOMS[1:]]
    assert sorted(named) == sorted([*skdgp.__all__, *folders])
    assert {*named} <= {*dir(skdgp)}
    assert all(getattr(skdgp, name) is not None for name in named)
