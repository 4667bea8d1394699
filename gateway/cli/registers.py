"""Print the Modbus register table, or export it for the tools of PLC and SCADA engineers.

gateway registers                               for reading in a terminal
gateway registers --format ignition --host 10.1.2.3 --out tags.json
gateway registers --format st --bay bay2 --unit-id 2 --out plc/
gateway registers --format tcpou --bay bay1:1 --bay bay2:2 --host 10.1.2.3 --out plc/
gateway registers --format openplc --host 10.1.2.3 --writes --out openplc/

Every export is made from the same table and so fits the gateway that makes it. Give the bay's unit id and the word
order as in the gateway's configuration ([modbus] word_order, [[bays]] unit_id). docs/plc-integration.md describes the
commissioning.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.errors import ConfigError

if TYPE_CHECKING:
    from gateway.modbus.exports.target import Target

NAME = "registers"
HELP = "print the Modbus register table, or export it for PLC and SCADA tools"
TEXT_FORMS = ("markdown", "csv", "json")


def configure(parser: argparse.ArgumentParser) -> None:
    """Adds this verb's arguments."""
    from gateway.modbus.exports.registry import SUMMARY
    from gateway.modbus.exports.target import Target

    default = Target()
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--format", default="text", metavar="FORMAT", help="one of the formats below (default: text)")
    for name in TEXT_FORMS:
        form.add_argument(f"--{name}", dest="format", action="store_const", const=name, help=f"--format {name}")
    parser.add_argument(
        "--bay",
        action="append",
        metavar="NAME[:UNIT]",
        help=f"of the bay (default: {default.bay}), and its unit id; several times for several bays",
    )
    parser.add_argument(
        "--host",
        default=default.host,
        metavar="ADDRESS",
        help=f"of the gateway, as the PLC reaches it (default: {default.host}, reserved for examples)",
    )
    parser.add_argument("--port", type=int, default=default.port, metavar="N", help=f"default: {default.port}")
    parser.add_argument(
        "--unit-id",
        type=int,
        default=default.unit_id,
        metavar="N",
        help=f"of a --bay without one (default: {default.unit_id})",
    )
    parser.add_argument(
        "--word-order", choices=("big", "little"), default=default.word_order, help="[modbus] word_order (default: big)"
    )
    parser.add_argument(
        "--writes",
        action="store_true",
        help="[modbus] writes is on: OpenPLC then writes the handshake registers; the other formats look by themselves",
    )
    parser.add_argument(
        "--out",
        metavar="FILE|DIR/",
        help="write there instead of stdout: a file, a folder that exists, or a new one with a / at its end; files of"
        " an earlier export are replaced",
    )
    width = max(map(len, SUMMARY))
    formats = "\n".join(f"  {name.ljust(width)}  {what}" for name, what in SUMMARY.items())
    parser.epilog = f"formats:\n{formats}"


def main(args: argparse.Namespace) -> int:
    """Prints to stdout, or writes files and names them."""
    from gateway.modbus.exports.registry import export

    files = export(args.format, _targets(args))
    if args.out is not None:
        _write(files, args.out)
    elif len(files) == 1:
        sys.stdout.write(next(iter(files.values())))
    else:
        raise ConfigError(f"--format {args.format} makes {len(files)} files ({', '.join(files)}): give --out DIR")
    return 0


def _targets(args: argparse.Namespace) -> "tuple[Target, ...]":
    """One target a --bay. ConfigError for what no PLC could use, and for two that are alike."""
    from gateway.modbus.exports.target import Target, distinct

    targets = []
    for text in args.bay or [Target().bay]:
        name, colon, unit = text.partition(":")
        if colon and not unit.isdecimal():
            raise ConfigError(f"--bay: {text!r}: NAME or NAME:UNIT, where UNIT is 1 to 247")
        unit_id = int(unit) if colon else args.unit_id
        targets.append(Target(name, args.host, args.port, unit_id, args.word_order, args.writes))
    return distinct(tuple(targets))


def _write(files: dict[str, str], where: str) -> None:
    """One file to `where`, or into the folder `where`; several always into the folder. ConfigError where it can't."""
    out = Path(where)
    folder = len(files) > 1 or out.is_dir() or where.endswith("/")
    try:
        if folder:
            out.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            path = out / name if folder else out
            # Line ends as the format has them: Kepware's are CR LF.
            path.write_bytes(text.encode("utf-8"))
            print(path, file=sys.stderr)
    except OSError as error:
        raise ConfigError(f"--out {out}: {error.strerror or error}") from error
