"""`gateway fleet` as a process, and what its addresses answer."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.request import urlopen

CONFIG = """\
silent_s = {silent_s}
{more}
[mqtt]
url = "{url}"
[mqtt.reconnect]
min_s = 0.05
max_s = 0.2
[hmi]
port = 0
without_login = "viewer"
"""


class Fleet:
    """A context manager. Its database stays in `folder`: another one there goes on with it."""

    def __init__(self, folder: Path, url: str, *, silent_s: float = 30.0, more: str = "") -> None:
        self._file = folder / "fleet.toml"
        self._file.write_text(CONFIG.format(url=url, silent_s=silent_s, more=more))

    def __enter__(self) -> Self:
        command = [sys.executable, "-m", "gateway", "fleet", str(self._file)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if found := re.search(r"fleet page at (http://\S+)/", line):
                self.url = found[1]
                return self
        raise AssertionError(f"it ended with {self.process.wait()}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.terminate()
        self.log = self.process.communicate(timeout=20)[1]
        assert self.process.returncode == 0, self.log
        assert "Traceback" not in self.log, self.log

    def read(self, path: str) -> str:
        with urlopen(self.url + path, timeout=20) as answer:
            return str(answer.read().decode())

    def get(self, path: str) -> Any:
        return json.loads(self.read(path))

    def rows(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.get("/api/fleet")["rows"]
        return found

    def until(self, condition: Callable[[list[dict[str, Any]]], bool], timeout_s: float = 60.0) -> list[dict[str, Any]]:
        deadline = time.monotonic() + timeout_s
        while not condition(found := self.rows()):
            assert time.monotonic() < deadline, found
            time.sleep(0.1)
        return found
