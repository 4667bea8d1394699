"""When the certificates of the gateway's own servers end. IO: reads small files, once a minute."""

from collections.abc import Iterator

from gateway.certs.validity import Validity
from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.durations import NS_PER_S
from gateway.net.tls import TlsFiles, validities

LOOK_NS = 60 * NS_PER_S


class CertificateEnds:
    """Of Modbus/TCP Security, the pages and OPC UA, where they are served. Files that can't be read are left out: the
    server that reads them reports that."""

    def __init__(self, config: GatewayConfig, clock: Clock) -> None:
        self._clock = clock
        self._servers: dict[str, TlsFiles] = {}
        self._found: list[tuple[str, str, str, Validity]] = []  # server, key, path
        self._looked_ns: int | None = None
        self.use(config)

    def use(self, config: GatewayConfig) -> None:
        """Look at the files of this configuration from now on."""
        self._servers, self._looked_ns = {}, None
        if config.modbus.tls is not None:
            self._servers["modbus"] = TlsFiles.of_modbus(config.modbus.tls)
        if config.hmi.enabled and (pages := TlsFiles.of_pages(config)) is not None:
            self._servers["hmi"] = pages
        if (opcua := TlsFiles.of_opcua(config.opcua)) is not None:
            self._servers["opcua"] = opcua

    def days_left(self) -> dict[str, int]:
        """By server, of its certificate or authority that ends first, rounded down."""
        self._look()
        left: dict[str, int] = {}
        for server, _, _, found in self._found:
            days = found.days_left(self._clock.wall_ns())
            left[server] = min(days, left.get(server, days))
        return left

    def warning(self) -> str:
        """Which have expired, or should be renewed; empty: none."""
        self._look()
        wall_ns = self._clock.wall_ns()
        return "; ".join(
            f"{key}: {path} {text}" for _, key, path, found in self._found if (text := found.expiring(wall_ns))
        )

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        if self._looked_ns is None or now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._found = list(self._read())

    def _read(self) -> Iterator[tuple[str, str, str, Validity]]:
        for server, files in self._servers.items():
            for key, path in files.named():
                if key.endswith(("cert", "ca")):
                    try:
                        found = validities(path)
                    except (OSError, ValueError):
                        continue
                    yield from ((server, key, path, one) for one in found)
