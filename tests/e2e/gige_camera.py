"""Aravis' own GigE Vision camera (arv-fake-gv-camera, Debian's aravis-tools) on loopback. Its port is the standard's,
so there is one at a time on a machine: the next waits."""

import fcntl
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

URL = "gige://127.0.0.1"


class FakeCamera:
    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def plug_in(self, lost_per_mille: int = 0) -> None:
        command = ["arv-fake-gv-camera-0.8", "-i", "127.0.0.1", "-s", "T1", "-r", str(lost_per_mille)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def unplug(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = None


@contextmanager
def fake_camera() -> Iterator[FakeCamera]:
    with (Path(tempfile.gettempdir()) / "loading-gateway-tests-gvcp.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        camera = FakeCamera()
        try:
            yield camera
        finally:
            camera.unplug()
