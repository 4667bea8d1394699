"""The contents of a certificate: validity, role and subject of a client's; and which certificates are revoked. Pure.

The role is the one of Modbus/TCP Security (MB-TCP-Security v36, 8.4): one UTF8String in an extension.
"""

import re
from collections.abc import Iterator

from cryptography import x509
from cryptography.x509.oid import NameOID

from gateway.certs.validity import DAY_NS, Serial, Validity
from gateway.durations import NS_PER_S

ROLE_OID = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
RENEWAL_DAYS = 30  # before its end, or a third of its lifetime, whichever is less
_UTF8_STRING = 0x0C
MAX_ROLE_BYTES = 127  # the short form of a length; a longer name is not a configured role
MAX_SHOWN = 200  # characters of a subject or a role
_CRL = re.compile(rb"-----BEGIN X509 CRL-----.*?-----END X509 CRL-----", re.DOTALL)


def validity_of(certificate: x509.Certificate) -> Validity:
    begin_ns, until_ns = (
        int(time.timestamp()) * NS_PER_S for time in (certificate.not_valid_before_utc, certificate.not_valid_after_utc)
    )
    renewal_ns = until_ns - min(RENEWAL_DAYS * DAY_NS, (until_ns - begin_ns) // 3)
    return Validity((certificate.issuer, certificate.serial_number), until_ns, renewal_ns)


def validities_in(pem: bytes) -> list[Validity]:
    """Of the certificates in `pem`. Raises ValueError where there is none."""
    return [validity_of(found) for found in x509.load_pem_x509_certificates(pem)]


def subject_of(certificate: x509.Certificate) -> str:
    """The common name, for people; the full subject where there is none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return printable(str(names[0].value) if names else certificate.subject.rfc4514_string())


def role_extension(role: str) -> x509.UnrecognizedExtension:
    """Raises ValueError for an empty or too long role."""
    text = role.encode()
    if not 1 <= len(text) <= MAX_ROLE_BYTES:
        raise ValueError(f"a role has 1 to {MAX_ROLE_BYTES} bytes in UTF-8")
    return x509.UnrecognizedExtension(ROLE_OID, bytes((_UTF8_STRING, len(text))) + text)


def role_of(certificate: x509.Certificate) -> str | None:
    """None: there is no role, or the extension is not a valid one."""
    try:
        found = certificate.extensions.get_extension_for_oid(ROLE_OID).value
    except (x509.ExtensionNotFound, x509.DuplicateExtension, ValueError):
        return None
    return decode_role(found.value) if isinstance(found, x509.UnrecognizedExtension) else None


def decode_role(der: bytes) -> str | None:
    """The role in the extension's bytes, strictly: one UTF8String, nothing after it."""
    if len(der) < 3 or der[0] != _UTF8_STRING or der[1] > MAX_ROLE_BYTES or len(der) != 2 + der[1]:
        return None
    try:
        return der[2:].decode()
    except UnicodeDecodeError:
        return None


def revoked(pem: bytes) -> frozenset[Serial]:
    """Every certificate in the revocation lists in `pem`. Raises ValueError for a list that is damaged."""
    return frozenset(_revoked(pem))


def _revoked(pem: bytes) -> Iterator[Serial]:
    for found in _CRL.findall(pem):
        crl = x509.load_pem_x509_crl(found)
        for entry in crl:
            yield crl.issuer, entry.serial_number


def printable(text: str) -> str:
    """One line of limited length: text of a certificate is written to the log, and must not look like a record."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:MAX_SHOWN])
