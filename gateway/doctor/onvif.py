"""What is said to network cameras, and what they answer: WS-Discovery, ONVIF Media 1. Sans-IO: bytes in, records out.

An answer comes from anybody in the network: none is longer than MAX_BYTES or has a document type, and every address in
it must be the one that it came from.
"""

import base64
import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Generator
from dataclasses import dataclass
from datetime import UTC, datetime
from ipaddress import ip_address
from urllib.parse import unquote, urlsplit
from xml.sax.saxutils import escape

from gateway.errors import ConfigError, ProtocolError
from gateway.web.ipc.devices import FoundNetworkCamera, NetworkStream

MAX_BYTES = 256 * 1024
MAX_TEXT, MAX_URL = 80, 1000  # characters
MAX_PROFILES = 8
SCOPE = "onvif://www.onvif.org/"
_DEVICE, _MEDIA = "http://www.onvif.org/ver10/device/wsdl", "http://www.onvif.org/ver10/media/wsdl"
_SCHEMA = "http://www.onvif.org/ver10/schema"
_SECURITY = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss"


class LoginError(ProtocolError):
    """The camera wants another user or password."""


@dataclass(frozen=True, slots=True)
class Post:
    """A request to `url`."""

    url: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Reply:
    status: int
    data: bytes


Replies = Generator[Post, Reply, ET.Element]


def probe(message_id: str) -> bytes:
    """`message_id`: a UUID of its own for each."""
    discovery = "http://schemas.xmlsoap.org/ws/2005/04/discovery"
    return _envelope(
        f'<w:MessageID xmlns:w="{_ADDRESSING}">urn:uuid:{message_id}</w:MessageID>'
        f'<w:To xmlns:w="{_ADDRESSING}">urn:schemas-xmlsoap-org:ws:2005:04:discovery</w:To>'
        f'<w:Action xmlns:w="{_ADDRESSING}">{discovery}/Probe</w:Action>',
        f'<d:Probe xmlns:d="{discovery}"><d:Types xmlns:n="http://www.onvif.org/ver10/network/wsdl">'
        "n:NetworkVideoTransmitter</d:Types></d:Probe>",
    )


_ADDRESSING = "http://schemas.xmlsoap.org/ws/2004/08/addressing"


def found(data: bytes, sender: str) -> FoundNetworkCamera | None:
    """The camera that has sent this answer to a probe; None: it is none. Raises ProtocolError."""
    root = _parsed(data)
    for match in root.iterfind(".//{*}ProbeMatch"):
        scopes = match.findtext("{*}Scopes", "").split()
        for service in match.findtext("{*}XAddrs", "").split():
            if _leads_to(service, "http", sender):
                return FoundNetworkCamera(sender, service, _scope(scopes, "name/"), _scope(scopes, "hardware/"))
    return None


def conversation(
    service: str, username: str, password: str, now: datetime, nonce: Callable[[], bytes]
) -> Generator[Post, Reply, tuple[NetworkStream, ...]]:
    """The streams of a camera's profiles. `now`: UTC, for a camera that tells its time only after the login. `nonce`:
    random bytes, anew for each request. Raises LoginError, ProtocolError, and ConfigError for an address that is no
    camera's."""
    host = _host(service)

    def ask(url: str, body: str, created: str = "") -> Replies:
        header = _login(username, password, created, nonce()) if created and username else ""
        reply = yield Post(url, _envelope(header, body))
        return _content(reply)

    try:
        root = yield from ask(service, f'<GetSystemDateAndTime xmlns="{_DEVICE}"/>')
        created = _time(root)
    except LoginError:
        created = _stated(now)
    root = yield from ask(
        service, f'<GetCapabilities xmlns="{_DEVICE}"><Category>Media</Category></GetCapabilities>', created
    )
    media = root.findtext(".//{*}Media/{*}XAddr", "").strip()
    if not _leads_to(media, "http", host):
        raise ProtocolError("it states no media service at its own address")
    root = yield from ask(media, f'<GetProfiles xmlns="{_MEDIA}"/>', created)
    streams = []
    for profile in root.findall(".//{*}Profiles")[:MAX_PROFILES]:
        encoder, token = profile.find("{*}VideoEncoderConfiguration"), profile.get("token", "")
        if encoder is None or not token:
            continue
        root = yield from ask(
            media,
            f'<GetStreamUri xmlns="{_MEDIA}"><StreamSetup><Stream xmlns="{_SCHEMA}">RTP-Unicast</Stream>'
            f'<Transport xmlns="{_SCHEMA}"><Protocol>RTSP</Protocol></Transport></StreamSetup>'
            f"<ProfileToken>{escape(token)}</ProfileToken></GetStreamUri>",
            created,
        )
        url = root.findtext(".//{*}MediaUri/{*}Uri", "").strip()
        if _leads_to(url, "rtsp", host):
            streams.append(_stream(url, profile, encoder))
    return tuple(streams)


