"""Print the Modbus register table, or export it for the tools of PLC and SCADA engineers.

gateway registers                               for reading in a terminal
gateway registers --format tcpou --config gateway.toml --host 10.1.2.3 --out plc/
gateway registers --format ignition --config gateway.toml --bay bay2 --host 10.1.2.3 --out tags.json
gateway registers --format st --site north --instance gateway --bay bay1:1 --bay bay2:2 --host 10.1.2.3 --out plc/

Every export is made from the same table and so fits the gateway that makes it. Programs also compare which bay answers:
unit id, and a number made of site, instance and bay name. --config takes all that, and how long a triggered measurement
and a driven vehicle at setpoint 0 may take, from the gateway's configuration;
without it, give them as they are there ([modbus] word_order and writes, [[bays]] name and unit_id, site, instance), or
the program reports the wrong bay (Diagnostic 13). docs/plc-integration.md describes the commissioning.
"""

import argparse
import sys
from pathlib import Path

from gateway import config
from gateway.errors import ConfigError
from gateway.modbus.exports.approach import WAIT_S, wait_s
from gateway.modbus.exports.registry import SUMMARY, export
from gateway.modbus.exports.target import Target, distinct

TEXT_FORMS = ("markdown", "csv", "json")


def configure(parser: argparse.ArgumentParser) -> None:
    """Adds this verb's arguments."""

    default = Target()
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--format", default="text", metavar="FORMAT", help="one of the formats below (default: text)")
    for name in TEXT_FORMS:
        form.add_argument(f"--{name}", dest="format", action="store_const", const=name, help=f"--format {name}")
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG.toml", help="the gateway's configuration; all of its bays, or each --bay"
    )
    parser.add_argument(
        "--bay",
        action="append",
        metavar="NAME[:UNIT]",
        help=f"of the bay (default: {default.bay}), and its unit id; several times for several bays",
    )
    parser.add_argument("--site", metavar="NAME", help=f"default: {default.site}, as in a configuration without it")
    parser.add_argument("--instance", metavar="NAME", help=f"default: {default.gateway}, as in one without it")
    parser.add_argument(
        "--host",
        default=default.host,
        metavar="ADDRESS",
        help=f"of the gateway, as the PLC reaches it (default: {default.host}, reserved for examples)",
    )
    parser.add_argument("--port", type=int, metavar="N", help=f"default: {default.port}")
    parser.add_argument("--unit-id", type=int, metavar="N", help=f"of a --bay without one (default: {default.unit_id})")
    parser.add_argument("--word-order", choices=("big", "little"), help="[modbus] word_order (default: big)")
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

    files = export(args.format, _targets(args))
    if args.out is not None:
        _write(files, args.out)
    elif len(files) == 1:
        sys.stdout.write(next(iter(files.values())))
    else:
        raise ConfigError(f"--format {args.format} makes {len(files)} files ({', '.join(files)}): give --out DIR")
    return 0


def _targets(args: argparse.Namespace) -> tuple[Target, ...]:
    """One target a bay. ConfigError for what no PLC could use, for two that are alike, and for a --bay that the
    configuration does not have."""

    settings = config.GatewayConfig() if args.config is None else config.load(args.config)
    known = {bay.name: bay.unit_id for bay in settings.bays}
    waits_s = [wait_s(bay.drive, bay.visit) for bay in settings.bays if bay.drive]
    modbus = settings.modbus
    targets = []
    for text in args.bay or known:
        name, colon, unit = text.partition(":")
        if colon and not unit.isdecimal():
            raise ConfigError(f"--bay: {text!r}: NAME or NAME:UNIT, where UNIT is 1 to 247")
        if args.config is not None and name not in known:
            raise ConfigError(f"--bay: {name!r}: {args.config} has {', '.join(known)}")
        fallback = known[name] if args.config is not None else Target().unit_id
        targets.append(
            Target(
                bay=name,
                host=args.host,
                port=args.port if args.port is not None else modbus.port,
                unit_id=int(unit) if colon else args.unit_id or fallback,
                word_order=args.word_order or modbus.word_order,
                writes=args.writes or modbus.writes,
                site=args.site or settings.site,
                gateway=args.instance or settings.instance,
                trigger_timeout_s=modbus.handshake.trigger_timeout_s,
                wait_s=max(waits_s, default=WAIT_S),
            )
        )
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
