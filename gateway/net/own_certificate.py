"""The pages' own certificate (`hmi.tls_cert = "auto"`): self-signed, for the names and addresses of this machine. IO.

It is made anew when the machine has a further name or address, and before it ends; its key stays. An address that the
machine has no more is no reason: browsers would ask again whether they may trust it each time a cable was unplugged.
"""

import logging
import threading
from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes

from gateway.certs import issue
from gateway.certs.client_certificate import validity_of
from gateway.certs.folder import Folder
from gateway.clock import Clock
from gateway.config.sections.hmi import LOOPBACK_NAMES
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.net.own_host import own_addresses, own_names
from gateway.net.tls import TlsFiles

log = logging.getLogger(__name__)

SUBJECT = "Loading gateway"
DAYS = 825
_ONE = threading.Lock()  # the task and the first visit may make it at the same time


def keep(files: TlsFiles, clock: Clock) -> None:
    """Makes key and certificate where they are missing or no longer right. Raises ConfigError, OSError."""
    with _ONE:
        _keep(files, clock)


def _keep(files: TlsFiles, clock: Clock) -> None:
    path = Path(files.cert)
    folder, name = Folder(path.parent), path.stem
    hosts = list(dict.fromkeys((*own_names(), *own_addresses(), *LOOPBACK_NAMES)))
    wall_ns = clock.wall_ns()
    try:
        key = folder.key(name)
        if (key_file := Path(files.key)).stat().st_mode & 0o077:
            key_file.chmod(0o600)  # whatever a restored copy has
    except ConfigError:
        folder.create()
        key = issue.new_key()
        folder.replace_key(name, key)
    if _is_right(folder, name, key, hosts, wall_ns):
        return
    made = issue.self_signed(SUBJECT, hosts, key, _time(wall_ns), DAYS)
    folder.replace_certificate(name, made)
    digest = made.fingerprint(hashes.SHA256()).hex(":")
    log.info("hmi: a certificate was made for %s; its SHA-256 is %s", ", ".join(hosts), digest)


def _is_right(folder: Folder, name: str, key: issue.Key, hosts: Collection[str], wall_ns: int) -> bool:
    try:
        made = folder.certificate(name)
        named = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (ConfigError, x509.ExtensionNotFound):
        return False
    has = {*named.get_values_for_type(x509.DNSName), *map(str, named.get_values_for_type(x509.IPAddress))}
    begun = made.not_valid_before_utc <= _time(wall_ns)
    ends = validity_of(made).expiring(wall_ns)
    return made.public_key() == key.public_key() and begun and not ends and has.issuperset(hosts)


def _time(wall_ns: int) -> datetime:
    return datetime.fromtimestamp(wall_ns // NS_PER_S, UTC)
