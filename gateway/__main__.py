"""`python -m gateway` is `gateway`."""

import sys


def main() -> int:
    """The exit code; 130 after Ctrl-C, also while modules are still imported."""
    try:
        from gateway.cli import main as verbs  # noqa: PLC0415

        return verbs()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
