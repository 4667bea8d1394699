"""Serve one page and /metrics for all bays whose gateways are heard over MQTT (docs/fleet.md). It can write to no bay.

  gateway fleet fleet.toml            until Ctrl-C
  gateway fleet fleet.toml --check    only say what is wrong with the file and its inventory

fleet.toml needs [mqtt] with the broker on which all gateways are heard, and [hmi] with who may see the page:

  inventory = "inventory.toml"
  [mqtt]
  url = "mqtts://broker.plants.example"
  [hmi]
  port = 8090
  without_login = "viewer"
"""

import argparse
import asyncio
import logging
import signal
from pathlib import Path

from gateway.cli.run_loop import setup_logging
from gateway.fleet import config, service
from gateway.fleet.postgresql_store import PostgresqlStore

log = logging.getLogger(__name__)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="FLEET.toml")
    parser.add_argument("--check", action="store_true", help="check the files, and end")


def main(args: argparse.Namespace) -> int:
    settings = config.load(args.config)
    folder = args.config.resolve().parent
    if args.check:
        if settings.on_server:
            PostgresqlStore(settings)
        expected = service.roster_of(settings, folder).expected
        listed = "no inventory" if expected is None else f"{len(expected)} gateways in the inventory"
        print(f"{args.config}: good. {listed}, page on {settings.hmi.host}:{settings.hmi.port}")
        return 0
    setup_logging("info")
    asyncio.run(_serve(settings, folder))
    return 0


async def _serve(settings: config.FleetConfig, folder: Path) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await service.serve(settings, folder, stop, lambda address: log.info("fleet page at %s", address))
