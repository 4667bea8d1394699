"""Headers: Host and Origin of a request, and the security headers of every answer. Pure.

Host is checked against DNS rebinding: a foreign site whose name points to the gateway's address would be same-origin.
Origin is checked against foreign sites that send requests through the browser of a logged-in person.
"""

from collections.abc import Collection, Iterable
from urllib.parse import urlsplit

from gateway.config.sections.hmi import HmiConfig, host_name

Headers = Iterable[tuple[bytes, bytes]]
MAX_HEADER = 300  # of a Host or Origin that could be right
PORTS = {"http": 80, "https": 443}


def header(headers: Headers, name: bytes) -> str | None:
    """The one value of a header; None: there is none. Raises ValueError where it occurs twice or is not ASCII."""
    found = [value for key, value in headers if key == name]
    if not found:
        return None
    if len(found) > 1:
        raise ValueError(f"{name.decode()} occurs {len(found)} times")
    try:
        return found[0].decode("ascii")
    except UnicodeDecodeError:
        raise ValueError(f"{name.decode()} is no ASCII") from None


def host_and_port(authority: str, scheme: str) -> tuple[str, int]:
    """Of a Host header, compared as `hmi.hosts` writes them. Raises ValueError for anything else than host[:port]."""
    if not authority or len(authority) > MAX_HEADER or set(authority) & set("/\\@?# \t,"):
        raise ValueError("no host")
    name, bracket, tail = authority.rpartition("]")
    if bracket:  # [::1]:8080
        if not name.startswith("[") or (tail and not tail.startswith(":")):
            raise ValueError("no host")
        name, port = name[1:], tail[1:]
        if ":" not in name or set(name) & set("[]") or (tail and not port):
            raise ValueError("no host")
    else:
        name, colon, port = authority.partition(":")
        if colon and not port:
            raise ValueError("no port")
    if port and not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) <= 65535):
        raise ValueError("no port")
    return host_name(name), int(port) if port else PORTS[scheme]


def host_allowed(authority: str | None, hosts: Collection[str], scheme: str) -> bool:
    """Is this Host header one of ours? Its port is ignored: clients may use tunnels."""
    try:
        return authority is not None and host_and_port(authority, scheme)[0] in hosts
    except ValueError:
        return False


def same_origin(origin: str | None, authority: str, scheme: str) -> bool:
    """Is the requesting page one of those that the server at `authority` (a right Host header) has served?"""
    if origin is None or len(origin) > MAX_HEADER:
        return False
    try:
        parts = urlsplit(origin)
        if parts.scheme != scheme or f"{parts.scheme}://{parts.netloc}" != origin:
            return False
        return host_and_port(parts.netloc, scheme) == host_and_port(authority, scheme)
    except ValueError:
        return False


def safe_next(target: object) -> str:
    """Where to go after a login: a path of this server, or the start page. Never another site."""
    if not isinstance(target, str) or not target.startswith("/") or len(target) > MAX_HEADER:
        return "/"
    foreign = target.startswith(("//", "/\\")) or "\\" in target or not target.isprintable()
    return "/" if foreign else target


# Of the answers.

# Nothing from elsewhere, nothing inline, in no frame. blob: are the pages' own pictures.
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
PERMISSIONS_POLICY = (
    "accelerometer=(), camera=(), display-capture=(), geolocation=(), gyroscope=(), magnetometer=(), microphone=(), "
    "midi=(), payment=(), usb=(), fullscreen=(self), screen-wake-lock=(self)"
)
HSTS_S = 30 * 86_400
HTTPS_PORT = 443


def security_headers(config: HmiConfig) -> tuple[tuple[bytes, bytes], ...]:
    """Of every answer, refusals too. Names in lower case."""
    fields = {
        "content-security-policy": CONTENT_SECURITY_POLICY,
        "x-content-type-options": "nosniff",
        "x-frame-options": "DENY",  # for kiosk browsers too old for frame-ancestors
        "referrer-policy": "same-origin",
        "permissions-policy": PERMISSIONS_POLICY,
        "cross-origin-resource-policy": "same-origin",
    }
    if config.tls or config.loopback:  # elsewhere browsers ignore it, and complain
        fields["cross-origin-opener-policy"] = "same-origin"
    if config.tls and config.port == HTTPS_PORT:  # it holds for all ports of this host, other programs' pages included
        fields["strict-transport-security"] = f"max-age={HSTS_S}"
    return tuple((name.encode(), value.encode()) for name, value in fields.items())


def cache_control(path: str) -> bytes:
    """Scripts and styles are revalidated; the plant's data is never cached."""
    return b"no-cache" if path.startswith("/static/") else b"no-store"
