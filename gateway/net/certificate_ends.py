"""When the certificates of the gateway's own servers end. IO: reads small files, once a minute."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.durations import NS_PER_S
from gateway.net.tls import WARN_DAYS, TlsFiles, ends

LOOK_NS = 60 * NS_PER_S
DAY = timedelta(days=1)


class CertificateEnds:
    """Of Modbus/TCP Security and of the pages, where they are served. Files that can't be read are left out: the server
    that reads them reports that."""

    def __init__(self, config: GatewayConfig, clock: Clock) -> None:
        self._clock = clock
        self._servers: dict[str, TlsFiles] = {}
        self._ends: list[tuple[str, str, str, datetime]] = []  # server, key, path, the last valid moment
        self._looked_ns: int | None = None
        self.use(config)

    def use(self, config: GatewayConfig) -> None:
        """Look at the files of this configuration from now on."""
        self._servers, self._looked_ns = {}, None
        if config.modbus.tls is not None:
            self._servers["modbus"] = TlsFiles.of_modbus(config.modbus.tls)
        if config.hmi.enabled and (pages := TlsFiles.of_pages(config.hmi)) is not None:
            self._servers["hmi"] = pages

    def days_left(self) -> dict[str, int]:
        """By server, of its certificate or authority that ends first, rounded down."""
        self._look()
        left: dict[str, int] = {}
        for server, _, _, end in self._ends:
            days = (end - self._now()) // DAY
            left[server] = min(days, left.get(server, days))
        return left

    def warning(self) -> str:
        """Which have expired, or will within WARN_DAYS; empty: none."""
        self._look()
        now = self._now()
        return "; ".join(
            f"{key}: {path} {'expired' if end < now else 'expires'} on {end:%Y-%m-%d}"
            for _, key, path, end in self._ends
            if end < now + WARN_DAYS * DAY
        )

    def _now(self) -> datetime:
        return datetime.fromtimestamp(self._clock.wall_ns() // NS_PER_S, UTC)

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        if self._looked_ns is None or now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._ends = list(self._read())

    def _read(self) -> Iterator[tuple[str, str, str, datetime]]:
        for server, files in self._servers.items():
            for key, path in files.named():
                if key.endswith(("cert", "ca")):
                    try:
                        found = ends(path)
                    except (OSError, ValueError):
                        continue
                    yield from ((server, key, path, end) for end in found)
