"""Names that every program reads, and packages of the extra."""

from __future__ import annotations

import importlib
import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

from skdgp._flight.channels import CHANNELS, COEFFICIENTS, HAT, LENGTHS

# Names of the vocabulary: another column is never written under one of them
RESERVED = {*CHANNELS, *COEFFICIENTS, *(f"{name}{HAT}" for name in LENGTHS)}


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return the identifier of each name: characters other than ASCII letters and digits become underscores.

    No digit is first. Raises ValueError if two names would be equal, or one a name of the
    vocabulary that it is not.
    """
    written = {name: re.sub(r"^(?=\d)|\W", "_", name, flags=re.ASCII) for name in names}
    numbers = Counter(written.values())
    alike = [
        name
        for name, short in written.items()
        if name != short and (numbers[short] > 1 or short in RESERVED)
    ]
    if alike:
        raise ValueError(
            f"Got {alike}, which are written {[written[name] for name in alike]}, as other columns "
            f"are: rename them in the flights, and learn again."
        )
    return written


def extra(package: str) -> Any:
    """Return a package of the extra ``export``; raise ImportError if it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f'This needs {package}, which is not installed: pip install "skdgp[export]".'
        ) from error
