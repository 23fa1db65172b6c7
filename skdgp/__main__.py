"""The command ``skdgp``, also as ``python -m skdgp``."""

import os
import signal
import sys


def _stop(number, frame):
    """Exit immediately: during imports an exception could be lost, or shown with its traceback."""
    os.write(2, b"stopped\n")
    os._exit(130)


def run() -> None:
    """Run the command line and exit; Ctrl-C also stops it while it imports the package."""
    # Otherwise Ctrl-C is ignored, as in the background.
    handles_ctrl_c = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if handles_ctrl_c:
        signal.signal(signal.SIGINT, _stop)
    from skdgp._cli import main

    if handles_ctrl_c:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main())


if __name__ == "__main__":
    run()
