"""A small authority: makes its own certificate, and those of servers and clients. Keys are ECDSA P-256 or RSA. Pure but
for the random numbers.

One level: the authority signs everything itself. It can sign nothing but end entities (path length 0), a server's
certificate can't be used by a client nor the other way round (extended key usage).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from ipaddress import ip_address
from typing import Literal

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.certs.client_certificate import role_extension

Key = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey
KeyType = Literal["ec", "rsa"]
CLOCKS_DIFFER = timedelta(hours=1)  # valid a little earlier than now: a PLC's clock may be behind
RSA_BITS = 3072


@dataclass(frozen=True, slots=True)
class Authority:
    """What signs: certificate and key."""

    certificate: x509.Certificate
    key: Key


def new_key(kind: KeyType = "ec") -> Key:
    if kind == "rsa":
        return rsa.generate_private_key(public_exponent=65537, key_size=RSA_BITS)
    return ec.generate_private_key(ec.SECP256R1())


def authority(name: str, key: Key, now: datetime, days: int) -> x509.Certificate:
    """A self-signed authority. Raises ValueError for a name that X.509 can't hold."""
    subject = _name(name)
    builder = _begin(subject, subject, key, now, now + timedelta(days=days))
    return (
        builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(authority=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )


def server(
    by: Authority, name: str, hosts: Sequence[str], key: Key, now: datetime, days: int, uri: str = ""
) -> x509.Certificate:
    """For the gateway: `hosts` are the names and addresses by which clients reach it. `uri`: for OPC UA, its
    application URI."""
    builder = _end_entity(by, name, key, now, days, ExtendedKeyUsageOID.SERVER_AUTH, uri)
    return builder.add_extension(_alternatives(hosts, uri), critical=False).sign(by.key, hashes.SHA256())


def self_signed(name: str, hosts: Sequence[str], key: Key, now: datetime, days: int) -> x509.Certificate:
    """As `server`, where nobody signs."""
    subject = _name(name)
    builder = _begin(subject, subject, key, now, now + timedelta(days=days))
    alternatives = x509.SubjectAlternativeName([_general_name(host) for host in hosts])
    return (
        _of_end_entity(builder, ExtendedKeyUsageOID.SERVER_AUTH)
        .add_extension(alternatives, critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )


def client(
    by: Authority, name: str, role: str | None, key: Key, now: datetime, days: int, uri: str = ""
) -> x509.Certificate:
    """For a client. `role` None: one that may do nothing. `uri` as in `server`."""
    builder = _end_entity(by, name, key, now, days, ExtendedKeyUsageOID.CLIENT_AUTH, uri)
    if uri:
        builder = builder.add_extension(_alternatives((), uri), critical=False)
    if role is not None:
        builder = builder.add_extension(role_extension(role), critical=False)
    return builder.sign(by.key, hashes.SHA256())


def renewed(by: Authority, old: x509.Certificate, key: Key, now: datetime, days: int) -> x509.Certificate:
    """As `old`, for `key` and from `now` on: the same subject, role, hosts and use."""
    builder = _begin(old.subject, by.certificate.subject, key, now, _end(by, now, days))
    for kept in old.extensions:
        if not isinstance(kept.value, x509.SubjectKeyIdentifier | x509.AuthorityKeyIdentifier):
            builder = builder.add_extension(kept.value, kept.critical)
    return _identified(builder, by, key).sign(by.key, hashes.SHA256())


def revocations(
    by: Authority, old: x509.CertificateRevocationList | None, serial: int | None, now: datetime, days: int
) -> x509.CertificateRevocationList:
    """The revocation list: what `old` has, and `serial`."""
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(by.certificate.subject)
        .last_update(now - CLOCKS_DIFFER)
        .next_update(_end(by, now, days))
    )
    listed = {entry.serial_number: entry for entry in old or ()}
    if serial is not None and serial not in listed:
        listed[serial] = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now).build()
    for entry in listed.values():
        builder = builder.add_revoked_certificate(entry)
    return builder.sign(by.key, hashes.SHA256())


def _end_entity(
    by: Authority, name: str, key: Key, now: datetime, days: int, use: x509.ObjectIdentifier, uri: str
) -> x509.CertificateBuilder:
    builder = _begin(_name(name), by.certificate.subject, key, now, _end(by, now, days))
    return _identified(_of_end_entity(builder, use, opcua=bool(uri)), by, key)


def _of_end_entity(
    builder: x509.CertificateBuilder, use: x509.ObjectIdentifier, *, opcua: bool = False
) -> x509.CertificateBuilder:
    return (
        builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(authority=False, opcua=opcua), critical=True)
        .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
    )


def _identified(builder: x509.CertificateBuilder, by: Authority, key: Key) -> x509.CertificateBuilder:
    issuer = by.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    return builder.add_extension(
        x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False
    ).add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(issuer), critical=False)


def _begin(subject: x509.Name, issuer: x509.Name, key: Key, now: datetime, end: datetime) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCKS_DIFFER)
        .not_valid_after(end)
    )


def _end(by: Authority, now: datetime, days: int) -> datetime:
    """No certificate outlives the one that signed it."""
    return min(now + timedelta(days=days), by.certificate.not_valid_after_utc)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _alternatives(hosts: Sequence[str], uri: str) -> x509.SubjectAlternativeName:
    uris = [x509.UniformResourceIdentifier(uri)] if uri else []
    return x509.SubjectAlternativeName([*uris, *map(_general_name, hosts)])


def _usage(*, authority: bool, opcua: bool = False) -> x509.KeyUsage:
    """OPC UA's security policies encrypt with the certificate's own key (Part 6, 6.2.2)."""
    return x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=opcua,
        key_encipherment=opcua,
        data_encipherment=opcua,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
