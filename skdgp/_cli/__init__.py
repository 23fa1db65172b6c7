"""The command line, ``python -m skdgp COMMAND``: it parses, calls and prints."""

from skdgp._cli._main import main

__all__ = ["main"]
