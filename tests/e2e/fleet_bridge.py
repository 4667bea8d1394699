"""The bridges of docs/fleet.md, word for word but for addresses and secrets, as lines of mosquitto.conf."""

import re
from collections.abc import Sequence
from pathlib import Path

from tests.e2e.brokers import Address

PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"
NOT_HERE = ("bridge_cafile", "remote_username", "remote_password")  # no TLS and no users between these two
OURS = ("persistence ", "persistence_location", "autosave_interval", "max_queued_messages")  # the helper's own


def bridge_lines(cluster_port: int, **changes: str) -> list[str]:
    """What the page has an integrator add to mosquitto.conf. `changes`: other values of options."""
    first, _ = _blocks()
    values = {"address": f"127.0.0.1:{cluster_port}", "restart_timeout": "1", **changes}
    # In flight as by default: the helper has no limit, which a bridge does not bear.
    return ["max_inflight_messages 20", *(f"{name} {values.get(name, value)}" for name, value in _options(first))]


def nats_bridge_lines(nodes: Sequence[Address]) -> list[str]:
    """The same for a cluster of nats-servers: with what the page changes for them."""
    first, second = _blocks()
    changes = dict(_options(second)) | {"restart_timeout": "1"}
    changes["address"] = " ".join(f"{node.host}:{node.port}" for node in nodes)
    in_flight = f"max_inflight_messages {changes.pop('max_inflight_messages')}"
    lines = [f"{name} {changes.get(name, value)}" for name, value in _options(first)]
    at = lines.index("connection to-cluster") + 1
    new = [f"{name} {value}" for name, value in changes.items() if name not in dict(_options(first))]
    return [in_flight, *lines[:at], *new, *lines[at:]]


def _blocks() -> list[str]:
    return re.findall(r"```conf\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def _options(block: str) -> list[tuple[str, str]]:
    """Names and values, less comments and what is not for these tests."""
    found = []
    for line in block.splitlines():
        option = line.split("#")[0].strip() if not line.startswith("topic") else re.sub(r" +# .*", "", line)
        name, _, value = option.partition(" ")
        if option and name not in NOT_HERE and not option.startswith(OURS):
            found.append((name, value))
    return found
