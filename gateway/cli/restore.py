"""Put what `gateway backup` has kept onto this machine: checked as a whole before anything is written.

Every digest is compared, and the configuration is checked with the certificates of the archive, as by `gateway check`.
The gateway must not run. What exists with other contents is replaced with --force only, and is kept beside
(`gateway.toml.before-20260102T030405`); bay files that exist stay as they are.

examples:
  gateway restore north.tar.gz --dry-run     what would be written
  gateway restore north.tar.gz
"""

import argparse
from pathlib import Path

from gateway import config_check
from gateway.backup import restore
from gateway.errors import ConfigError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("archive", type=Path, metavar="FILE.tar.gz")
    parser.add_argument("--dry-run", action="store_true", help="write nothing; list what would be written")
    parser.add_argument("--force", action="store_true", help="replace what exists with other contents")
    parser.add_argument(
        "--outside", action="store_true", help="also write outside the folders of the configuration and of the state"
    )


def main(args: argparse.Namespace) -> int:

    made = restore.plan(args.archive, config_check.check, force=args.force, outside=args.outside)
    manifest = made.manifest
    print(
        f"{args.archive}: of {manifest.host}, {manifest.made} UTC, gateway {manifest.gateway_version}, "
        f"site {manifest.site}, instance {manifest.instance}: whole"
    )
    for title, entries in (("new", made.new), ("replace", made.replaced), ("keep", made.kept)):
        for entry in entries:
            print(f"{title:8} {entry.path}")
    for note in made.notes:
        print(f"note     {note}")
    if made.faults:
        raise ConfigError("\n".join((*made.faults, "nothing was written")))
    if args.dry_run:
        return 0
    for path in restore.write(args.archive, made):
        print(f"kept     {path}")
    print(f"{len(made.new) + len(made.replaced)} files written. Now: gateway check {manifest.config}")
    return 0
