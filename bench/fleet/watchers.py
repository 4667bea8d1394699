"""Who looks at the fleet: its page, as a process, and a VictoriaMetrics that scrapes it."""

import json
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from bench.fleet.certificates import READERS, Certificates
from tests.e2e.brokers import free_port, program
from tests.e2e.fleet_process import Fleet

PAGE = """\
inventory = "inventory.toml"
silent_s = 30
[mqtt]
urls = [{urls}]
urls_shuffled = true
[mqtt.tls]
ca_file = "{ca}"
cert_file = "{certificate}"
key_file = "{key}"
[hmi]
port = 0
without_login = "viewer"
"""
SCRAPE_S = 2
SCRAPE = """\
global: {{ scrape_interval: {every}s }}
scrape_configs:
  - job_name: fleet
    static_configs: [{{ targets: ["{target}"] }}]
"""


class FleetPage(Fleet):
    """`gateway fleet` on the cluster."""

    def __init__(self, folder: Path, urls: Sequence[str], certificates: Certificates) -> None:
        super().__init__(folder, "")
        certificate, key = certificates.pair(READERS)
        quoted = ", ".join(f'"{url}"' for url in urls)
        self._file.write_text(PAGE.format(urls=quoted, ca=certificates.ca, certificate=certificate, key=key))

    def online(self) -> int:
        return sum(row["life"] == "online" for row in self.rows())

    def deviating(self) -> list[str]:
        return [row["instance"] for row in self.rows() if row["deviates"]]

    def certificate_days(self) -> int:
        """The fewest of all gateways; 0: of one it is not known."""
        return min(row["certificate_days"] or 0 for row in self.rows())


class VictoriaMetrics:
    """A context manager: a server that scrapes the page's /metrics."""

    def __init__(self, folder: Path, page: str) -> None:
        self._folder = folder
        scrape = folder / "scrape.yml"
        scrape.write_text(SCRAPE.format(every=SCRAPE_S, target=page.removeprefix("http://")))
        self._address = f"127.0.0.1:{free_port()}"
        self._command = [
            program("victoria-metrics", "apt-get install victoria-metrics"),
            f"-storageDataPath={folder / 'victoria-metrics'}",
            f"-httpListenAddr={self._address}",
            f"-promscrape.config={scrape}",
            "-search.latencyOffset=1s",  # else a question has what was 30 s ago
        ]

    def __enter__(self) -> Self:
        log = (self._folder / "victoria-metrics.log").open("ab")
        with log:
            self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.wait(20)

    def value(self, query: str, timeout_s: float = 40.0) -> float:
        """Of the query, now; waits for a first sample."""
        address = f"http://{self._address}/api/v1/query?{urllib.parse.urlencode({'query': query})}"
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                with urllib.request.urlopen(address, timeout=10) as answer:
                    found = json.load(answer)["data"]["result"]
                if found:
                    return float(found[0]["value"][1])
            except OSError:
                pass  # it is not there yet
            assert time.monotonic() < deadline, f"no value of {query}"
            time.sleep(0.5)
