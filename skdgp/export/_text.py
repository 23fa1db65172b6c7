"""Names that every program reads, and packages of the extra."""

from __future__ import annotations

import importlib
import json
import re
import unicodedata
from collections.abc import Iterable, Mapping
from itertools import count
from typing import Any

from skdgp._flight.channels import CHANNELS, COEFFICIENTS, HAT, LENGTHS

RESERVED = {*CHANNELS, *COEFFICIENTS, *(f"{name}{HAT}" for name in LENGTHS)}
"""Names of the vocabulary: another column is never written under one of them."""


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return the identifier of each name: ASCII letters, digits and underscores, no digit first, all different.

    An identifier stays as it is. Accents are left out, other characters become underscores, and
    names that would be equal get numbers.
    """
    names = list(dict.fromkeys(names))
    written = {name: name for name in names if re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)}
    taken = RESERVED | written.keys()
    for name in names:
        if name not in written:
            letters = unicodedata.normalize("NFKD", name)
            short = re.sub(
                r"\W+",
                "_",
                "".join(c for c in letters if not unicodedata.combining(c)),
                flags=re.ASCII,
            )
            short = f"_{short}" if short[:1].isdigit() or not short else short
            numbered = (f"{short}_{k}" if k > 1 else short for k in count(1))
            written[name] = next(candidate for candidate in numbered if candidate not in taken)
            taken.add(written[name])
    return written


def changes_text(names: Mapping[str, str]) -> str:
    r"""Return which names are written in another way, such as '"flap left" is flap_left'; "" if none is.

    The text is ASCII and ends no comment of C or XML: the names are strings of JSON, their signs as
    ``\u002a``.
    """

    def escaped(sign):
        return f"\\u{ord(sign[0]):04x}" if sign[0].isascii() else json.dumps(sign[0])[1:-1]

    changed = {name: short for name, short in names.items() if name != short}
    quoted = (re.sub(r"[^A-Za-z0-9_ ]", escaped, name) for name in changed)
    return ", ".join(
        f'"{name}" is {short}' for name, short in zip(quoted, changed.values(), strict=True)
    )


def extra(package: str) -> Any:
    """Return a package of the extra ``export``; raise ImportError if it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f'This needs {package}, which is not installed: pip install "skdgp[export]".'
        ) from error
