"""Streams as FFmpeg opens them, from a server on loopback: what is damaged, and what is refused."""

import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.errors import LinkError
from gateway.vision.source.specs import source_spec


@contextmanager
def served(kind: str, *pieces: bytes) -> Iterator[str]:
    """The address of a server on loopback that answers every request with these."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while self.rfile.readline().strip():
                pass
            with suppress(OSError):
                self.wfile.write(f"HTTP/1.0 200 OK\r\nContent-Type: {kind}\r\n\r\n".encode() + b"".join(pieces))

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/live"
        finally:
            server.shutdown()
            thread.join()


def jpeg(level: int) -> bytes:
    return cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))[1].tobytes()


def part(data: bytes) -> bytes:
    return b"--b\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(data), data)


MULTIPART = "multipart/x-mixed-replace; boundary=b"


@pytest.mark.parametrize("damaged", [jpeg(50)[:200], b"no picture at all"], ids=["cut", "text"])
def test_a_damaged_frame_of_a_stream_is_skipped_and_counted(damaged: bytes) -> None:
    whole = [part(jpeg(level)) for level in range(10, 250, 20)]  # FFmpeg drops the first, which it opens with
    with served(MULTIPART, *whole[:10], part(damaged), whole[10], part(damaged), whole[11]) as url:
        source = source_spec(CameraConfig(url=url)).open(SystemClock())
        frames = [source.read() for _ in range(11)]
        assert [frame.image[0, 0, 0] for frame in frames] == pytest.approx(range(30, 250, 20), abs=2)
        assert [frame.damaged for frame in frames] == [0] * 9 + [1, 1]
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
