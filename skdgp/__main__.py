"""The command ``skdgp`` as ``python -m skdgp``."""

import sys

from skdgp._cli import main

if __name__ == "__main__":
    sys.exit(main())
