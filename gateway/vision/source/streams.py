"""Streams over RTSP and HTTP. Imported in the vision process only.

FFmpeg reads them, but for a stream of JPEGs over HTTP (multipart/x-mixed-replace): its parts may say when they were
taken, and FFmpeg makes such times up. All that comes from the network here is bounded.
"""

import math
import re
import ssl
from collections.abc import Callable
from datetime import UTC, datetime
from http.client import HTTPException, HTTPMessage, HTTPResponse, parse_headers
from typing import IO, TYPE_CHECKING
from urllib import request
from urllib.error import HTTPError
from urllib.parse import unquote, urlsplit, urlunsplit

import cv2
import numpy as np

from gateway.clock import Clock
from gateway.core.readings import AgeProof
from gateway.errors import LinkError
from gateway.vision.pixels import bgr8
from gateway.vision.source import ffmpeg
from gateway.vision.source.capture import CaptureSource, LiveSource
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_time import ArrivalTime, FrameTime, PresentationTime, SynchronisedTime

if TYPE_CHECKING:
    from gateway.vision.source.specs import StreamSpec

MOST_LINE_BYTES = 65_536
MOST_PART_BYTES = 32 * 1024 * 1024
PADDING_BYTES = 64  # behind the end of a JPEG
ENDED = "it gave no further frame"


def open_stream(spec: "StreamSpec", clock: Clock) -> LiveSource:
    """Raises LinkError when the server cannot be reached, refuses, or sends what is not accepted.

    The process monitor's deadlines hold whatever FFmpeg does with its own time limits.
    """
    refused = f"{spec.label}: cannot be opened: no answer, refused, or not a video stream that is accepted"
    try:
        answer = _parts_of(spec) if spec.url.lower().startswith("http") else None
    except OSError as error:
        raise LinkError(refused) from error
    if answer is not None:
        return PartsSource(answer, spec, clock)
    parameters = [
        *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(spec.open_timeout_s * 1000)),
        *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(spec.read_timeout_s * 1000)),
        *(cv2.CAP_PROP_N_THREADS, 1),  # FFmpeg's frame threads each hold a frame back
    ]
    capture = ffmpeg.opened(spec.url, ffmpeg.NETWORK, parameters)
    if not capture.isOpened():
        raise LinkError(refused)
    if (codec := ffmpeg.codec_of(capture)) not in ffmpeg.CODECS:
        capture.release()
        raise LinkError(f"{spec.label}: cannot be opened: codec {codec!r}; accepted: {', '.join(ffmpeg.CODECS)}")
    return CaptureSource(
        capture, spec, clock, _stamps(spec, clock, lambda: _unix_ms(capture)) if spec.stamped else ArrivalTime()
    )


def _stamps(spec: "StreamSpec", clock: Clock, unix_ms: Callable[[], float], *, exact: bool = False) -> FrameTime:
    return SynchronisedTime(unix_ms, clock, spec.label, exact=exact) if spec.synchronised else PresentationTime()


def _unix_ms(capture: cv2.VideoCapture) -> float:
    """By the first RTCP sender report; NaN: there was none. Half a frame too early: FFmpeg's position begins with the
    first frame, and OpenCV states the time from the opening on in whole frames only."""
    opened_us, fps = capture.get(cv2.CAP_PROP_STREAM_OPEN_TIME_USEC), capture.get(cv2.CAP_PROP_FPS)
    if not (opened_us > 0 and fps > 0):
        return math.nan
    began_ms = 1000 * capture.get(cv2.CAP_PROP_PTS) / fps - capture.get(cv2.CAP_PROP_POS_MSEC)
    return opened_us / 1000 + began_ms - 500 / fps


def _parts_of(spec: "StreamSpec") -> HTTPResponse | None:
    """The answer of a server that sends parts. None: it sends something else, or is one for FFmpeg alone.

    As FFmpeg does, it accepts a camera's own certificate, and asks the proxy of the environment. Raises OSError.
    """
    parts = urlsplit(spec.url)
    login, _, host = parts.netloc.rpartition("@")
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    opener = request.OpenerDirector()  # what it has no handler for, such as a redirection to ftp, gives no answer
    known = request.HTTPPasswordMgrWithDefaultRealm()
    if login:
        user, _, secret = login.partition(":")
        usual = ":443" if parts.scheme == "https" else ":80"  # with its port: for no other that it redirects to
        known.add_password(None, host if parts.port else host + usual, unquote(user), unquote(secret))
    for handler in (
        OneLogin(),
        request.ProxyHandler(),
        request.HTTPHandler(),
        request.HTTPSHandler(context=tls),
        request.HTTPRedirectHandler(),
        request.HTTPDefaultErrorHandler(),
        request.HTTPErrorProcessor(),
        request.HTTPDigestAuthHandler(known),
        request.HTTPBasicAuthHandler(known),
    ):
        opener.add_handler(handler)
    try:
        answer = opener.open(urlunsplit(parts._replace(netloc=host)), timeout=spec.open_timeout_s)
    except HTTPError as error:
        error.close()
        raise
    except (HTTPException, ValueError):
        return None
    if isinstance(answer, HTTPResponse) and answer.headers.get_content_maintype() == "multipart":
        return answer
    if answer is not None:
        answer.close()
    return None


