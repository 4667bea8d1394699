"""`gateway VERB`: one module a verb, each with `configure(parser)` and `main(args) -> exit code`."""

import argparse
import errno
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from gateway import __version__
from gateway.cli.output import flushed
from gateway.errors import ConfigError, GatewayError

VERBS = {
    "run": "serve the loading bays of a configuration file",
    "simulate": "run a simulated loading bay",
    "check": "check a configuration file",
    "doctor": "examine cameras, rangers, ports, certificates, clock and disk",
    "firmware": "put the ranger's firmware on an Arduino Uno",
    "bundle": "collect what support needs into one zip file, without passwords",
    "backup": "keep configuration, certificates, keys and state in one file",
    "restore": "put the files of a backup onto this machine",
    "update": "put another version into service, or go back to the one before",
    "detect": "find the marker in pictures and videos",
    "evaluate": "measure detection on labelled pictures",
    "benchmark": "compare detection methods on rendered bays",
    "tune": "propose thresholds and exposure from examples",
    "calibrate": "camera intrinsics from pictures of a board",
    "replay": "take the decisions of a recording again, by the same settings or by others",
    "why": "say why the outputs were as they were at a moment",
    "export": "write a recording as CSV, MCAP, labelled pictures or evidence",
    "records": "list what is recorded, search visits, prove that it is complete, or make its index anew",
    "registers": "print the Modbus register table, or export it for PLC and SCADA tools",
    "state": "print the shared state vector of a running gateway",
    "certs": "make certificates for Modbus/TCP Security",
    "fleet": "serve one page for all bays that are heard over MQTT",
    "mqtt": "list and clear what bays that are gone have left at the broker",
    "password": "make a user of the pages",
}
PICTURES = ("detect", "evaluate", "benchmark", "tune", "calibrate", "replay", "why", "export")  # verbs that decode some
# Read by OpenCV when it is loaded, so set before; the user's settings are kept. The pixel limit keeps a few bytes of
# hostile or broken file from requesting gigabytes; the decoders' own output would be mixed with ours.
_OPENCV = {
    "OPENCV_IO_MAX_IMAGE_PIXELS": str(1 << 28),
    "OPENCV_LOG_LEVEL": "SILENT",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
}

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


def _configure(name: str, verb: argparse.ArgumentParser) -> None:
    if name in PICTURES:
        for variable, value in _OPENCV.items():
            os.environ.setdefault(variable, value)
    module = import_module(f"gateway.cli.{name}")
    verb.description = module.__doc__
    module.configure(verb)
    verb.set_defaults(main=module.main)


def _run_verb(argv: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(
        prog="gateway",
        description="Reports to a loading-control PLC when a truck's filling port is under the loading spout.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gateway {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    words = sys.argv[1:] if argv is None else list(argv)
    asked = next((word for word in words if not word.startswith("-")), "")
    for name, summary in VERBS.items():
        verb = verbs.add_parser(name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter)
        if name == asked:  # only its module is loaded: OpenCV takes a while
            _configure(name, verb)
    args = parser.parse_args(words)
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
