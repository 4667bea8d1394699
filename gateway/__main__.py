"""`python -m gateway` is `gateway`."""

import sys

from gateway import interrupts


def main() -> int:
    """The exit code; 130 after Ctrl-C, also while modules are still imported."""
    try:
        interrupts.keep()
        from gateway.cli import main as verbs  # noqa: PLC0415

        return verbs()
    except KeyboardInterrupt:
        return 130
    except Exception:
        if interrupts.asked():  # a library has made another error of it, as pydantic does while it builds a model
            return 130
        raise


if __name__ == "__main__":
    sys.exit(main())
