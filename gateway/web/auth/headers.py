"""Headers: Host and Origin of a request, and the security headers of every answer. Pure.

Host is checked against DNS rebinding: a foreign site whose name points to the gateway's address would be same-origin.
Origin is checked against foreign sites that send requests through the browser of a logged-in person.
"""

import re
from collections.abc import Collection, Iterable
from urllib.parse import unquote, urlsplit

from gateway.config.sections.hmi import HmiConfig, host_name
from gateway.net.rate_limit import plain_address
from gateway.web.auth.login_throttle import spelled

Headers = Iterable[tuple[bytes, bytes]]
MAX_HEADER = 300  # of a Host or Origin that could be right
_PART = r"[^][:/\\@?# \t,]"
# An address of IPv6 in brackets, or a name or an address without a colon; then the port.
AUTHORITY = re.compile(rf"(?:\[(?P<v6>(?:{_PART}*:)+{_PART}*)\]|(?P<name>{_PART}+))(?::(?P<port>[0-9]{{1,5}}))?")
PORTS = {"http": 80, "https": 443}
DOTS = re.compile(r"(^|/)\.\.?(/|$)")  # segments that a browser or server removes from a path


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
    found = AUTHORITY.fullmatch(authority) if len(authority) <= MAX_HEADER else None
    port = PORTS[scheme] if found is None or found["port"] is None else int(found["port"])
    if found is None or not 0 < port <= 65535:
        raise ValueError("no host[:port]")
    return host_name(found["v6"] or found["name"]), port


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


def safe_next(target: object, base_path: str = "") -> str:
    """Where to go after a login: a path of these pages, or the start page. Never another site, nor what else a proxy
    has beside `base_path`."""
    start = f"{base_path}/"
    if not isinstance(target, str) or not target.startswith(start) or len(target) > MAX_HEADER:
        return start
    foreign = target.startswith("//") or "\\" in target or not target.isprintable()
    return start if foreign or DOTS.search(unquote(re.split("[?#]", target)[0])) else target


def forwarded_for(headers: Headers, peer: str, proxies: Collection[str]) -> str:
    """The client's address. Each entry is believed only if who connected to add it is one of `proxies`: what a client
    has written there itself stands left of what the proxy adds."""
    address = spelled(peer)
    if address not in proxies:
        return peer
    listed = b",".join(value for key, value in headers if key == b"x-forwarded-for").decode("latin-1")
    for entry in reversed(listed.split(",")):
        try:
            address = plain_address(entry.strip())
        except ValueError:
            break
        if address not in proxies:
            break
    return address


def forwarded_scheme(headers: Headers, own: str) -> str:
    """How the browser reached the proxy. Only for requests of a named proxy."""
    try:
        said = header(headers, b"x-forwarded-proto")
    except ValueError:
        return own
    return said if said in PORTS else own


# Of the answers.

# Nothing from elsewhere, nothing inline, in no frame but those of `frame_ancestors`. blob: are the pages' own pictures.
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors ",
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
        "content-security-policy": CONTENT_SECURITY_POLICY + (" ".join(config.frame_ancestors) or "'none'"),
        "x-content-type-options": "nosniff",
        "referrer-policy": "same-origin",
        "permissions-policy": PERMISSIONS_POLICY,
        "cross-origin-resource-policy": "same-origin",
    }
    if not config.frame_ancestors:  # it can't name sites
        fields["x-frame-options"] = "DENY"  # for kiosk browsers too old for frame-ancestors
    if config.tls or config.loopback:  # elsewhere browsers ignore it, and complain
        fields["cross-origin-opener-policy"] = "same-origin"
    if config.tls and config.port == HTTPS_PORT:  # it holds for all ports of this host, other programs' pages included
        fields["strict-transport-security"] = f"max-age={HSTS_S}"
    return tuple((name.encode(), value.encode()) for name, value in fields.items())


def cache_control(path: str) -> bytes:
    """Scripts, styles and languages are revalidated; the plant's data is never cached."""
    return b"no-cache" if path.startswith(("/static/", "/api/languages/")) else b"no-store"
