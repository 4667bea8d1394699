"""Sparkplug B payloads as decoders that others wrote read them: npm's sparkplug-payload and PyPI's pysparkplug."""

import base64
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


class UnreadableError(AssertionError):
    """The decoder failed; its last words."""


@dataclass(frozen=True, slots=True)
class ReadMetric:
    """What a host application gets of a metric. `datatype`: in capitals; empty: unknown to it."""

    name: str
    datatype: str
    value: Any
    timestamp_ms: int
    historical: bool


Decoder = Callable[[Sequence[bytes]], list[list[ReadMetric]]]


def sparkplug_payload(payloads: Sequence[bytes]) -> list[list[ReadMetric]]:
    """Of npm; what the nodes of Node-RED are made of. Raises UnreadableError."""
    if not (HERE / "node_modules" / "sparkplug-payload").is_dir():
        raise UnreadableError("sparkplug-payload is not installed: ./dev test installs it")
    return _read(["node", str(HERE / "decode.js")], payloads)


def pysparkplug(payloads: Sequence[bytes]) -> list[list[ReadMetric]]:
    """Of PyPI. Raises UnreadableError."""
    return _read([sys.executable, str(HERE / "decode.py")], payloads)


DECODERS: tuple[Decoder, ...] = (sparkplug_payload, pysparkplug)


def _read(command: list[str], payloads: Sequence[bytes]) -> list[list[ReadMetric]]:
    sent = json.dumps([base64.b64encode(payload).decode() for payload in payloads])
    done = subprocess.run(command, input=sent, capture_output=True, text=True, timeout=60, check=False)
    if done.returncode:
        raise UnreadableError(done.stderr[-2000:])
    return [[_metric(*row) for row in rows] for rows in json.loads(done.stdout)]


def _metric(name: str, datatype: str, value: Any, timestamp: Any, historical: bool) -> ReadMetric:
    return ReadMetric(name, datatype.upper(), _exact(value), _exact(timestamp), historical)


def _exact(value: Any) -> Any:
    return int(value["long"]) if isinstance(value, dict) else value
