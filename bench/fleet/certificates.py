"""The plants' authority, and what it has signed: the brokers' certificate, each gateway's, those of who listens."""

import shutil
import ssl
from datetime import UTC, datetime
from pathlib import Path

from gateway.certs import issue
from gateway.certs.folder import CA, Folder

FIRST_DAYS, RENEWED_DAYS = 6, 90
BROKERS, READERS = "brokers", "readers"


class Certificates:
    """In a folder of the authority; a gateway's own lie in its root, too, as on a box."""

    def __init__(self, folder: Path, hosts: list[str]) -> None:
        self._folder = Folder(folder)
        self._folder.create()
        key = issue.new_key()
        self._folder.add(CA, issue.authority("plants", key, _now(), 3650), key)
        self._authority = self._folder.authority()
        key = issue.new_key()
        self._folder.add(BROKERS, issue.server(self._authority, BROKERS, hosts, key, _now(), FIRST_DAYS), key)
        self._client(READERS)
        self.ca = self._folder.certificate_path(CA)

    def _client(self, name: str) -> None:
        key = issue.new_key()
        self._folder.add(name, issue.client(self._authority, name, None, key, _now(), FIRST_DAYS), key)

    def pair(self, name: str) -> tuple[Path, Path]:
        """Certificate and key."""
        return self._folder.certificate_path(name), self._folder.key_path(name)

    def certificate(self, root: Path) -> Path:
        return root / "etc/loading-gateway/mqtt.pem"

    def key(self, root: Path) -> Path:
        return root / "etc/loading-gateway/mqtt.key"

    def make(self, root: Path) -> None:
        self._client(root.name)
        self._install(root)

    def renew(self, name: str) -> None:
        """With another key."""
        key = issue.new_key()
        new = issue.renewed(self._authority, self._folder.certificate(name), key, _now(), RENEWED_DAYS)
        self._folder.replace_key(name, key)
        self._folder.replace_certificate(name, new)

    def renew_box(self, root: Path) -> None:
        self.renew(root.name)
        self._install(root)

    def _install(self, root: Path) -> None:
        for source, target in zip(self.pair(root.name), (self.certificate(root), self.key(root)), strict=True):
            fresh = target.with_suffix(".new")
            shutil.copy(source, fresh)
            fresh.replace(target)

    @property
    def broker_option(self) -> str:
        """Of the table `mqtt` in a nats-server's configuration."""
        certificate, key = self.pair(BROKERS)
        return f'tls {{ cert_file: "{certificate}", key_file: "{key}", ca_file: "{self.ca}", verify: true }}'

    def context(self) -> ssl.SSLContext:
        """Of who listens."""
        found = ssl.create_default_context(cafile=str(self.ca))
        found.load_cert_chain(*self.pair(READERS))
        return found


def _now() -> datetime:
    return datetime.now(UTC)
