"""The certificates, keys and password files that a configuration names. Pure."""

from collections.abc import Iterator, Mapping
from typing import Any

from gateway.config import GatewayConfig

_SERVED = {
    ("modbus", "tls"): ("cert", "key", "ca", "crl"),
    ("hmi",): ("tls_cert", "tls_key"),
    ("opcua",): ("cert", "key", "ca", "crl"),
}
_PRIVATE = ("key", "tls_key", "key_file")


def named_files(config: GatewayConfig) -> Iterator[tuple[str, str, bool]]:
    """Of each its key, the path as it is written, and whether it holds a private key or a password."""
    for place, value in _leaves((), config.model_dump()):
        key = place[-1]
        if not isinstance(value, str) or not value or (place[-1] == "tls_cert" and config.hmi.own_certificate):
            continue
        if key in _SERVED.get(place[:-1], ()) or (key.endswith("_file") and key != "outbox_file"):
            yield ".".join(place), value, key in _PRIVATE or key.endswith("password_file")
    for path in dict.fromkeys(bay.camera.password_file for bay in config.bays):
        if path is not None:
            yield "camera.password_file", path, True


def _leaves(path: tuple[str, ...], value: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves((*path, str(key)), inner)
    elif path:
        yield path, value
