"""A server's certificate and its private key: loaded into a TLS context, and how long they are good. IO: reads them."""

import ssl
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509

from gateway.errors import ConfigError

Named = tuple[str, str]  # configuration key, file
WARN_DAYS = 30


def load_pair(context: ssl.SSLContext, cert: Named, key: Named) -> None:
    """Raises ConfigError, naming key and file, for files that can't be read, are no PEM or don't fit together."""
    for named in (cert, key):
        readable(named)
    try:
        context.load_cert_chain(cert[1], key[1], password=_no_passphrase)
    except (OSError, ValueError) as error:  # OSError: an SSLError, or somebody has taken the file away just now
        raise ConfigError(
            f"{cert[0]}: {cert[1]} and {key[0]} {key[1]}: not a certificate and its private key, "
            f"in PEM form, without a passphrase: {said(error)}"
        ) from error


def readable(named: Named) -> None:
    """Raises ConfigError, naming key and file, where it is not."""
    try:
        with Path(named[1]).open("rb") as file:
            file.read(1)
    except OSError as error:
        raise ConfigError(f"{named[0]}: cannot read {named[1]}: {error.strerror}") from error


def warnings(certs: Sequence[Named], key: Named, wall_ns: int) -> list[str]:
    """What should be mended soon: certificates about to expire, a key that others may read.

    Raises OSError or ValueError for files that can't be read.
    """
    found: list[str] = []
    now = datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC)
    if Path(key[1]).stat().st_mode & 0o077:
        found.append(f"{key[0]}: {key[1]} can be read by others; chmod 600")
    for name, path in certs:
        for certificate in x509.load_pem_x509_certificates(Path(path).read_bytes()):
            end = certificate.not_valid_after_utc
            if end < now:
                found.append(f"{name}: {path} expired on {end:%Y-%m-%d}: no client will connect; renew it")
            elif (end - now).days < WARN_DAYS:
                found.append(f"{name}: {path} expires on {end:%Y-%m-%d}, in {(end - now).days} days")
    return found


def stamps(*files: str | None) -> list[tuple[int, int] | None]:
    """Other than before: a file was written, replaced, put there or taken away."""
    found: list[tuple[int, int] | None] = []
    for name in files:
        try:
            stat = Path(name or "").stat()
            found.append((stat.st_mtime_ns, stat.st_ino))
        except OSError:
            found.append(None)
    return found


def said(error: Exception) -> str:
    """OpenSSL's reason in readable letters."""
    return str(getattr(error, "reason", None) or error).lower().replace("_", " ")


def _no_passphrase() -> str:
    raise ValueError("the key has a passphrase, and nobody would be there to type it")