def _stream(url: str, profile: ET.Element, encoder: ET.Element) -> NetworkStream:
    parts = urlsplit(url)
    return NetworkStream(
        url=parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl(),
        name=_text(profile.findtext("{*}Name", "")),
        width_px=_number(encoder.findtext("{*}Resolution/{*}Width", "")),
        height_px=_number(encoder.findtext("{*}Resolution/{*}Height", "")),
        codec=_text(encoder.findtext("{*}Encoding", "")),
        rate_hz=_number(encoder.findtext("{*}RateControl/{*}FrameRateLimit", "")),
    )


def _host(service: str) -> str:
    """The address in it. Raises ConfigError."""
    try:
        host = urlsplit(service).hostname or ""
        ip_address(host)
    except ValueError:
        host = ""
    if not _leads_to(service, "http", host):
        raise ConfigError("the address of a camera's service is http://, an IP address and a path")
    return host


def _leads_to(url: str, scheme: str, host: str) -> bool:
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return False
    plain = url.isascii() and url.isprintable() and " " not in url and len(url) <= MAX_URL
    return bool(plain and host and parts.scheme == scheme and parts.hostname == host)


def _content(reply: Reply) -> ET.Element:
    """Raises LoginError, ProtocolError."""
    try:
        root = _parsed(reply.data)
    except ProtocolError:
        if reply.status == 401:
            raise LoginError("user and password are needed") from None
        raise
    fault = root.find(".//{*}Body/{*}Fault")
    if fault is None and reply.status < 400:
        return root
    said = " ".join(text.strip() for text in (root if fault is None else fault).itertext() if text.strip())
    if reply.status == 401 or "NotAuthorized" in said or "FailedAuthentication" in said:
        raise LoginError("user or password is wrong, or is needed")
    raise ProtocolError(f"it refuses: {_text(said)}")


def _parsed(data: bytes) -> ET.Element:
    """Raises ProtocolError."""
    if len(data) > MAX_BYTES:
        raise ProtocolError("its answer is too long")
    parser = ET.XMLParser(target=_NoDocumentType())
    try:
        parser.feed(data)
        root: ET.Element = parser.close()
    except (ET.ParseError, ValueError, LookupError):
        raise ProtocolError("its answer is not XML") from None
    return root


class _NoDocumentType(ET.TreeBuilder):
    """Without one there is no entity to expand."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ProtocolError("its answer has a document type")


def _time(root: ET.Element) -> str:
    """As a token states it: the camera judges by its own clock. Raises ProtocolError."""
    names = ("Date/{*}Year", "Date/{*}Month", "Date/{*}Day", "Time/{*}Hour", "Time/{*}Minute", "Time/{*}Second")
    values = [_number(root.findtext(f".//{{*}}UTCDateTime/{{*}}{name}", "")) for name in names]
    try:
        year, month, day, hour, minute, second = values
        return _stated(datetime(year, month, day, hour, minute, min(second, 59), tzinfo=UTC))
    except ValueError:
        raise ProtocolError("it does not state its time") from None


def _stated(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")


def _login(username: str, password: str, created: str, nonce: bytes) -> str:
    """WS-UsernameToken with a digest: the password itself is not sent."""
    digest = base64.b64encode(hashlib.sha1(nonce + created.encode() + password.encode()).digest()).decode()
    token, encoding = f"{_SECURITY}-username-token-profile-1.0", f"{_SECURITY}-soap-message-security-1.0"
    return (
        f'<s:Security xmlns:s="{_SECURITY}-wssecurity-secext-1.0.xsd" e:mustUnderstand="1"><s:UsernameToken>'
        f"<s:Username>{escape(username)}</s:Username>"
        f'<s:Password Type="{token}#PasswordDigest">{digest}</s:Password>'
        f'<s:Nonce EncodingType="{encoding}#Base64Binary">{base64.b64encode(nonce).decode()}</s:Nonce>'
        f'<u:Created xmlns:u="{_SECURITY}-wssecurity-utility-1.0.xsd">{created}</u:Created>'
        "</s:UsernameToken></s:Security>"
    )


def _envelope(header: str, body: str) -> bytes:
    return (
        '<?xml version="1.0" encoding="UTF-8"?><e:Envelope xmlns:e="http://www.w3.org/2003/05/soap-envelope">'
        f"<e:Header>{header}</e:Header><e:Body>{body}</e:Body></e:Envelope>"
    ).encode()


def _scope(scopes: list[str], name: str) -> str:
    return next((_text(unquote(one[len(SCOPE + name) :])) for one in scopes if one.startswith(SCOPE + name)), "")


def _text(text: str) -> str:
    return "".join(char for char in text.strip() if char.isprintable())[:MAX_TEXT]


def _number(text: str) -> int:
    """0: it states none."""
    text = text.strip().partition(".")[0]
    return int(text) if text.isascii() and text.isdigit() and len(text) < 6 else 0
