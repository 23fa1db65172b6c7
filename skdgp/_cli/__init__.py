"""The command line: ``python -m skdgp identify``, ``inspect`` and ``demo``."""

from skdgp._cli._main import main

__all__ = ["main"]
