"""gst-rtsp-server (Debian) as a camera on loopback. `serve` runs in the system's Python, which has its bindings."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SYSTEM_PYTHON = "/usr/bin/python3"
H264 = "x264enc tune=zerolatency speed-preset=ultrafast key-int-max=10 bitrate=4000"
ENCODERS = {
    "h264": f"{H264} ! rtph264pay config-interval=1 name=pay0 pt=96",
    "mjpeg": "jpegenc ! rtpjpegpay name=pay0 pt=26",
}
LOGIN = ("joe", "se:cret")


class RtspServer:
    """`fps` frames of noise a second at rtsp://127.0.0.1:<port>/live."""

    def __init__(self, codec: str, *, login: bool = False) -> None:
        self._codec = codec
        self._login = login
        self.port = 0
        self.process: subprocess.Popen[str] | None = None

    @property
    def url(self) -> str:
        return f"rtsp://127.0.0.1:{self.port}/live"

    def start(self, width_px: int = 320, height_px: int = 240, fps: int = 25) -> None:
        """On the port of the time before."""
        caps = f"video/x-raw,format=I420,width={width_px},height={height_px},framerate={fps}/1"
        pipeline = f"( videotestsrc is-live=true pattern=snow ! {caps} ! {ENCODERS[self._codec]} )"
        command = [SYSTEM_PYTHON, str(Path(__file__)), str(self.port), pipeline, *(LOGIN if self._login else ())]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    def end(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
        self.process = None


@contextmanager
def rtsp_server(codec: str = "h264", *, login: bool = False) -> Iterator[RtspServer]:
    server = RtspServer(codec, login=login)
    try:
        server.start()
        yield server
    finally:
        server.end()


def serve(port: str, pipeline: str, login: list[str]) -> None:
    import gi  # type: ignore[import-not-found]

    for name in ("Gst", "GstRtsp", "GstRtspServer"):
        gi.require_version(name, "1.0")
    from gi.repository import GLib, Gst, GstRtsp, GstRtspServer  # type: ignore[import-not-found]

    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(port)
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch(pipeline)
    factory.set_shared(True)
    if login:
        auth = GstRtspServer.RTSPAuth()
        auth.set_supported_methods(GstRtsp.RTSPAuthMethod.DIGEST)
        token = GstRtspServer.RTSPToken()
        token.set_string("media.factory.role", "user")
        auth.add_digest(login[0], login[1], token)
        server.set_auth(auth)
        factory.add_role_from_structure(
            Gst.Structure.new_from_string("user,media.factory.access=true,media.factory.construct=true")
        )
    server.get_mount_points().add_factory("/live", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2], sys.argv[3:])
