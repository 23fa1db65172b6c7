"""The command line, ``python -m skdgp COMMAND``: a command is a function of a `Task`."""

from skdgp._cli._main import main

__all__ = ["main"]
