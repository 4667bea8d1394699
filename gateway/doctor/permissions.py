"""May this user use what the configuration names: devices, certificates, keys, password files? IO; opens nothing."""

import grp
import os
import pwd
from collections.abc import Iterator
from pathlib import Path

from gateway.config import GatewayConfig
from gateway.config.named_files import named_files
from gateway.files import device_at
from gateway.web.ipc.devices import Finding, Verdict


def permissions(config: GatewayConfig) -> Iterator[Finding]:
    """What does not exist is a finding of another part."""
    user = pwd.getpwuid(os.geteuid()).pw_name
    refused, tried = False, f"ask what user {user} may do"
    places = list(_places(config))
    for key, path, mode in places:
        if os.access(path, mode):
            continue
        refused = True
        yield Finding(
            "permission", key, Verdict.FAULT, tried, f"{path}: {_wanted(mode)} is refused", _remedy(path, user)
        )
    if not refused:
        result = f"devices and files that the configuration names: {len(places)}, all may be used"
        yield Finding("permission", "", Verdict.OK, tried, result)


def _places(config: GatewayConfig) -> Iterator[tuple[str, Path, int]]:
    """Key, path and what is needed, of those that exist."""
    for bay in config.bays:
        ports = [("ranger.port", sensor.port) for sensor in bay.ranger.sensors]
        for key, address in (("camera.url", bay.camera.url), *ports):
            device = device_at(address)
            if isinstance(device, Path) and device.is_relative_to("/dev") and device.exists():
                yield f"{bay.name} {key}", device, os.R_OK | os.W_OK
    for key, text, _ in named_files(config):
        path = Path(text)
        if os.path.lexists(path):
            yield key, path, os.R_OK


def _wanted(mode: int) -> str:
    return "reading and writing" if mode & os.W_OK else "reading"


def _remedy(path: Path, user: str) -> str:
    about = path.stat()
    try:
        group = grp.getgrgid(about.st_gid).gr_name
    except KeyError:
        group = str(about.st_gid)
    if about.st_mode & 0o040 and group != "root":
        return f"add the user to its group: usermod -aG {group} {user}, then start the service anew"
    return f"chgrp {user} {path}; chmod g+r {path}"
