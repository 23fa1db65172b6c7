"""The command line: ``python -m skdgp identify`` and ``python -m skdgp demo``."""

from skdgp._cli._main import main

__all__ = ["main"]
