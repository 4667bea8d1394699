"""`gateway VERB`: one module a verb, each with NAME, HELP, `configure(parser)` and `main(args) -> exit code`."""

import argparse
import errno
import sys
from collections.abc import Sequence
from importlib import import_module

from gateway import __version__
from gateway.cli.output import flushed
from gateway.errors import ConfigError, GatewayError

VERBS = (
    "run",
    "simulate",
    "check",
    "doctor",
    "firmware",
    "bundle",
    "backup",
    "restore",
    "update",
    "detect",
    "evaluate",
    "benchmark",
    "tune",
    "calibrate",
    "replay",
    "why",
    "export",
    "records",
    "registers",
    "state",
    "certs",
    "mqtt",
    "password",
)

EPILOG = """\
first steps:
  gateway simulate                  a loading bay with no hardware at all; poll it with any Modbus client
  gateway check config/gateway.toml check a configuration, list its faults
  gateway doctor config/gateway.toml open and measure what it names, and say what is wrong
  gateway run config/gateway.toml   the real thing
exit codes: 0 done, 1 failed, 2 a file or an argument must be edited
"""


def main(argv: Sequence[str] | None = None) -> int:
    """The exit code. The buffers are written here, and not by the interpreter at its end."""
    try:
        code = _run_verb(argv)
    except SystemExit:  # argparse: --help, --version, a wrong argument
        if not _output_lost():
            raise
        return 1
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        _output_lost(error)
        return 1
    return 1 if _output_lost() else code


def _output_lost(known: OSError | None = None) -> bool:
    """Has output been lost? A reader that has closed its end (`gateway detect ... | head`) is not reported."""
    errors = [error for error in (known, flushed(sys.stdout), flushed(sys.stderr)) if error is not None]
    reported = [error for error in errors if not isinstance(error, BrokenPipeError)]
    if reported:
        print(f"gateway: the output cannot be written: {reported[0].strerror}", file=sys.stderr)
    return bool(errors)


def _run_verb(argv: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(
        prog="gateway",
        description="Reports to a loading-control PLC when a truck's filling port is under the loading spout.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gateway {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name in VERBS:
        # OpenCV takes a while to load: each verb module keeps its heavy imports inside `main`.
        module = import_module(f"gateway.cli.{name}")
        verb = verbs.add_parser(
            module.NAME,
            help=module.HELP,
            description=module.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(verb)
        verb.set_defaults(main=module.main)
    args = parser.parse_args(argv)
    try:
        return int(args.main(args))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except GatewayError as error:
        print(f"gateway {args.verb}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:  # the long-running verbs end by themselves on Ctrl-C; this is for the short ones
        return 130
