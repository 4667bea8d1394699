"""Keep a gateway's configuration, certificates, keys, users, languages and bay files in one file; it may run meanwhile.

The file has private keys and password hashes, and is readable by its owner only. With --no-secrets it has neither:
passwords are *** in the configuration. Events that wait for a broker and the index of the records are never in it.

examples:
  gateway backup /media/usb/bay-north.tar.gz
  gateway backup north.tar.gz --config gateway.toml --records
  gateway backup settings.tar.gz --no-secrets      for a repository, or for somebody else
  gateway restore /media/usb/bay-north.tar.gz      on a new machine
"""

import argparse
from pathlib import Path

from gateway.backup import archive
from gateway.errors import ConfigError

CONFIG = Path("/etc/loading-gateway/gateway.toml")


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("archive", type=Path, metavar="FILE.tar.gz")
    parser.add_argument("--config", type=Path, default=CONFIG, metavar="CONFIG.toml", help=f"default: {CONFIG}")
    parser.add_argument("--no-secrets", action="store_true", help="without private keys, passwords and their hashes")
    parser.add_argument("--overwrite", action="store_true", help="replace a file of this name, as for a daily backup")
    parser.add_argument("--records", action="store_true", help="with all recordings and kept pictures: may be large")


def main(args: argparse.Namespace) -> int:

    if args.archive.exists() and not args.overwrite:
        raise ConfigError(f"{args.archive}: exists, and was left as it is: name another file, or give --overwrite")
    made = archive.write(args.config, args.archive, secrets=not args.no_secrets, records=args.records)
    for entry in made.files:
        print(f"{entry.kind.value:13} {entry.path}  {entry.bytes} bytes")
    for what in made.left_out:
        print(f"left out      {what}")
    print(f"{args.archive}: {len(made.files)} files, {args.archive.stat().st_size / 1e6:.1f} MB, read back and whole")
    if not args.no_secrets:
        print("It has private keys and password hashes: keep it like a key.")
    return 0
