"""XML of the formats: elements with numbers in full precision, and files."""

from __future__ import annotations

import os
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from skdgp._compute.files import text_writer, write_atomically


def number_text(value: float) -> str:
    """Return a number with all its digits."""
    return repr(float(value))


def add_text(parent: Element, tag: str, value: Any, **attributes: str) -> Element:
    """Append an element that holds a text or a number, and return it."""
    element = SubElement(parent, tag, attributes)
    element.text = value if isinstance(value, str) else number_text(value)
    return element


def write_xml(path: str | os.PathLike[str], root: Element, doctype: str = "") -> None:
    """Write a document, its elements as they are indented."""
    head = '<?xml version="1.0"?>\n' + doctype
    write_atomically(path, text_writer(f"{head}{ElementTree.tostring(root, encoding='unicode')}\n"))
