"""Look after what is retained at the broker of a configuration.

  gateway mqtt ghosts gateway.toml           list states, alarms and announcements of bays that no gateway serves
  gateway mqtt ghosts gateway.toml --clear   and delete them from the broker
  gateway mqtt ghosts gateway.toml --site old-name   those of a site that was renamed

A bay's message is a ghost where the status of its gateway does not list the bay, or where there is no such status and
the message is older than it says it is good for. The configured user must be permitted to read and write these topics.
exit codes: 0 none is left, 1 there are some, or no connection; 2 the configuration must be edited
"""

import argparse
import asyncio
from pathlib import Path

from gateway import config
from gateway.errors import ConfigError
from gateway.sinks.mqtt.ghosts import ghosts


def configure(parser: argparse.ArgumentParser) -> None:
    acts = parser.add_subparsers(dest="act", metavar="ACT", required=True)
    ghosts = acts.add_parser("ghosts", help="retained messages of bays that no gateway serves")
    ghosts.add_argument("config", type=Path, metavar="CONFIG.toml")
    ghosts.add_argument("--clear", action="store_true", help="delete them from the broker")
    ghosts.add_argument("--site", metavar="NAME", help="default: that of the configuration")


def main(args: argparse.Namespace) -> int:

    settings = config.load(args.config)
    if settings.mqtt is None:
        raise ConfigError(f"{args.config}: there is no [mqtt]")
    found = asyncio.run(ghosts(settings.mqtt, args.site or settings.site, settings.instance, clear=args.clear))
    for topic, why in sorted(found.items()):
        print(f"{topic}: {why}")
    print(f"retained messages of bays that are not served: {len(found)}{', cleared' if args.clear and found else ''}")
    return 1 if found and not args.clear else 0
