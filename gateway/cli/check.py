"""Check a configuration file and show its effect.

Every fault is one line: file:line: key = value: what is wrong (allowed range). Exit code 2 if there is any.

examples:
  gateway check config/gateway.toml
  gateway check config/gateway.toml --full     every key with its value, defaults included
  gateway check config/gateway.toml --digest > config/gateway.toml.reviewed
                                               what identifies this configuration, for a fleet (docs/fleet.md)
  gateway check --keys                         every key there is: meaning, default, range (Markdown)
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from gateway import config, config_check
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, HmiConfig, reference
from gateway.config.digest import digest
from gateway.config.sections.ranger_profiles import PROFILES
from gateway.config.strict.errors import without_password
from gateway.config.strict.toml_file import read_toml
from gateway.errors import ConfigError
from gateway.net import tls
from gateway.sinks import registry as sink_registry
from gateway.vision.detect import registry
from gateway.web.host import releases


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG.toml")
    parser.add_argument("--full", action="store_true", help="print every key with its value, defaults included")
    parser.add_argument("--digest", action="store_true", help="print the digest of what it sets instead")
    parser.add_argument("--keys", action="store_true", help="print the table of all keys instead")


def _access(hmi: HmiConfig) -> str:
    """Who may do what on the pages, in words."""
    everybody = {
        "none": "nothing without a login",
        "driver": "the driver's display without a login",
        "viewer": "anybody may view",
        "technician": "anybody may do everything",
    }
    nobody = "no users: the first visitor makes one" if hmi.awaits_first_user else "no users"
    names = ", ".join(f"{user.name} ({user.role})" for user in hmi.users)
    return f"{everybody[hmi.without_login]}; {f'users: {names}' if names else nobody}"


def warnings(settings: GatewayConfig) -> list[str]:
    """What is legal in the settings, and no good idea; one line each. Reads the pages' certificate and
    what was signed of the bays."""

    from gateway.doctor import settings as doctor_settings  # noqa: PLC0415 - and with it NumPy: `gateway run` has none

    hmi = settings.hmi
    files = None if hmi.own_certificate else tls.TlsFiles.of_pages(settings)
    pages = (*hmi.warnings(), *tls.warnings(files, SystemClock().wall_ns())) if hmi.enabled else ()
    released = (f"bay {bay}: {why}" for bay, why in releases.warnings(settings))
    return [*settings.modbus.warnings(), *doctor_settings.warnings(settings), *released, *pages]


def main(args: argparse.Namespace) -> int:

    if args.keys:
        print(reference.markdown(sink_registry.sections()), end="")
        return 0
    if args.config is None:
        raise ConfigError("gateway check: name a configuration file, or use --keys")
    settings = config.load(args.config)
    document, text = read_toml(args.config)
    # A URL that could never work is a fault of the file, too.
    config_check.check(settings, source=str(args.config), text=text)
    config_check.check_languages(settings, source=str(args.config), text=text)
    sinks = tuple(sink_registry.settings_of(settings))
    if args.digest:
        print(digest(settings))
        return 0
    if args.full:
        print("\n".join(f"{key} = {value}" for key, value in sink_registry.shown_settings(settings)))
        return 0
    if not document:
        print(f"{args.config}: sets nothing, so every value is a default (gateway check --keys)")
    _describe(args.config, settings, [name for name, _ in sinks])
    return 0


def _describe(path: Path, settings: GatewayConfig, sinks: Sequence[str]) -> None:
    modbus = settings.modbus
    served = [f"Modbus TCP on {modbus.host}:{modbus.port}"] if modbus.plain else []
    if modbus.tls is not None:
        served.append(f"Modbus/TCP Security on {modbus.host}:{modbus.tls.port}")
    print(f"{path}: good. Site {settings.site}, {', '.join(served)},")
    if modbus.writes:
        roles = ", ".join(modbus.tls.write_roles) if modbus.tls else ""
        who = f"over TLS only, by role {roles}" if modbus.tls else f"by {', '.join(modbus.plc_addresses)}"
        print(f"  writes to the handshake block: {who}")
    for line in warnings(settings):
        print(f"  warning: {line}")
    others = "".join(f", {name}" for name in sinks)
    brokers = ", then ".join(map(without_password, settings.mqtt.brokers)) if settings.mqtt else "not used"
    print(f"  MQTT {brokers}{others}")
    if settings.hmi.enabled:
        hmi = settings.hmi
        print(f"  pages on {hmi.host}:{hmi.port}, {'with' if hmi.tls else 'without'} TLS, {_access(hmi)}")
    for bay in settings.bays:
        camera = without_password(bay.camera.url)
        rangers = ", ".join(f"ranger {sensor.port}" for sensor in bay.ranger.sensors)
        print(f"  bay {bay.name}: unit id {bay.unit_id}, camera {camera}, {rangers}")
        for n, sensor in enumerate(bay.ranger.sensors, 1):
            if (found := PROFILES.get(sensor.profile)) is not None:
                values = ", ".join(f"{key} = {value}" for key, value in reference.flat(sensor) if key in found.names)
                print(f"  bay {bay.name}: ranger {n}, profile {sensor.profile}: {values}")
        if idle := registry.method(bay.vision.method).without_effect(bay.vision):
            print(f'  bay {bay.name}: no effect with vision.method = "{bay.vision.method}": {", ".join(idle)}')
