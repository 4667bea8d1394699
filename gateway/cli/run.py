"""Run the gateway on the cameras, rangers and networks that a configuration file names.

examples:
  gateway check /etc/loading-gateway.toml      first: is the file right?
  gateway run /etc/loading-gateway.toml        until Ctrl-C or SIGTERM; stop stays on when it ends
  gateway run config/gateway.toml --view       with the terminal view
  gateway run config/gateway.toml --modbus-port 5020
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from gateway import app, config, config_check, event_loop
from gateway.cli import awaited_config, check, run_loop
from gateway.cli.in_place_restart import InPlaceRestart
from gateway.cli.output import LossyOutput
from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.config.strict.toml_file import read_toml
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.parts import Ports
from gateway.reload import ReloadRequests
from gateway.supervisor import Task
from gateway.systemd import notify_address
from gateway.web.host.startup import Startup


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG.toml")
    parser.add_argument("--modbus-port", type=int, metavar="PORT", help="instead of the file's; 0 picks a free one")
    parser.add_argument(
        "--mqtt-url", metavar="URL", help="instead of the file's: mqtt[s]://[user[:password]@]host[:port]"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="end by itself after so many seconds")
    parser.add_argument("--view", action="store_true", help="show the bays live in the terminal")


def overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Options that override the file."""
    over: dict[str, Any] = {}
    if args.modbus_port is not None:
        over["modbus"] = {"port": args.modbus_port}
    if args.mqtt_url is not None:
        over["mqtt"] = {"url": args.mqtt_url}
    return over


def main(args: argparse.Namespace) -> int:

    if args.duration is not None and not args.duration > 0:
        raise ConfigError(f"--duration {args.duration:g}: must be above 0")
    in_place_restart = InPlaceRestart()
    managed = bool(notify_address())  # asked now: the children must not have it

    def load() -> GatewayConfig:
        found = config.load(args.config, overrides(args))
        config_check.check(found, source=str(args.config), text=read_toml(args.config)[1])
        return found

    settings = awaited_config.wait_for_valid_config(load, args.config)
    lines = run_loop.setup_logging("warning" if args.view else settings.log_level, settings.log_format)
    clock = SystemClock()
    where = ""
    out = LossyOutput(sys.stdout)  # a reader that ends, or does not read, is no reason to stop the bays

    def started(now: app.Running) -> None:
        nonlocal where
        served = [f"Modbus TCP on {now.modbus_host}:{now.modbus_port}"] if settings.modbus.plain else []
        if now.modbus_tls_port is not None:
            served.append(f"Modbus/TCP Security on {now.modbus_host}:{now.modbus_tls_port}")
        if now.hmi_url is not None:
            served.append(f"pages on {now.hmi_url}")
        where = f"{', '.join(served)}, site {settings.site}"
        if not args.view:
            out.write(f"gateway runs: {where}\n")

    def extra_tasks(hub: Hub) -> list[Task]:
        if not args.view:
            return []
        from gateway.cli import view  # noqa: PLC0415 - and with it rich: seldom shown

        return [Task("view", view.TerminalView(settings, hub, clock, view.console(out, live=True), lambda: where).run)]

    try:
        event_loop.run(
            run_loop.serve(
                settings,
                Ports.of(settings),
                clock,
                duration_s=args.duration,
                on_started=started,
                extra_tasks=extra_tasks,
                source=str(args.config.resolve()),
                lines=lines,
                reload=ReloadRequests(load, (lambda _: None) if args.view else lines.set_level),
                startup=Startup(overrides=overrides(args), warnings=check.warnings),
                in_place_restart=in_place_restart,
            )
        )
    except ConfigError as error:
        if not managed:
            raise
        print(error, file=sys.stderr, flush=True)
        awaited_config.pause(args.config)
        return 2
    out.close()
    return 0
