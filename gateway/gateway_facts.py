"""What the gateway says of itself: its configuration's digest, its update, certificates, pages and last visits.

IO: reads small files, every few seconds.

The digest of the reviewed configuration stands in a file beside the configuration, named as it with `.reviewed` behind:
who rolls out a reviewed file writes both (docs/fleet.md). Nothing is decided on it.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gateway import update_request
from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.config.digest import digest
from gateway.core.events import Event
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.files import plain_bytes
from gateway.net import own_host
from gateway.net.certificate_ends import CertificateEnds
from gateway.net.listener import url
from gateway.values.gateway_values import GatewayFacts

LOOK_NS = 5 * NS_PER_S
MAX_REVIEWED_BYTES = 1000


def reviewed_path(source: str) -> Path | None:
    """Of a configuration file; None: it was not read from one."""
    return Path(f"{source}.reviewed") if source else None


def reviewed_digest(path: Path | None) -> str:
    """What the file's first word says; empty: there is none, or it is no digest."""
    try:
        text = "" if path is None else plain_bytes(path, MAX_REVIEWED_BYTES).decode("ascii")
    except (OSError, ValueError):
        return ""
    found = re.match(r"([0-9a-f]{64})(\s|$)", text)
    return found[1] if found else ""


def pages_address(config: GatewayConfig) -> str:
    """Where the pages are opened from another machine; empty: they are not served, or at any free port."""
    hmi = config.hmi
    if not hmi.enabled or not hmi.port:
        return ""
    if hmi.own_hosts:
        address = own_host.page_urls(hmi.port)[0]
    else:
        address = url("https" if hmi.tls_cert else "http", (*hmi.allowed_hosts, hmi.host)[0], hmi.port)
    return f"{address.rstrip('/')}{hmi.base_path}/"


@dataclass(slots=True)
class FactsCollector:
    """`in_force`: the configuration in force now, the same object while it is the same; `source`: the file that it was
    read from, or empty."""

    in_force: Callable[[], GatewayConfig]
    source: str
    clock: Clock
    certificates: CertificateEnds
    _visits: dict[str, VisitSummary] = field(default_factory=dict)
    _facts: GatewayFacts = field(default_factory=GatewayFacts)
    _looked_ns: int | None = None
    _digest: tuple[GatewayConfig, str] | None = None  # of it: of many bays, it takes tens of milliseconds

    def note(self, event: Event) -> None:
        """A listener of the hub."""
        if event.summary is not None:
            self._visits[event.bay] = event.summary
            self._looked_ns = None

    def now(self) -> GatewayFacts:
        """Of LOOK_NS ago at most, and of the newest visit. Never waits but for small files on the local disk."""
        now_ns = self.clock.now_ns()
        if self._looked_ns is None or now_ns - self._looked_ns >= LOOK_NS:
            config, self._looked_ns = self.in_force(), now_ns
            update = update_request.shown_now(update_request.VERSIONS.with_name(update_request.SHOWN))
            self._facts = GatewayFacts(
                self._digest_of(config),
                reviewed_digest(reviewed_path(self.source)),
                update.stage,
                update.outcome,
                self.certificates.days_left(),
                pages_address(config),
                dict(self._visits),
            )
        return self._facts

    def _digest_of(self, config: GatewayConfig) -> str:
        if self._digest is None or self._digest[0] is not config:
            self._digest = config, digest(config)
        return self._digest[1]
