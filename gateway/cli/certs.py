"""Make the certificates for Modbus/TCP Security: a small authority, the gateway's certificate, one for each client.

A plant that has its own authority does not need this: see docs/modbus-security.md for what its certificates
must hold.

  gateway certs init certs                          the authority: certs/ca.pem, certs/ca.key
  gateway certs server --dir certs --host 10.0.0.5  the gateway's certificate, for the names its clients use
  gateway certs client plc1 --dir certs             a client that may write (--role operator)
  gateway certs client hmi1 --dir certs --role viewer   a client that may only read
  gateway certs server --dir certs --name opcua --uri urn:plant:gateway1    for the OPC UA server
  gateway certs list --dir certs                    what there is, its role, and how long it is good
  gateway certs renew plc1 --dir certs              the same again, good for longer, with the same key
  gateway certs revoke hmi1 --dir certs             revoke one: certs/crl.pem, for modbus.tls.crl

Nothing is overwritten but by renew and revoke. ca.key signs any certificate: keep it off the gateway, in a safe place.
"""

import argparse
import socket
from datetime import UTC, datetime
from pathlib import Path

from gateway.certs import issue
from gateway.certs.client_certificate import role_of
from gateway.certs.folder import CA, Folder, days_left
from gateway.clock import SystemClock
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError

CA_DAYS = 3650
DAYS = 825
SOON_DAYS = 60


def configure(parser: argparse.ArgumentParser) -> None:
    """Adds this verb's arguments."""
    acts = parser.add_subparsers(dest="act", metavar="ACT", required=True)

    def act(name: str, summary: str, *, days: int | None = None, folder: bool = True) -> argparse.ArgumentParser:
        made = acts.add_parser(name, help=summary, description=summary)
        if folder:
            made.add_argument("--dir", type=Path, default=Path("certs"), metavar="DIR", help="the authority's folder")
        if days is not None:
            made.add_argument("--days", type=_days, default=days, help=f"good for this time (default {days})")
        return made

    init = act("init", "make an authority", days=CA_DAYS, folder=False)
    init.add_argument("dir", type=Path, nargs="?", default=Path("certs"), metavar="DIR", help="default: certs")
    init.add_argument("--name", default="Loading gateway authority", help="the authority's name in its certificate")
    server = act("server", "make the gateway's certificate", days=DAYS)
    server.add_argument(
        "--host", action="append", metavar="HOST", help="name or address by which clients reach it; may be repeated"
    )
    server.add_argument("--name", default="gateway", help="file name and subject (default gateway)")
    client = act("client", "make a client's certificate", days=DAYS)
    client.add_argument("name", metavar="NAME", help="file name and subject, e.g. plc1")
    client.add_argument("--role", default="operator", help="operator may write, viewer only reads (default operator)")
    for made in (server, client):
        made.add_argument("--uri", default="", help="for OPC UA: the application URI; the key is RSA then")
    for made in (init, server, client):
        made.add_argument("--rsa", action="store_true", help="an RSA key instead of ECDSA P-256, for old equipment")
    act("list", "show every certificate with its role and its end")
    for name, summary in (("renew", "make the same certificate again, valid for longer"), ("revoke", "revoke one")):
        made = act(name, summary, days=DAYS if name == "renew" else CA_DAYS)
        made.add_argument("name", metavar="NAME", help="as the file is called, without .pem")


