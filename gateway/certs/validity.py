"""What must be known of a client's certificate for as long as its connection stands. Pure."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from cryptography import x509

NS_PER_S = 1_000_000_000
_CRL = re.compile(rb"-----BEGIN X509 CRL-----.*?-----END X509 CRL-----", re.DOTALL)
Serial = tuple[x509.Name, int]
"""A certificate among all: the name of its issuer and its number."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Of one certificate. `until_ns`: Unix time, the last moment at which it is good."""

    serial: Serial
    until_ns: int


def standing(certificate: x509.Certificate) -> Standing:
    until_ns = int(certificate.not_valid_after_utc.timestamp()) * NS_PER_S
    return Standing((certificate.issuer, certificate.serial_number), until_ns)


def revoked(pem: bytes) -> frozenset[Serial]:
    """Every certificate that the lists in `pem` take back. Raises ValueError for a list that is damaged."""
    return frozenset(_revoked(pem))


def _revoked(pem: bytes) -> Iterator[Serial]:
    for found in _CRL.findall(pem):
        crl = x509.load_pem_x509_crl(found)
        for entry in crl:
            yield crl.issuer, entry.serial_number
