"""A server's certificate and its private key, loaded into a TLS context. IO: reads them."""

import ssl
from pathlib import Path

from gateway.errors import ConfigError

Named = tuple[str, str]  # configuration key, file


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


def said(error: Exception) -> str:
    """OpenSSL's reason in readable letters."""
    return str(getattr(error, "reason", None) or error).lower().replace("_", " ")


def _no_passphrase() -> str:
    raise ValueError("the key has a passphrase, and nobody would be there to type it")
