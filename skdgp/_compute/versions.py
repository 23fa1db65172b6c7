"""Versions of what is installed."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version


def software_versions() -> dict[str, str]:
    """Return the versions of skdgp and of what its numbers depend on."""
    found = {"skdgp": "unknown", "python": platform.python_version()}
    for name in ("skdgp", "scikit-learn", "numpy", "scipy", "pandas"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a folder that was never installed
            continue
    return found
