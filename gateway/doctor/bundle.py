"""A bundle for support: what somebody far away must see, in one zip file, without passwords. IO.

Text is written without the passwords that the configuration and its files hold, wherever they occur. A recording that
has one (earlier versions kept a camera's in its head) is left out, and the contents say so.
"""

import json
import os
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_plus, urlsplit

import psutil

from gateway import __version__
from gateway.config import GatewayConfig
from gateway.config.strict.errors import is_secret, named_passwords
from gateway.doctor.examine import findings
from gateway.errors import SettingError
from gateway.files import plain_bytes, replacing
from gateway.passwords import one_line
from gateway.records import recorder_service as records
from gateway.records.names import PICTURES, PIN, SEGMENT, parsed
from gateway.sinks import registry

UNIT = "loading-gateway"
JOURNAL_LINES, JOURNAL_S = 20_000, 20.0
SEGMENTS, INCIDENTS = 4, 5  # the newest of each bay: an hour; pictures only where they are asked for
FILE_BYTES = 64_000_000  # a larger one is left out
SHORT = 4  # a value in an address that has fewer characters may occur anywhere: it is removed with its name only


def write(config: GatewayConfig, out: Path, seconds: float, *, pictures: bool) -> Iterator[str]:
    """Writes `out`, readable by its owner only, and yields a line for each part that is in it, or why it is not.

    Raises OSError.
    """
    secrets = list(secrets_of(config))
    contents = [f"gateway {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC", ""]
    with replacing(out) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in _texts(config, seconds):
            archive.writestr(name, _hidden(data, secrets))
            contents.append(f"{name}: {len(data)} bytes")
            yield contents[-1]
        for path, name in _recordings(config, pictures=pictures):
            contents.append(_add(archive, path, name, secrets))
            yield contents[-1]
        archive.writestr("contents.txt", "\n".join(contents) + "\n")


def secrets_of(config: GatewayConfig) -> Iterator[bytes]:
    """Every password that the configuration holds or names a file or variable of."""
    for value in _strings(config.model_dump(mode="json")):
        yield from _in_address(value)
    for user in config.hmi.users:
        yield user.password_hash.encode()
    for key, value in _named(config.sinks):
        if is_secret(key) and not key.endswith(("_file", "_env")) and isinstance(value, str) and value:
            yield value.encode()
    sections = [] if config.mqtt is None else [("mqtt", config.mqtt.model_dump())]
    sections += [("camera", bay.camera.model_dump()) for bay in config.bays]
    sections += [(f"sinks.{name}", dict(table)) for name, table in config.sinks.items()]
    for section, table in sections:
        for key, value in _named(table):
            if key.endswith("password_file") and isinstance(value, str):
                with suppress(SettingError):
                    yield one_line(f"{section}.{key}", value).encode()
            elif key.endswith("password_env") and isinstance(value, str) and (found := os.environ.get(value)):
                yield found.encode()


def _in_address(value: str) -> Iterator[bytes]:
    """As they are written there, and as they are meant: a log may have either."""
    with suppress(ValueError):
        if (found := urlsplit(value).password) and "://" in value:
            yield from {found.encode(), unquote(found).encode()}
    for name, found in named_passwords(value):
        if len(found) < SHORT:
            yield f"{name}={found}".encode()
        else:
            yield from {found.encode(), unquote(found).encode(), unquote_plus(found).encode()}


def _named(table: Any) -> Iterator[tuple[str, Any]]:
    """Each value with its key, however deep."""
    for key, value in table.items():
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, dict):
                yield from _named(item)
            else:
                yield key, item


def _strings(value: Any) -> Iterator[str]:
    match value:
        case str():
            yield value
        case dict():
            for item in value.values():
                yield from _strings(item)
        case list():
            for item in value:
                yield from _strings(item)


def _hidden(data: bytes, secrets: list[bytes]) -> bytes:
    for secret in sorted(secrets, key=len, reverse=True):
        data = data.replace(secret, b"***")
    return data


def _texts(config: GatewayConfig, seconds: float) -> Iterator[tuple[str, bytes]]:
    yield "settings.txt", "\n".join(f"{key} = {value}" for key, value in registry.shown_settings(config)).encode()
    yield "doctor.jsonl", "\n".join(json.dumps(asdict(finding)) for finding in findings(config, seconds)).encode()
    yield "machine.json", json.dumps(_machine(), indent=1).encode()
    yield "journal.txt", _journal()


def _machine() -> dict[str, object]:
    names = (("/etc/os-release", "os"), ("/proc/cpuinfo", "processors"))
    texts = {name: Path(path).read_text(errors="replace") for path, name in names if Path(path).exists()}
    processes = [
        {"pid": p.pid, "name": p.name(), "cpu_s": sum(p.cpu_times()[:2]), "rss": p.memory_info().rss}
        for p in psutil.process_iter()
        if _is_ours(p)
    ]
    return {
        **texts,
        "memory": psutil.virtual_memory()._asdict(),
        "boot": datetime.fromtimestamp(psutil.boot_time(), UTC).isoformat(),
        "temperatures": {name: [t.current for t in found] for name, found in psutil.sensors_temperatures().items()},
        "processes": processes,
    }


def _is_ours(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        return process.name().startswith(("gw-", "gateway"))
    return False


def _journal() -> bytes:
    """What the service has logged."""
    program = shutil.which("journalctl")
    if program is None:
        return b"(no journalctl on this machine)"
    command = [program, f"--unit={UNIT}", f"--lines={JOURNAL_LINES}", "--output=short-iso", "--no-pager", "--quiet"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=JOURNAL_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"(journalctl failed: {error})".encode()
    return done.stdout or b"(nothing logged by the unit, or not readable by this user: " + done.stderr.strip() + b")"


def _recordings(config: GatewayConfig, *, pictures: bool) -> Iterator[tuple[Path, str]]:
    """Path and name in the bundle: the newest hour; of the newest incidents, and of the newest that somebody keeps, the
    segment in which each of them is, and its pictures."""
    folder = records.folder_of(config)
    if folder is None:
        return
    for bay in config.bays:
        with suppress(OSError):
            paths = list((folder / bay.name).iterdir())
            pinned = {path.name.removesuffix(PIN) for path in paths if path.name.endswith(PIN)}
            files = sorted((name, path) for path in paths if (name := parsed(path.name)) is not None)
            segments = [(name, path) for name, path in files if name.kind == SEGMENT]
            incidents = [(name, path) for name, path in files if name.kind == PICTURES]
            kept = [(name, path) for name, path in incidents if path.name in pinned]
            chosen = {*incidents[-INCIDENTS:], *kept[-INCIDENTS:]}
            wanted = {path for _, path in segments[-SEGMENTS:]}
            for incident, path in chosen:
                # Numbers count up whatever the clock does.
                wanted.update([one for name, one in segments if name.number < incident.number][-1:])
                wanted.update([path] if pictures else [])
            for path in sorted(wanted):
                yield path, f"records/{bay.name}/{path.name}"


def _add(archive: zipfile.ZipFile, path: Path, name: str, secrets: list[bytes]) -> str:
    try:
        data = plain_bytes(path, FILE_BYTES + 1)
    except OSError as error:
        return f"{name}: left out, {error.strerror}"
    if len(data) > FILE_BYTES:
        return f"{name}: left out, larger than {FILE_BYTES // 1_000_000} MB"
    if any(secret in data for secret in secrets):
        return f"{name}: left out, its head has a password"
    archive.writestr(name, data, zipfile.ZIP_STORED)
    return f"{name}: {len(data)} bytes"
