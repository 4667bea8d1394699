"""The authority's folder: `ca.pem`, `ca.key`, `crl.pem`, and NAME.pem with NAME.key for each it has signed.

Keys are written with permissions 0600 before anything is in them. Nothing is overwritten but by `renew` and `revoke`,
which replace a file completely or not at all.
"""

import os
import re
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from gateway.certs.issue import Authority, Key
from gateway.errors import ConfigError

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
CA = "ca"


class Folder:
    """All methods raise ConfigError with the file's name and what to do."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def certificate_path(self, name: str) -> Path:
        return self.path / f"{_checked(name)}.pem"

    def key_path(self, name: str) -> Path:
        return self.path / f"{_checked(name)}.key"

    @property
    def crl_path(self) -> Path:
        return self.path / "crl.pem"

    def create(self) -> None:
        """Make the folder, readable by its owner only; it may exist."""
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot make the folder: {error.strerror}") from error

    def authority(self) -> Authority:
        if not self.certificate_path(CA).exists():
            raise ConfigError(f"{self.path}: no authority here (ca.pem); make one: gateway certs init {self.path}")
        return Authority(self.certificate(CA), self.key(CA))

    def certificate(self, name: str) -> x509.Certificate:
        path = self.certificate_path(name)
        try:
            return x509.load_pem_x509_certificate(_read(path))
        except ValueError as error:
            raise ConfigError(f"{path}: no certificate in PEM form: {error}") from error

    def key(self, name: str) -> Key:
        path = self.key_path(name)
        try:
            found = serialization.load_pem_private_key(_read(path), password=None)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{path}: no private key in PEM form without a passphrase: {error}") from error
        if not isinstance(found, ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
            raise ConfigError(f"{path}: neither an EC nor an RSA key")
        return found

    def crl(self) -> x509.CertificateRevocationList | None:
        if not self.crl_path.exists():
            return None
        try:
            return x509.load_pem_x509_crl(_read(self.crl_path))
        except ValueError as error:
            raise ConfigError(f"{self.crl_path}: no revocation list in PEM form: {error}") from error

    def names(self) -> list[str]:
        """Everything there is a certificate of, the authority first."""
        found = sorted(path.stem for path in self.path.glob("*.pem") if path.name not in ("ca.pem", "crl.pem"))
        return [CA, *found] if self.certificate_path(CA).exists() else found

    def add(self, name: str, certificate: x509.Certificate, key: Key) -> None:
        """Key first: a certificate without a key would be of no use."""
        for path in (self.key_path(name), self.certificate_path(name)):
            if path.exists():
                raise ConfigError(f"{path}: exists already; nothing is overwritten (gateway certs renew {name})")
        _write_new(self.key_path(name), _key_pem(key), 0o600)
        _write_new(self.certificate_path(name), certificate.public_bytes(serialization.Encoding.PEM), 0o644)

    def replace_certificate(self, name: str, certificate: x509.Certificate) -> None:
        _replace(self.certificate_path(name), certificate.public_bytes(serialization.Encoding.PEM))

    def replace_key(self, name: str, key: Key) -> None:
        _replace(self.key_path(name), _key_pem(key), 0o600)

    def replace_crl(self, crl: x509.CertificateRevocationList) -> None:
        _replace(self.crl_path, crl.public_bytes(serialization.Encoding.PEM))


def days_left(certificate: x509.Certificate, now: datetime) -> int:
    """Full days until it expires; negative: it has."""
    return (certificate.not_valid_after_utc - now).days


def _checked(name: str) -> str:
    if not NAME.fullmatch(name) or name == "crl":
        raise ConfigError(f"{name!r} is no name for a certificate (letters, digits, . _ -, at most 63; not crl)")
    return name


def _key_pem(key: Key) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read it: {error.strerror}") from error


def _write_new(path: Path, data: bytes, mode: int) -> None:
    try:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except OSError as error:
        raise ConfigError(f"{path}: cannot make it: {error.strerror}") from error
    try:
        with os.fdopen(fd, "wb") as file:
            file.write(data)
    except OSError as error:
        path.unlink(missing_ok=True)  # half a file would be in the way of the next try
        raise ConfigError(f"{path}: cannot write it: {error.strerror}") from error


def _replace(path: Path, data: bytes, mode: int = 0o644) -> None:
    fresh = path.with_name(path.name + ".new")
    fresh.unlink(missing_ok=True)
    _write_new(fresh, data, mode)
    fresh.replace(path)
