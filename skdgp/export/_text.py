"""What formats share: names that every program reads, XML with numbers in full precision, packages of the extra."""

from __future__ import annotations

import importlib
import json
import os
import re
import unicodedata
from collections.abc import Iterable, Mapping
from itertools import count
from typing import Any, TypeAlias
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from skdgp._compute.files import text_writer, write_atomically
from skdgp._flight.channels import CHANNELS, COEFFICIENTS, HAT, LENGTHS

RESERVED = {*CHANNELS, *COEFFICIENTS, *(f"{name}{HAT}" for name in LENGTHS)}
"""Names with a meaning of their own: another column is never written under them."""


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return the identifier of each name: ASCII letters, digits and underscores, no digit first, all different.

    An identifier stays as it is. Accents are left out, other characters become underscores, and
    names that would be equal get numbers.
    """
    names = list(dict.fromkeys(names))
    found = {name: name for name in names if re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)}
    taken = RESERVED | found.keys()
    for name in names:
        if name not in found:
            letters = (
                c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c)
            )
            short = re.sub(r"\W+", "_", "".join(letters), flags=re.ASCII)
            short = f"_{short}" if short[:1].isdigit() or not short else short
            found[name] = next(
                each for k in count(1) if (each := f"{short}_{k}" if k > 1 else short) not in taken
            )
            taken.add(found[name])
    return found


def changes_text(names: Mapping[str, str]) -> str:
    r"""Return which names are written in another way, such as '"flap left" is flap_left'; "" if none is.

    The text is ASCII and ends no comment of C or XML: the names are strings of JSON, their signs as
    ``\u002a``.
    """
    changed = {name: short for name, short in names.items() if name != short}
    return ", ".join(f"{_quoted(name)} is {short}" for name, short in changed.items())


def _quoted(name: str) -> str:
    def escaped(sign):
        return f"\\u{ord(sign[0]):04x}" if sign[0].isascii() else json.dumps(sign[0])[1:-1]

    return f'"{re.sub(r"[^A-Za-z0-9_ ]", escaped, name)}"'


def file_name(text: str) -> str:
    """Return a name for a file or a model: ASCII letters, digits, underscores and hyphens."""
    return re.sub(r"[^\w-]", "_", text, flags=re.ASCII) or "aircraft"


def number_text(value: float) -> str:
    """Return a number with all its digits."""
    return repr(float(value))


Content: TypeAlias = "Element[Any] | str | float"
"""Of an element: other elements and comments, or a text or a number."""


def element(tag: str, *content: Content, **attributes: str) -> Element:
    """Return an element of XML."""
    found = Element(tag, attributes)
    for each in content:
        if isinstance(each, Element):
            found.append(each)
        else:
            found.text = each if isinstance(each, str) else number_text(each)
    return found


def write_xml(path: str | os.PathLike[str], root: Element) -> None:
    """Write a document, its elements as they are indented."""
    head = '<?xml version="1.0"?>\n'
    write_atomically(path, text_writer(f"{head}{ElementTree.tostring(root, encoding='unicode')}\n"))


def extra(package: str) -> Any:
    """Return a package of the extra ``export``; raise ImportError if it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f'This needs {package}, which is not installed: pip install "skdgp[export]".'
        ) from error


def units_of(names: Iterable[str], own: Mapping[str, str]) -> tuple[str, ...]:
    """Return the units of columns, of those in ``own`` by it, such as "full throw"; "-" where there is none."""
    return tuple(
        own.get(name) or (CHANNELS[name].unit if name in CHANNELS else "") or "-" for name in names
    )
