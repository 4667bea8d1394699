"""Examine the plant round the gateway: open, measure and ask for what a configuration names.

One line for each: what was tried, what came back and, after ->, what to do. Nothing is changed, and nothing is sent to
the PLC. Cameras and rangers are opened, which only works while no gateway has them; one that runs with this
configuration is asked instead. Run by root on a configuration of the service, it takes the service's rights first.

examples:
  gateway doctor config/gateway.toml
  gateway doctor config/gateway.toml --seconds 30      sensors measured for longer
  gateway doctor config/gateway.toml --json            an object a line, for programs
exit codes: 0 no fault (there may be warnings), 1 a fault, 2 the configuration must be edited
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from gateway import config, config_check
from gateway.config.strict.toml_file import read_toml
from gateway.doctor import rights
from gateway.doctor.examine import findings
from gateway.errors import ConfigError
from gateway.web.ipc.devices import Verdict


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG.toml")
    add_seconds(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for programs")


def add_seconds(parser: argparse.ArgumentParser) -> None:
    """The option of every verb that examines."""
    parser.add_argument(
        "--seconds", type=float, default=10.0, metavar="S", help="how long each sensor is measured (default 10)"
    )


def seconds_of(args: argparse.Namespace) -> float:
    """Raises ConfigError."""
    if not 0.5 <= args.seconds <= 600:
        raise ConfigError(f"--seconds {args.seconds:g}: must be from 0.5 to 600")
    return float(args.seconds)


def main(args: argparse.Namespace) -> int:

    seconds = seconds_of(args)
    if user := rights.of_service(args.config):
        rights.become(user)
    settings = config.load(args.config)
    _, text = read_toml(args.config)
    config_check.check(settings, source=str(args.config), text=text)
    counts = dict.fromkeys(Verdict, 0)
    for finding in findings(settings, seconds):
        counts[finding.verdict] += 1
        print(json.dumps(asdict(finding)) if args.json else finding.line, flush=True)
    if not args.json:
        print(f"faults: {counts[Verdict.FAULT]}, warnings: {counts[Verdict.WARNING]}, ok: {counts[Verdict.OK]}")
    return 1 if counts[Verdict.FAULT] else 0