def main(args: argparse.Namespace) -> int:
    """Writes files, and prints what to copy where."""

    now = datetime.fromtimestamp(SystemClock().wall_ns() // NS_PER_S, UTC)
    acts = {"init": _init, "server": _server, "client": _client, "list": _list, "renew": _renew, "revoke": _revoke}
    return acts[args.act](args, Folder(args.dir), now)


def _init(args: argparse.Namespace, folder: Folder, now: datetime) -> int:

    folder.create()
    key = issue.new_key("rsa" if args.rsa else "ec")
    try:
        made = issue.authority(args.name, key, now, args.days)
    except ValueError as error:
        raise ConfigError(f"--name {args.name!r}: {error}") from error
    folder.add(CA, made, key)
    folder.replace_crl(issue.revocations(folder.authority(), None, None, now, args.days))
    print(f"{folder.certificate_path(CA)}: the authority; copy it to the gateway and to every client")
    print(f"{folder.key_path(CA)}: signs any certificate; keep it in a safe place, not on the gateway")
    _end(folder, CA, now)
    return 0


def _server(args: argparse.Namespace, folder: Folder, now: datetime) -> int:

    by = folder.authority()
    hosts = args.host or [socket.gethostname(), "localhost", "127.0.0.1", "::1"]
    key = issue.new_key("rsa" if args.rsa or args.uri else "ec")
    try:
        made = issue.server(by, args.name, hosts, key, now, args.days, args.uri)
    except ValueError as error:
        raise ConfigError(f"--name {args.name!r}, --host {hosts}: {error}") from error
    folder.add(args.name, made, key)
    print(f"for {', '.join(hosts)}. Copy to the gateway, and name them in its configuration:")
    if not args.uri:
        print("# for the Modbus server:")
    print("[opcua]" if args.uri else "[modbus.tls]")
    print(f'cert = "{folder.certificate_path(args.name)}"')
    print(f'key = "{folder.key_path(args.name)}"')
    print(f'ca = "{folder.certificate_path("ca")}"')
    print(f'crl = "{folder.crl_path}"')
    if not args.uri:
        print("# for the pages:")
        print("[hmi]")
        print(f'tls_cert = "{folder.certificate_path(args.name)}"')
        print(f'tls_key = "{folder.key_path(args.name)}"')
    _end(folder, args.name, now)
    return 0


def _client(args: argparse.Namespace, folder: Folder, now: datetime) -> int:

    by = folder.authority()
    key = issue.new_key("rsa" if args.rsa or args.uri else "ec")
    try:
        made = issue.client(by, args.name, args.role, key, now, args.days, args.uri)
    except ValueError as error:
        raise ConfigError(f"{args.name!r}, --role {args.role!r}: {error}") from error
    folder.add(args.name, made, key)
    print(f"role {args.role}. Copy to {args.name}, and nowhere else:")
    for path in (folder.certificate_path(args.name), folder.key_path(args.name), folder.certificate_path("ca")):
        print(f"  {path}")
    _end(folder, args.name, now)
    return 0


def _list(_: argparse.Namespace, folder: Folder, now: datetime) -> int:

    folder.authority()
    crl = folder.crl()
    for name in folder.names():
        found = folder.certificate(name)
        gone = crl is not None and crl.get_revoked_certificate_by_serial_number(found.serial_number) is not None
        left = days_left(found, now)
        state = "revoked" if gone else "EXPIRED" if left < 0 else f"{left} days left"
        note = "; renew it soon" if not gone and 0 <= left < SOON_DAYS else ""
        role = "authority" if name == "ca" else role_of(found) or "-"
        print(f"{name:<20} {role:<12} until {found.not_valid_after_utc:%Y-%m-%d}  {state}{note}")
    return 0


def _renew(args: argparse.Namespace, folder: Folder, now: datetime) -> int:

    if args.name == "ca":
        raise ConfigError("renew: an authority is not renewed; make a new one in another folder, and all certificates")
    by, old = folder.authority(), folder.certificate(args.name)
    if old.issuer != by.certificate.subject:
        raise ConfigError(f"{folder.certificate_path(args.name)}: was signed by another authority")
    folder.replace_certificate(args.name, issue.renewed(by, old, folder.key(args.name), now, args.days))
    print(f"{folder.certificate_path(args.name)}: was good until {old.not_valid_after_utc:%Y-%m-%d}; copy it again")
    _end(folder, args.name, now)
    return 0


def _revoke(args: argparse.Namespace, folder: Folder, now: datetime) -> int:

    by, found = folder.authority(), folder.certificate(args.name)
    folder.replace_crl(issue.revocations(by, folder.crl(), found.serial_number, now, args.days))
    print(f"{args.name}: revoked. Copy {folder.crl_path} to the gateway (modbus.tls.crl)")
    return 0


def _end(folder: Folder, name: str, now: datetime) -> None:

    found = folder.certificate(name)
    print(f"{name}: good until {found.not_valid_after_utc:%Y-%m-%d}, {days_left(found, now)} days")


def _days(text: str) -> int:
    days = int(text)
    if not 1 <= days <= 36500:
        raise argparse.ArgumentTypeError("1 to 36500 days")
    return days
