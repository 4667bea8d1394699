"""Streams from a server on loopback: what is damaged, what is refused, and what the times of its parts prove."""

import hashlib
import io
import math
import os
import re
import socketserver
import ssl
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.certs import issue
from gateway.certs.folder import Folder
from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.core.readings import AgeProof
from gateway.errors import LinkError
from gateway.processes.start import ENVIRONMENT
from gateway.vision.source.contract import Frame, Source
from gateway.vision.source.specs import source_spec
from gateway.vision.source.streams import MOST_PART_BYTES, PartsSource, stamp_ms
from tests.e2e.tcp_proxy import NetworkConditions, Proxy

MS = 1_000_000
S = 1000 * MS


@contextmanager
def served(kind: str, *pieces: bytes, tls: ssl.SSLContext | None = None) -> Iterator[str]:
    """The address of a server on loopback that answers every request with these."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while self.rfile.readline().strip():
                pass
            with suppress(OSError):
                self.wfile.write(f"HTTP/1.0 200 OK\r\nContent-Type: {kind}\r\n\r\n".encode() + b"".join(pieces))

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        server.socket = server.socket if tls is None else tls.wrap_socket(server.socket, server_side=True)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/live"
        finally:
            server.shutdown()
            thread.join()


def jpeg(level: int) -> bytes:
    return cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))[1].tobytes()


def part(data: bytes, stamp: str = "", length: str | None = None) -> bytes:
    length = str(len(data)) if length is None else length
    headers = {"Content-Type": "image/jpeg", "Content-Length": length, "X-Timestamp": stamp}
    lines = "".join(f"{key}: {value}\r\n" for key, value in headers.items() if value)
    return b"--b\r\n" + lines.encode() + b"\r\n" + data + b"\r\n"


def read_all(source: Source) -> tuple[list[Frame], str]:
    """Its frames, and why there is no other."""
    frames: list[Frame] = []
    try:
        while True:
            frames.append(source.read())
    except LinkError as error:
        return frames, str(error)
    finally:
        source.close()


def levels(frames: list[Frame]) -> list[int]:
    return [int(frame.image[0, 0, 0]) for frame in frames]


MULTIPART = "multipart/x-mixed-replace; boundary=b"


@pytest.mark.parametrize("damaged", [jpeg(50)[:200], b"no picture at all"], ids=["cut", "text"])
def test_a_damaged_frame_of_a_stream_is_skipped_and_counted(damaged: bytes) -> None:
    whole = [part(jpeg(level)) for level in range(10, 250, 20)]
    with served(MULTIPART, *whole[:10], part(damaged), whole[10], part(damaged), whole[11]) as url:
        source = source_spec(CameraConfig(url=url)).open(SystemClock())
        frames = [source.read() for _ in range(12)]
        assert levels(frames) == pytest.approx(range(10, 250, 20), abs=2)
        assert [frame.damaged for frame in frames] == [0] * 10 + [1, 1]
        with pytest.raises(LinkError, match="lost: it gave no further frame"):
            source.read()
        source.close()


def film(path: Path, codec: str) -> bytes:
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 25.0, (64, 48))
    assert writer.isOpened()
    for level in range(30):
        writer.write(np.full((48, 64, 3), 8 * level, np.uint8))
    writer.release()
    return path.read_bytes()


@pytest.mark.parametrize(
    ("name", "codec", "reason"),
    [
        ("a.avi", "MAGY", "not a video stream that is accepted"),
        ("a.avi", "MJPG", "not a video stream that is accepted"),
        ("a.mp4", "mp4v", "not a video stream that is accepted"),
        ("a.webm", "VP80", "not a video stream that is accepted"),
        ("a.ts", "mpg2", "codec 'mpg2'; accepted: h264, hevc, MJPG, FMP4"),
    ],
)
def test_a_device_on_the_network_cannot_select_the_decoder(tmp_path: Path, name: str, codec: str, reason: str) -> None:
    with served("video/mp2t", film(tmp_path / name, codec)) as url, pytest.raises(LinkError, match=reason):
        source_spec(CameraConfig(url=url)).open(SystemClock())


def test_mpeg_4_in_a_transport_stream_is_accepted(tmp_path: Path) -> None:
    with served("video/mp2t", film(tmp_path / "a.ts", "mp4v")) as url:
        source = source_spec(CameraConfig(url=url)).open(SystemClock())
        assert source.read().image.shape == (48, 64, 3)
        source.close()


def test_a_playlist_opens_nothing_else(tmp_path: Path) -> None:
    """Neither one that a stream sends, nor one that lies in a folder of films."""
    film(tmp_path / "a.ts", "mp4v")
    lists = {
        "video/x": b"ffconcat version 1.0\nfile a.ts\n",
        "application/x-mpegurl": b"#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:1,\na.ts\n#EXT-X-ENDLIST\n",
    }
    for kind, text in lists.items():
        path = tmp_path / "list.mp4"
        path.write_bytes(text)
        with served(kind, text) as url, pytest.raises(LinkError, match="cannot be opened"):
            source_spec(CameraConfig(url=url)).open(SystemClock())
        with pytest.raises(LinkError, match="neither a video nor a picture"):
            source_spec(CameraConfig(url=str(path))).open(SystemClock())


ONE, TWO, THREE = (jpeg(level) for level in (10, 110, 210))
FLOOD = b"--b\r\n" + b"X: y\r\n" * 200


@pytest.mark.parametrize(
    ("kind", "pieces", "expected"),
    [
        (MULTIPART, [part(ONE, length=""), part(TWO, length=""), b"--b--\r\n"], [(10, 0)]),
        ("multipart/x-mixed-replace", [part(ONE), part(TWO)], [(10, 0), (110, 0)]),
        ('Multipart/Mixed; boundary="--wrong"', [b"\r\n", part(ONE), part(TWO)], [(10, 0), (110, 0)]),
        (MULTIPART, [part(ONE + b"\0" * 999), part(TWO + b"\r\n")], [(10, 0), (110, 0)]),
        (MULTIPART, [part(ONE, length="40"), part(TWO)], [(110, 1)]),
        (MULTIPART, [part(ONE, length=str(len(ONE) + 40)), part(TWO), part(THREE)], [(10, 0), (210, 0)]),
        (MULTIPART, [part(ONE, length=str(MOST_PART_BYTES + 1)), part(TWO)], [(110, 1)]),
        (MULTIPART, [part(ONE, length="nonsense"), part(TWO, length="-1")], [(10, 0)]),
        (MULTIPART, [part(ONE), FLOOD, part(TWO)], [(10, 0), (110, 1)]),
        (MULTIPART, [b"no delimiter at all\n" * 10_000], []),
        (MULTIPART, [part(b"RIFF\0\0\0\0WEBP\xff\xd9"), part(b"\xff\xd8\xff\xd9")], []),
        (MULTIPART, [], []),
    ],
    ids=["no length", "no boundary", "other", "padded", "short", "long", "huge", "odd", "flood", "none", "kind", "end"],
)
def test_a_garbled_part_costs_frames_and_nothing_else(
    kind: str, pieces: list[bytes], expected: list[tuple[int, int]]
) -> None:
    with served(kind, *pieces) as url:
        frames, why = read_all(source_spec(CameraConfig(url=url)).open(SystemClock()))
    assert why.endswith(("lost: it gave no further frame", "lost: its frames could not be decoded"))
    assert levels(frames) == pytest.approx([level for level, _ in expected], abs=2)
    assert [frame.damaged for frame in frames] == [damaged for _, damaged in expected]


def test_a_picture_that_claims_more_pixels_than_any_camera_has_is_refused_before_it_takes_memory() -> None:
    """In a process as the gateway starts it: OpenCV reads its limit once."""
    claims = bytearray(ONE)
    size = claims.index(b"\xff\xc0") + 5
    claims[size : size + 4] = 2 * (11_600).to_bytes(2)
    script = "import cv2, numpy, sys; cv2.imdecode(numpy.frombuffer(sys.stdin.buffer.read(), 'u1'), cv2.IMREAD_COLOR)"
    done = subprocess.run(
        [sys.executable, "-c", script],
        check=False,
        input=claims,
        capture_output=True,
        env={**os.environ, **ENVIRONMENT},
    )
    assert b"CV_IO_MAX_IMAGE_PIXELS" in done.stderr


def md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


class LoginHandler(socketserver.StreamRequestHandler):
    """Asks for the digest, or for the password itself, of joe with se:cret; /old has moved, and says so at length."""

    scheme = "Digest"
    refused = 0
    read_whole = 0
    others = ""

    def handle(self) -> None:
        lines = []
        while line := self.rfile.readline().decode().strip():
            lines.append(line)
        path = lines[0].split()[1]
        sent = next((line for line in lines if line.startswith("Authorization: ")), "")
        answer = "302 Moved\r\nLocation: /live" if path == "/old" else "200 OK\r\nContent-Type: " + MULTIPART
        if path != "/old" and not self.known(path, sent):
            type(self).refused += bool(sent)
            answer = f'401 Who\r\n{self.others}WWW-Authenticate: {self.scheme} realm="cam", nonce="n", qop="auth"'
        with suppress(OSError):
            self.wfile.write(f"HTTP/1.0 {answer}\r\n\r\n".encode())
            if answer.startswith("200"):
                self.wfile.write(part(ONE) + part(TWO))
            if path == "/old":
                self.wfile.write(b"x" * 2 * MOST_PART_BYTES)  # more than the sockets hold
                type(self).read_whole += 1

    def known(self, path: str, sent: str) -> bool:
        if self.scheme == "Basic":
            return sent == "Authorization: Basic am9lOnNlOmNyZXQ="
        found = re.search('nc=([0-9]+), cnonce="(\\w+)"', sent)
        count, own = found.groups() if found else ("", "")
        expected = md5(f"{md5('joe:cam:se:cret')}:n:{count}:{own}:auth:{md5(f'GET:{path}')}")
        return f'response="{expected}"' in sent


WEAKER = 'WWW-Authenticate: Basic realm="cam"\r\nWWW-Authenticate: Digest realm="cam", nonce="n", algorithm=SHA-256\r\n'


@pytest.mark.parametrize(("scheme", "others"), [("Digest", ""), ("Basic", ""), ("Digest", WEAKER)])
def test_a_login_follows_a_redirection_and_no_other_is_let_in(scheme: str, others: str, tmp_path: Path) -> None:
    handler: Any = type("Handler", (LoginHandler,), {"scheme": scheme, "others": others})
    secret = tmp_path / "password"
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        url = f"http://127.0.0.1:{server.server_address[1]}/old"
        try:
            secret.write_text("se:cret")
            config = CameraConfig(url=url, username="joe", password_file=str(secret))
            source = source_spec(config).open(SystemClock())
            assert source.read().image.shape == (48, 64, 3)
            source.close()
            secret.write_text("guess")
            with pytest.raises(LinkError, match="cannot be opened: no answer, refused") as error:
                source_spec(config).open(SystemClock())
            assert "guess" not in str(error.value)
            assert handler.refused == 1
            assert handler.read_whole == 0
        finally:
            server.shutdown()
            thread.join()


def test_the_own_certificate_of_a_camera_is_accepted(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.create()
    key = issue.new_key()
    folder.replace_key("camera", key)
    made = issue.self_signed("camera", ["elsewhere.invalid"], key, datetime.now(UTC), 2)
    folder.replace_certificate("camera", made)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "camera.pem", tmp_path / "camera.key")
    with served(MULTIPART, part(ONE), tls=context) as url:
        source = source_spec(CameraConfig(url=url.replace("http:", "https:"))).open(SystemClock())
        assert levels([source.read()]) == pytest.approx([10], abs=2)
        source.close()


class Stepped:
    """Each look at it finds it `step_ns` later."""

    def __init__(self, step_ns: int) -> None:
        self.now, self.step_ns = 7 * S, step_ns

    def now_ns(self) -> int:
        self.now += self.step_ns
        return self.now

    def wall_ns(self) -> int:
        return self.now + 1_714_557_600 * S


def read_at(step_ns: int, stamps: list[str], **camera: Any) -> tuple[list[Frame], str]:
    """Frames with these stamps, one of which arrives every `step_ns`; and why there is no other."""
    with served(MULTIPART, *(part(ONE, stamp) for stamp in stamps)) as url:
        clock: Any = Stepped(step_ns)
        return read_all(source_spec(CameraConfig(url=url, **camera)).open(clock))


PERIOD = 40 * MS
FAST = [f"1714557600.{40 * n % 1000:03d}" if 40 * n < 1000 else f"{1714557600 + 40 * n / 1000:.6f}" for n in range(200)]


@pytest.mark.failure_mode("C11")
def test_the_times_of_its_parts_prove_the_age_of_a_stream_that_is_not_held_back() -> None:
    frames, _ = read_at(PERIOD, FAST)
    assert [frame.age_proof for frame in frames] == [AgeProof.UNPROVEN] * 125 + [AgeProof.PRESENTATION_TIME] * 75
    assert [frame.t_capture_ns for frame in frames] == pytest.approx(
        [7 * S + n * PERIOD for n in range(1, 201)], abs=MS
    )


@pytest.mark.failure_mode("C8")
def test_the_times_of_its_parts_show_a_link_that_is_too_slow() -> None:
    """One frame every 40 ms, one arrival every 50 ms: it is lost when it is 1 s late for 1 s."""
    frames, why = read_at(50 * MS, FAST)
    ages = [7 * S + n * 50 * MS - frame.t_capture_ns for n, frame in enumerate(frames, 1)]
    assert ages == pytest.approx([n * 10 * MS for n in range(len(frames))], abs=MS)
    assert len(frames) == 122
    assert why.endswith("its frames arrive 1.2 s late")


@pytest.mark.failure_mode("C11")
@pytest.mark.parametrize(
    "stamps",
    [
        [""] * 200,
        ["1714557600.5"] * 200,
        [f"{1714557600 - n / 25:.6f}" for n in range(200)],
        [f"{1714557600 + n % 25 / 25:.6f}" for n in range(200)],
        [f"{1714557600 + n // 25}" for n in range(200)],
        [f"{1714557600 + 1.6 * n:.6f}" for n in range(200)],
        [f"{40 * n}" for n in range(200)],
        ["nan", "inf", "-1.5", "1e9", "a", "1714557600.5.5", "2024-13-01T00:00:00.5", "9" * 4000] * 25,
    ],
    ids=["none", "standing", "back", "in circles", "seconds", "too fast", "since when", "nonsense"],
)
def test_times_that_are_none_prove_nothing(stamps: list[str]) -> None:
    frames, _ = read_at(PERIOD, stamps, deadline_s=30.0)
    assert {frame.age_proof for frame in frames} == {AgeProof.UNPROVEN}
    assert len(frames) == 200


def test_a_part_without_a_time_among_others_is_not_proven() -> None:
    frames, _ = read_at(PERIOD, [*FAST[:150], "", *FAST[151:]])
    assert [n for n, frame in enumerate(frames) if frame.age_proof is AgeProof.UNPROVEN] == [*range(125), 150]


@pytest.mark.failure_mode("C8")
@pytest.mark.parametrize(
    ("delay_ms", "wrong"),
    [(lambda n: 20 + 0.018 * n, 0), (lambda n: 20 if n < 250 else 900, 500)],
    ids=["a backlog that grows by 450 ppm", "one stamp ahead in a full link"],
)
def test_synchronised_each_part_is_as_old_as_its_own_time_says(delay_ms: Callable[[int], float], wrong: int) -> None:
    clock: Any = Stepped(0)
    taken_ns = [clock.now + n * PERIOD for n in range(3000)]
    wall_ns = [taken + 1_714_557_600 * S + (880 * MS if n == wrong > 0 else 0) for n, taken in enumerate(taken_ns)]
    answer: Any = io.BytesIO(b"".join(part(ONE, f"{wall // 1000}") for wall in wall_ns))
    spec: Any = source_spec(CameraConfig(url="http://cam/live", clock="synchronised"))
    source = PartsSource(answer, spec, clock)
    ages_ms, proofs = [], []
    for n, taken in enumerate(taken_ns):
        clock.now = taken + round(delay_ms(n) * MS)
        frame = source.read()
        ages_ms.append((clock.now - frame.t_capture_ns) / MS)
        proofs.append(frame.age_proof)
    true_ms = [20 if n == wrong > 0 else delay_ms(n) for n in range(3000)]
    assert ages_ms == pytest.approx(true_ms, abs=1)
    assert proofs[-1] is AgeProof.DEVICE_TIME


@pytest.mark.failure_mode("C8")
def test_a_part_counts_as_arrived_before_its_body_which_a_slow_link_brings_later() -> None:
    clock: Any = Stepped(0)

    class SlowLink(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            clock.now += 300 * MS
            return super().read(size)

    answer: Any = SlowLink(part(ONE) * 3)
    spec: Any = source_spec(CameraConfig(url="http://cam/live"))
    frames, _ = read_all(PartsSource(answer, spec, clock))
    assert [frame.t_capture_ns for frame in frames] == [7 * S, 7 * S + 300 * MS, 7 * S + 600 * MS]


def test_by_arrival_the_times_of_its_parts_are_not_used() -> None:
    frames, _ = read_at(50 * MS, FAST, frame_time="arrival")
    assert len(frames) == 200
    assert {frame.age_proof for frame in frames} == {AgeProof.UNPROVEN}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1714557600.250000", 1714557600250.0),
        ("2122192.753042", 2122192753.042),
        (" 1714557600250 ", 1714557600250.0),
        ("1714557600250000", 1714557600250.0),
        ("1714557600250000000", 1714557600250.0),
        ("2024-05-01T10:00:00.250Z", 1714557600250.0),
        ("2024-05-01T12:00:00.250+02:00", 1714557600250.0),
        ("2024-05-01 10:00:00.250", 1714557600250.0),
        ("2024-05-01T10:00:00Z", math.nan),
        ("1714557600", math.nan),
        ("Wed, 01 May 2024 10:00:00 GMT", math.nan),
        ("", math.nan),
    ],
)
def test_the_time_of_a_part_in_milliseconds(text: str, expected: float) -> None:
    assert stamp_ms(text) == pytest.approx(expected, nan_ok=True)


@pytest.mark.long
@pytest.mark.failure_mode("C8")
def test_a_link_that_becomes_too_slow_shows_no_proven_frame_as_newer_than_it_is() -> None:
    clock = SystemClock()
    taken_ns: list[int] = []
    heavy = cv2.imencode(".jpg", np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8))[1].tobytes()

    class Camera(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while self.rfile.readline().strip():
                pass
            with suppress(OSError):
                self.wfile.write(f"HTTP/1.0 200 OK\r\nContent-Type: {MULTIPART}\r\n\r\n".encode())
                begun_ns = clock.now_ns()
                for n in range(1500):
                    if n == 200:
                        proxy.conditions = NetworkConditions(bytes_per_s=500_000)
                    clock.block((begun_ns + n * PERIOD - clock.now_ns()) / S)
                    taken_ns.append(clock.now_ns())
                    self.wfile.write(part(heavy, f"{taken_ns[-1] / S:.6f}"))

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Camera) as server, Proxy(server.server_address[1]) as proxy:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        frames, why = read_all(source_spec(CameraConfig(url=f"http://127.0.0.1:{proxy.port}/live")).open(clock))
        proxy.cut()
        server.shutdown()
        thread.join()
    assert re.search(r"its frames arrive \d+\.\d s late", why)
    proven = [n for n, frame in enumerate(frames) if frame.age_proof is AgeProof.PRESENTATION_TIME]
    assert len(proven) > 5
    assert max(frames[n].t_capture_ns - taken_ns[n] for n in proven) < 300 * MS
