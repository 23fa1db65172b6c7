"""The command ``skdgp``, also as ``python -m skdgp``."""

import sys


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code; Ctrl-C stops its imports, too."""
    try:
        from skdgp._cli import main as run_command
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130
    return run_command(argv)


if __name__ == "__main__":
    sys.exit(main())
