"""``python -m skdgp``."""

import os
import signal
import sys


def _stop(number, frame):
    """End at once: an exception would be lost, or shown with its traceback, in one of a thousand imports."""
    os.write(2, b"stopped\n")
    os._exit(130)


if __name__ == "__main__":
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else Ctrl-C is ignored, as in the background
    if ours:
        signal.signal(signal.SIGINT, _stop)
    from skdgp._cli import main

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main())
