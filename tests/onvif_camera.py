"""A network camera in a thread of the test: ONVIF's device and media service with a UsernameToken, as the standard's
examples have it, on loopback. `answers` replaces one operation's answer."""

import base64
import hashlib
import re
import threading
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Self

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?><SOAP-ENV:Envelope xmlns:SOAP-ENV="http://www.w3.org/2003/05/soap-envelope" '
    'xmlns:tds="http://www.onvif.org/ver10/device/wsdl" xmlns:trt="http://www.onvif.org/ver10/media/wsdl" '
    'xmlns:tt="http://www.onvif.org/ver10/schema" xmlns:ter="http://www.onvif.org/ver10/error" '
    'xmlns:wsa="http://schemas.xmlsoap.org/ws/2004/08/addressing" '
    'xmlns:wsdd="http://schemas.xmlsoap.org/ws/2005/04/discovery" '
    'xmlns:dn="http://www.onvif.org/ver10/network/wsdl"><SOAP-ENV:Body>'
)
TAIL = "</SOAP-ENV:Body></SOAP-ENV:Envelope>"
NOT_AUTHORIZED = (
    "<SOAP-ENV:Fault><SOAP-ENV:Code><SOAP-ENV:Value>SOAP-ENV:Sender</SOAP-ENV:Value><SOAP-ENV:Subcode>"
    "<SOAP-ENV:Value>ter:NotAuthorized</SOAP-ENV:Value></SOAP-ENV:Subcode></SOAP-ENV:Code><SOAP-ENV:Reason>"
    '<SOAP-ENV:Text xml:lang="en">Sender not Authorized</SOAP-ENV:Text></SOAP-ENV:Reason></SOAP-ENV:Fault>'
)
PROFILE = (
    '<trt:Profiles token="{token}" fixed="true"><tt:Name>{name}</tt:Name><tt:VideoEncoderConfiguration token="e">'
    "<tt:Name>e</tt:Name><tt:Encoding>{codec}</tt:Encoding><tt:Resolution><tt:Width>{width}</tt:Width><tt:Height>{height}"
    "</tt:Height></tt:Resolution><tt:RateControl><tt:FrameRateLimit>{rate}</tt:FrameRateLimit></tt:RateControl>"
    "</tt:VideoEncoderConfiguration></trt:Profiles>"
)
PROFILES = (
    ("main", "MainStream", "H264", 1920, 1080, 25),
    ("sub", "SubStream", "JPEG", 640, 480, 15),
)


def envelope(body: str) -> bytes:
    return f"{HEAD}{body}{TAIL}".encode()


def probe_match(
    service: str, scopes: str = "onvif://www.onvif.org/name/Plant%20Cam onvif://www.onvif.org/hardware/X1"
) -> bytes:
    return envelope(
        "<wsdd:ProbeMatches><wsdd:ProbeMatch><wsa:EndpointReference><wsa:Address>urn:uuid:1</wsa:Address>"
        f"</wsa:EndpointReference><wsdd:Types>dn:NetworkVideoTransmitter</wsdd:Types><wsdd:Scopes>{scopes}</wsdd:Scopes>"
        f"<wsdd:XAddrs>{service}</wsdd:XAddrs></wsdd:ProbeMatch></wsdd:ProbeMatches>"
    )


class OnvifCamera:
    """A context manager. Its clock is an hour off, and a token must state its time. `stream`: scheme, host and port of
    the streams."""

    def __init__(self, user: str = "admin", password: str = "p&<1", stream: str = "rtsp://127.0.0.1:8554") -> None:
        self.user, self.password, self.stream = user, password, stream
        self.answers: dict[str, bytes] = {}
        self.asked: list[str] = []
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                request = self.rfile.read(int(self.headers["Content-Length"])).decode()
                status, answer = camera.answer(request)
                self.send_response(status)
                self.send_header("Content-Length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.service = f"http://127.0.0.1:{self._server.server_port}/onvif/device_service"
        self.media = self.service.replace("device", "media")

    def __enter__(self) -> Self:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()

    def answer(self, request: str) -> tuple[int, bytes]:
        (operation,) = re.findall(r"<(Get\w+)", request)
        self.asked.append(operation)
        if operation != "GetSystemDateAndTime" and not self._authorized(request):
            return 400, envelope(NOT_AUTHORIZED)
        if operation in self.answers:
            return 200, self.answers[operation]
        return 200, envelope(getattr(self, f"_{operation}")(request))

    def _authorized(self, request: str) -> bool:
        found = re.search(
            r"Username>(.*?)</.*?PasswordDigest\">(.*?)</.*?Base64Binary\">(.*?)</.*?Created[^>]*>(.*?)</", request
        )
        if found is None:
            return False
        user, digest, nonce, created = found.groups()
        wanted = hashlib.sha1(base64.b64decode(nonce) + created.encode() + self.password.encode()).digest()
        return (user, base64.b64decode(digest), created[:13]) == (self.user, wanted, "2026-02-03T04")

    def _GetSystemDateAndTime(self, _: str) -> str:
        now = datetime(2026, 2, 3, 4, 5, 6, tzinfo=UTC)
        return (
            "<tds:GetSystemDateAndTimeResponse><tds:SystemDateAndTime><tt:DateTimeType>NTP</tt:DateTimeType>"
            f"<tt:UTCDateTime><tt:Time><tt:Hour>{now.hour}</tt:Hour><tt:Minute>{now.minute}</tt:Minute><tt:Second>"
            f"{now.second}</tt:Second></tt:Time><tt:Date><tt:Year>{now.year}</tt:Year><tt:Month>{now.month}</tt:Month>"
            f"<tt:Day>{now.day}</tt:Day></tt:Date></tt:UTCDateTime></tds:SystemDateAndTime></tds:GetSystemDateAndTimeResponse>"
        )

    def _GetCapabilities(self, _: str) -> str:
        return (
            "<tds:GetCapabilitiesResponse><tds:Capabilities><tt:Media>"
            f"<tt:XAddr>{self.media}</tt:XAddr></tt:Media></tds:Capabilities></tds:GetCapabilitiesResponse>"
        )

    def _GetProfiles(self, _: str) -> str:
        keys = ("token", "name", "codec", "width", "height", "rate")
        profiles = [PROFILE.format(**dict(zip(keys, row, strict=True))) for row in PROFILES]
        return f"<trt:GetProfilesResponse>{''.join(profiles)}</trt:GetProfilesResponse>"

    def _GetStreamUri(self, request: str) -> str:
        (token,) = re.findall(r"<ProfileToken>(.*?)</", request)
        return (
            f"<trt:GetStreamUriResponse><trt:MediaUri><tt:Uri>{self.stream}/{token}</tt:Uri></trt:MediaUri>"
            "</trt:GetStreamUriResponse>"
        )
