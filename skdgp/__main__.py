"""The command ``skdgp``, also as ``python -m skdgp``."""

import sys


def run() -> None:
    """Run the command line and exit."""
    from skdgp._cli import main

    sys.exit(main())


if __name__ == "__main__":
    run()
