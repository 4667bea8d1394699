"""Collect what support needs into one zip file: settings, examination, log, machine, the newest recordings.

Passwords, their hashes and private keys are not in it: the settings are those of `gateway check --full`, and every
password that the configuration or its files hold is removed from the texts. Kept pictures only with --pictures.

examples:
  gateway bundle /etc/loading-gateway/gateway.toml
  gateway bundle gateway.toml --out case17.zip --pictures
"""

import argparse
from datetime import datetime
from pathlib import Path

from gateway import config
from gateway.cli.doctor import add_seconds, seconds_of
from gateway.doctor import bundle
from gateway.errors import ConfigError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG.toml")
    parser.add_argument("--out", type=Path, metavar="FILE.zip", help="default: loading-gateway-DATE.zip, here")
    parser.add_argument("--pictures", action="store_true", help="with the pictures kept round the newest incidents")
    add_seconds(parser)


def main(args: argparse.Namespace) -> int:

    seconds = seconds_of(args)
    out = args.out or Path(f"loading-gateway-{datetime.now():%Y%m%dT%H%M%S}.zip")
    try:
        for line in bundle.write(config.load(args.config), out, seconds, pictures=args.pictures):
            print(line, flush=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    print(f"{out}: {out.stat().st_size / 1e6:.1f} MB. Look into it before you send it.")
    return 0