class OneLogin(request.BaseHandler):
    """As FFmpeg does: the digest where it is offered, and a login that was refused is not tried again, because cameras
    lock themselves. What a redirection sends with it is not read: urllib would read it to its end."""

    handler_order = 100  # before those that log in and that follow a redirection

    def http_error_401(self, req: request.Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage) -> None:
        fp.close()
        if req.has_header("Authorization"):
            raise PermissionError(msg)
        offers = headers.get_all("WWW-Authenticate", [])
        if digests := [offer for offer in offers if offer.lower().startswith("digest")]:
            del headers["WWW-Authenticate"]
            headers["WWW-Authenticate"] = min(digests, key=lambda offer: "sha-" in offer.lower())  # urllib has MD5

    def http_error_302(self, req: request.Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage) -> None:
        fp.close()

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


class Parts:
    """The parts of an answer, one by one. The first line that begins with -- is the delimiter: what the answer's header
    says of it is wrong in many cameras."""

    def __init__(self, answer: HTTPResponse, clock: Clock) -> None:
        self._answer = answer
        self._clock = clock
        self._delimiter = b""
        self._delimited = False  # the headers of a part come next

    def next(self) -> tuple[HTTPMessage, int, bytes]:
        """Headers, their arrival and body of the next one: a slow link brings the body later. Raises ValueError for a
        part that can't be used."""
        try:
            if not self._delimited:
                self._up_to_delimiter()
            self._delimited = False
            headers = parse_headers(self._answer)
            arrival_ns = self._clock.now_ns()
            length = headers.get("Content-Length", "")
            if not re.fullmatch("[0-9]{1,9}", length):
                return headers, arrival_ns, self._up_to_delimiter()
            if int(length) > MOST_PART_BYTES:
                raise ValueError("a part of it is too long")
            return headers, arrival_ns, self._answer.read(int(length))
        except (OSError, HTTPException) as error:
            raise ValueError(ENDED) from error

    def _up_to_delimiter(self) -> bytes:
        found = bytearray()
        while len(found) <= MOST_PART_BYTES:
            line = self._answer.readline(MOST_LINE_BYTES)
            if not line:
                raise ValueError(ENDED)
            if not self._delimiter and line.startswith(b"--"):
                self._delimiter = line.rstrip()
            if self._delimiter and line.rstrip() == self._delimiter:
                self._delimited = True
                return bytes(found)
            found += line
        raise ValueError("a part of it is too long")


def stamp_ms(text: str) -> float:
    """Of an `X-Timestamp`: seconds with a fraction (mjpg-streamer, ESP32; of uStreamer when it was sent); ms, us or ns
    since 1970; or ISO 8601 with a fraction. NaN: none, or one of whole seconds, which are longer than a deadline."""
    text = text.strip()
    if re.fullmatch(r"[0-9]{1,12}\.[0-9]{1,9}", text):
        return 1000 * float(text)
    if re.fullmatch("[0-9]{12,20}", text):
        return int(text) / 1000.0 ** ((len(text) - 12) // 3)
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    return 1000 * time.replace(tzinfo=time.tzinfo or UTC).timestamp() if "." in text else math.nan


class PartsSource(LiveSource):
    def __init__(self, answer: HTTPResponse, spec: "StreamSpec", clock: Clock) -> None:
        super().__init__(spec, clock, _stamps(spec, clock, lambda: 0.0, exact=True))
        self._answer = answer
        self._parts = Parts(answer, clock)

    def _next(self) -> Frame:
        headers, arrival_ns, body = self._parts.next()
        stamp = stamp_ms(headers.get("X-Timestamp", ""))
        t_capture_ns = self._taken_ns(arrival_ns, stamp)
        # One that was cut short would be decoded, with grey in it.
        whole = body.startswith(b"\xff\xd8\xff") and b"\xff\xd9" in body.rstrip(b"\0")[-PADDING_BYTES:]
        try:
            flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
            image = cv2.imdecode(np.frombuffer(body, np.uint8), flags) if whole else None
        except cv2.error:  # of a size that is none
            image = None
        if image is None:
            raise ValueError("its frames could not be decoded")
        proof = self._frame_time.proof if math.isfinite(stamp) else AgeProof.UNPROVEN
        return Frame(bgr8(image), t_capture_ns, age_proof=proof)

    def close(self) -> None:
        self._answer.close()
