"""The role in a certificate: Modbus/TCP Security (MB-TCP-Security v36, 8.4), one UTF8String in an extension. Pure."""

from cryptography import x509

ROLE_OID = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
_UTF8_STRING = 0x0C
MAX_BYTES = 127  # of a role: the short form of a length; a longer name is no role anybody configured


def extension(role: str) -> x509.UnrecognizedExtension:
    """The extension that says `role`. Raises ValueError for an empty or too long one."""
    text = role.encode()
    if not 1 <= len(text) <= MAX_BYTES:
        raise ValueError(f"a role has 1 to {MAX_BYTES} bytes in UTF-8")
    return x509.UnrecognizedExtension(ROLE_OID, bytes((_UTF8_STRING, len(text))) + text)


def role_of(certificate: x509.Certificate) -> str | None:
    """The role that stands in `certificate`; None: there is none, or what stands there is no role."""
    try:
        found = certificate.extensions.get_extension_for_oid(ROLE_OID).value
    except (x509.ExtensionNotFound, x509.DuplicateExtension, ValueError):
        return None
    return decode(found.value) if isinstance(found, x509.UnrecognizedExtension) else None


def decode(der: bytes) -> str | None:
    """The role in the extension's bytes, strictly: one UTF8String, nothing after it."""
    if len(der) < 3 or der[0] != _UTF8_STRING or der[1] > MAX_BYTES or len(der) != 2 + der[1]:
        return None
    try:
        return der[2:].decode()
    except UnicodeDecodeError:
        return None
